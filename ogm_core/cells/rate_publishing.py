"""Publishing of counted cells: from hits and lengths of passing to a probability, by NumPy.

The rate of a cell is hits / length of passing, smoothed by the mean of its surroundings; p = 1 - exp(-gain
rate) is how likely a beam is to end within `gain` sides of such cells. Where nobody's beams were heard of,
two that met nothing make a cell free. Its compiled twin is `cells.rate_kernel`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.model import Known, Probability

P_NO_RETURN, LEAST_NO_RETURNS = 0.02, 2
"""How likely a cell is occupied that only such beams passed as met nothing, and how many it takes."""
CEILING, LEAST_NEIGHBOURS = 0.65, 3
"""A cell in which nothing was counted is at most so likely, unless so many of those around it have counts.

Without this walls are up to twice as thick, on the side that nobody has seen.
"""
LENGTH_UNIT, HIT_UNIT = 32.0, 1024.0
"""How many of the numbers that are handed in are a side of a cell, and a hit."""

Counts = NDArray[Any]
"""Whole numbers, as integers or as float64."""
Unanswered = NDArray[np.uint16]


class Publishing(NamedTuple):
    """How counts become probabilities: the constants of one lattice.

    `hits` and `length`, in hits and in sides of a cell, are what the surroundings are taken to hold besides
    what was counted there; `weight` sides of them count beside a cell's own; `gain`, in sides, is above. With
    `smooth` a cell's hits are [1 4 1] / 6 of its neighbours' in x and in y, and where nothing was counted in
    the 3 x 3 cells around, the 5 x 5 are looked at.
    """

    hits: float
    length: float
    weight: float
    gain: float
    smooth: bool

    @property
    def margin(self) -> int:
        """How many cells around a cell it looks at."""
        return 3 if self.smooth else 1


OF_HALVES = Publishing(0.005, 0.05, 1.0, 4.0, smooth=True)
"""For cells half as wide as those that beams are counted in: what tells most."""
OF_CELLS = Publishing(0.005, 0.05, 0.25, 2.0, smooth=False)
"""For these cells themselves, of counts that were put together; not the halves' p."""

Publish = Callable[[Counts, Counts, Unanswered, Publishing], tuple[Probability, Known]]
"""From lengths of passing, hits and beams that met nothing, with the margin around, to what is published."""


def publish(
    passing: Counts, hits: Counts, unanswered: Unanswered, rule: Publishing
) -> tuple[Probability, Known]:
    """Probability of "occupied" and whether known, of counts with the rule's margin on every side.

    `passing` in 1/32 side of a cell, `hits` in 1/1024 hit, `unanswered` in beams; [iy, ix].
    """
    edge = rule.margin
    counted = (passing > 0) | (hits > 0)
    if rule.smooth:
        n, h, hit_unit = _without(passing, 1), _smoothed(hits), 36.0 * HIT_UNIT
        n9, h9 = (_without(_summed(values, 1), 1) for values in (n, h))
        nothing = (n9 == 0) & (h9 == 0)
        n9, h9 = (np.where(nothing, _summed(far, 2), near) for far, near in ((n, n9), (h, h9)))
        n, h = _without(n, 2), _without(h, 2)
    else:
        n9, h9, hit_unit = _summed(passing, 1), _summed(hits, 1), HIT_UNIT
        n, h = _without(passing, 1), _without(hits, 1)
    mean = (h9 / hit_unit + rule.hits) / (n9 / LENGTH_UNIT + rule.length)
    rate = (h / hit_unit + rule.weight * mean) / (n / LENGTH_UNIT + rule.weight)
    p = 1.0 - np.exp(-rule.gain * rate)
    neighbours = _without(_summed(counted, 1), edge - 1)
    p[(p > CEILING) & ~_without(counted, edge) & (neighbours < LEAST_NEIGHBOURS)] = CEILING
    heard = (n9 > 0) | (h9 > 0)
    free = ~heard & (_without(unanswered, edge) >= LEAST_NO_RETURNS)
    return np.where(heard, p, np.where(free, P_NO_RETURN, 0.5)), heard | free


def _without(cells: NDArray[Any], edge: int) -> NDArray[Any]:
    """Cells without so many at every side."""
    return cells[edge : cells.shape[0] - edge, edge : cells.shape[1] - edge]


def _summed(cells: Counts, radius: int) -> Counts:
    """Sums over the squares around cells; those at the sides, which have none, are gone."""
    rows, columns = cells.shape[0] - 2 * radius, cells.shape[1] - 2 * radius
    lines = cells[:rows].astype(np.float64)
    for y in range(1, 2 * radius + 1):
        lines += cells[y : y + rows]
    found = lines[:, :columns].copy()
    for x in range(1, 2 * radius + 1):
        found += lines[:, x : x + columns]
    return found


def _smoothed(hits: Counts) -> Counts:
    """36 times [1 4 1] / 6 in x and in y; the cells at the sides are gone."""
    wide = hits.astype(np.float64)
    lines = wide[:-2] + 4 * wide[1:-1] + wide[2:]
    return lines[:, :-2] + 4 * lines[:, 1:-1] + lines[:, 2:]
