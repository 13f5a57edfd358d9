"""Compiled publishing of counted cells: what `rate_publishing.publish` says, row by row.

Whole numbers are kept in float64, which holds all sums exactly, and loops are short and have no branches: the
compiler makes them work on many cells at once.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.cells.model import Known, Probability
from ogm_core.cells.rate_publishing import (
    CEILING,
    HIT_UNIT,
    LEAST_NEIGHBOURS,
    LEAST_NO_RETURNS,
    LENGTH_UNIT,
    P_NO_RETURN,
    Counts,
    Publishing,
    Unanswered,
)

_CERTAIN = 40.0
"""exp(-40) makes no difference to 1."""


def publish(
    passing: Counts, hits: Counts, unanswered: Unanswered, rule: Publishing
) -> tuple[Probability, Known]:
    """The same as `rate_publishing.publish`, up to 1e-12."""
    edge = rule.margin
    shape = passing.shape[0] - 2 * edge, passing.shape[1] - 2 * edge
    p, known = np.empty(shape), np.empty(shape, np.bool_)
    if p.size:
        _publish(
            np.ascontiguousarray(passing, np.float64),
            np.ascontiguousarray(hits, np.float64),
            np.ascontiguousarray(unanswered),
            rule,
            edge,
            p,
            known,
        )
    return p, known


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _below_one(x: float) -> float:
    """1 - exp(-x), x >= 0, right to 1e-13: a series for x / 64, squared six times."""
    y = -(x if x < _CERTAIN else _CERTAIN) / 64.0
    e = 1.0 / 5040.0
    for factor in (1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0):
        e = factor + y * e
    for _ in range(6):
        e *= e
    return 1.0 - e


@njit(cache=True, nogil=True, error_model="numpy")
def _smoothed(hits: NDArray[np.float64]) -> NDArray[np.float64]:
    """36 times [1 4 1] / 6 in x and in y; the cells at the sides are gone."""
    rows, columns = hits.shape[0] - 2, hits.shape[1] - 2
    found, line = np.empty((rows, columns)), np.empty(columns + 2)
    for y in range(rows):
        south, middle, north, row = hits[y], hits[y + 1], hits[y + 2], found[y]
        for x in range(line.size):
            line[x] = south[x] + 4.0 * middle[x] + north[x]
        for x in range(columns):
            row[x] = line[x] + 4.0 * line[x + 1] + line[x + 2]
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_near(
    cells: NDArray[np.float64], y: int, edge: int, line: NDArray[np.float64], near: NDArray[np.float64]
) -> None:
    """Sums of the 3 x 3 cells around those of row `y`, which has `edge` more at both ends."""
    south, middle, north = cells[y - 1], cells[y], cells[y + 1]
    for x in range(line.size):
        line[x] = south[x] + middle[x] + north[x]
    a, b, c = line[edge - 1 :], line[edge:], line[edge + 1 :]
    for x in range(near.size):
        near[x] = a[x] + b[x] + c[x]


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_far(cells: NDArray[np.float64], y: int, line: NDArray[np.float64], far: NDArray[np.float64]) -> None:
    """Sums of the 5 x 5 cells around those of row `y`, which has 2 more at both ends; after `_sum_near`."""
    south, north = cells[y - 2], cells[y + 2]
    for x in range(line.size):
        line[x] += south[x] + north[x]
    a, b, c, d, e = line, line[1:], line[2:], line[3:], line[4:]
    for x in range(far.size):
        far[x] = a[x] + b[x] + c[x] + d[x] + e[x]


@njit(cache=True, nogil=True, error_model="numpy")
def _probabilities(
    around: NDArray[np.float64],
    far: NDArray[np.float64],
    n: NDArray[np.float64],
    h: NDArray[np.float64],
    hit: float,
    rule: Publishing,
    p: NDArray[np.float64],
) -> None:
    """Write the probabilities of a row of cells, of their counts and those around, or farther around."""
    n9, h9, n25, h25 = around[0], around[1], far[0], far[1]
    for i in range(p.size):
        nothing = n9[i] + h9[i] == 0.0
        n9[i] = n25[i] if nothing else n9[i]
        h9[i] = h25[i] if nothing else h9[i]
    for i in range(p.size):
        p[i] = (h9[i] * hit + rule.hits) / (n9[i] / LENGTH_UNIT + rule.length)
    for i in range(p.size):
        p[i] = rule.gain * (h[i] * hit + rule.weight * p[i]) / (n[i] / LENGTH_UNIT + rule.weight)
    for i in range(p.size):
        p[i] = _below_one(p[i])


@njit(cache=True, nogil=True, error_model="numpy")
def _known(
    around: NDArray[np.float64],
    unanswered: NDArray[np.uint16],
    p: NDArray[np.float64],
    known: NDArray[np.bool_],
) -> None:
    """Write which cells of a row are known, and the probabilities of those where nothing was heard."""
    n9, h9 = around[0], around[1]
    for i in range(p.size):
        heard = n9[i] + h9[i] > 0.0
        free = unanswered[i] >= LEAST_NO_RETURNS
        p[i] = p[i] if heard else (P_NO_RETURN if free else 0.5)
        known[i] = heard | free


@njit(cache=True, nogil=True, error_model="numpy")
def _publish(
    passing: NDArray[np.float64],
    hits: NDArray[np.float64],
    unanswered: Unanswered,
    rule: Publishing,
    edge: int,
    p: Probability,
    known: Known,
) -> None:
    """Write p and known; the other arrays have `edge` more cells on every side."""
    margin, hit = (2, 1.0 / (36.0 * HIT_UNIT)) if rule.smooth else (1, 1.0 / HIT_UNIT)
    h = _smoothed(hits) if rule.smooth else hits
    n = passing[1:-1, 1:-1].copy() if rule.smooth else passing
    rows, columns = p.shape
    line, around, far = np.empty(columns + 2 * margin), np.empty((2, columns)), np.zeros((2, columns))
    for j in range(rows):
        y = j + margin
        for cells, near, farther in ((n, around[0], far[0]), (h, around[1], far[1])):
            _sum_near(cells, y, margin, line, near)
            if rule.smooth:
                _sum_far(cells, y, line, farther)
        _probabilities(
            around, far, n[y, margin : margin + columns], h[y, margin : margin + columns], hit, rule, p[j]
        )
        _known(around, unanswered[j + edge, edge : edge + columns], p[j], known[j])
        for i in range(columns):
            if p[j, i] > CEILING and _guessed(passing, hits, j + edge, i + edge):
                p[j, i] = CEILING


@njit(cache=True, nogil=True, error_model="numpy")
def _guessed(passing: NDArray[np.float64], hits: NDArray[np.generic], y: int, x: int) -> bool:
    """Whether nothing was counted in a cell, and in too few of those around it."""
    if passing[y, x] > 0.0 or hits[y, x] > 0:
        return False
    counted = 0
    for v in range(y - 1, y + 2):
        for u in range(x - 1, x + 2):
            counted += (passing[v, u] > 0.0) | (hits[v, u] > 0)
    return counted < LEAST_NEIGHBOURS
