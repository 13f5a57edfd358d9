"""Beams as lengths of passing, and hits: the kernels that count them, along true lines.

    cells   o . . . .        In every column strictly between the sensor's and the last but one, ONE cell gets
            . x x . .        the beam's weight: the one that holds the line at the column's middle.
            . . . x :        A beam that met nothing counts 1 there, in a plane of its own.
            . . . . :        Over the last two columns before a hit, columns half as wide count in the same
                             way, up to the end point's own, which gets the part that was entered.
    halves      x x          The hit itself is shared by the four halves around the end point.
                    x x

A cell that is passed along its whole column counts the length of that, which is longer the steeper the line
runs (Schaefer, Luft & Burgard 2017). Every number is a sum of whole numbers that depend on one beam alone; it
stops at the largest that its plane holds, so that the order of beams never matters.

`ends` and `weights` are those of `counted_beams`. Cells are addressed as in tiles.store. `window` is the
contents of a CellRect, of cells; the planes are those of cells.rate.
"""

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.lattice import CellRect
from ogm_core.sensor_models.beams import HIT, KIND, NO_RETURN, Plain
from ogm_core.sensor_models.bresenham import FRACTION_BITS, left_in_tile
from ogm_core.sensor_models.counted_beams import cell_at, half_inside, last_passed, points_in, share_of_hit
from ogm_core.sensor_models.passing_extent import extent, touch_tiles
from ogm_core.sensor_models.strip_work import work_of_beams
from ogm_core.sensor_models.true_line import (
    SUBCELL_BITS,
    Line,
    entered,
    half_columns,
    line_of,
    row_at_start,
    steps_between,
    steps_inside,
)
from ogm_core.tiles.marks import touch, touch_rows
from ogm_core.tiles.store import TILE, TILE_BITS

__all__ = ["extent", "strip_work", "touch_tiles", "update_planes"]

CUT = 32
"""Parts for threads begin at every so many-th column: none writes into a cache line of another's."""
CELL_WORK = 1.6
"""How much work a cell is: one along a beam of log odds is 1."""
_LONGEST_PIECE = 4000
"""Rows that are walked in one go: addresses in fixed point stay below 2^63."""
_MOST_CARRIES = 2**16 - 1
_MOST = 2**32 - 1
"""The largest numbers that planes hold: sums stop there, as those of cells.rate_sums do."""


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _count_passing(
    line: Line,
    kind: int,
    weight: int,
    window: CellRect,
    touched: NDArray[np.int64],
    revision: int,
    column: NDArray[np.int64],
    passing: NDArray[np.uint16],
    carries: NDArray[np.uint16],
    unanswered: NDArray[np.uint16],
) -> tuple[int, int]:
    """Count a beam in the cells that it passed; returns the number of updates and of fresh tiles.

    A line is cut at tile edges where i is the major axis, else at the edges of the strips: there the
    address of its cells is a fixed-point number itself.
    """
    acc, step, sign, west = row_at_start(line), line.step, line.sign, column[0] & (TILE - 1)
    k, last = steps_inside(line, last_passed(line, kind), acc, window.width, window.height)
    updates, fresh = max(0, last - k + 1), 0
    while k <= last:
        at, a, along = acc + k * step, acc + (k - 1) * step, line.start + sign * k
        row = line.aside + (at >> FRACTION_BITS)
        if line.along_i:
            end = min(k + left_in_tile(along + west, sign), last)
            fresh += touch(touched, along + west, row, revision)
            fresh += touch(
                touched, along + west, line.aside + ((acc + end * step) >> FRACTION_BITS), revision
            )
            base, ahead, bits, gain = (
                column[np.uint64(along)] + (line.aside << TILE_BITS) - sign,
                sign,
                TILE_BITS,
                step,
            )
        else:
            left = ((row + west) & ~(TILE - 1)) - west - line.aside
            _, end = steps_between(k, min(last, k + _LONGEST_PIECE), acc, step, left, left + TILE - 1)
            fresh += touch_rows(touched, row + west, along, line.start + sign * end, revision)
            base = column[np.uint64(row)] - (at >> FRACTION_BITS) + ((along - sign) << TILE_BITS)
            ahead, bits, gain = 0, 0, step + (sign << (TILE_BITS + FRACTION_BITS))
        if kind == NO_RETURN:
            _add_one(unanswered, base, ahead, bits, a, gain, end - k + 1)
        else:
            over = _add_weight(passing, weight, base, ahead, bits, a, gain, end - k + 1)
            if over:
                _add_carries(passing, carries, weight, base, ahead, bits, a, gain, end - k + 1)
        k = end + 1
    return updates, fresh


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _add_one(
    cells: NDArray[np.uint16], base: int, ahead: int, bits: int, acc: int, gain: int, count: int
) -> None:
    """Add 1 to every cell of a piece; none is more than 65535."""
    for _ in range(count):
        acc += gain
        base += ahead
        address = np.uint64(base + ((acc >> FRACTION_BITS) << bits))
        value = np.int64(cells[address])
        cells[address] = value + (value < 65535)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _add_weight(
    cells: NDArray[np.uint16], weight: int, base: int, ahead: int, bits: int, acc: int, gain: int, count: int
) -> bool:
    """Add the weight to every cell of a piece; returns whether some have wrapped."""
    over = 0
    for _ in range(count):
        acc += gain
        base += ahead
        address = np.uint64(base + ((acc >> FRACTION_BITS) << bits))
        value = np.int64(cells[address]) + weight
        cells[address] = value
        over |= int(value)
    return over >> 16 != 0


@njit(cache=True, nogil=True, error_model="numpy")
def _add_carries(
    cells: NDArray[np.uint16],
    carries: NDArray[np.uint16],
    weight: int,
    base: int,
    ahead: int,
    bits: int,
    acc: int,
    gain: int,
    count: int,
) -> None:
    """Carry 1 where a cell of the piece has wrapped: it now holds less than was added.

    One that has no carry left stays at the largest number that both planes hold together.
    """
    for _ in range(count):
        acc += gain
        base += ahead
        address = np.uint64(base + ((acc >> FRACTION_BITS) << bits))
        wrapped, carry = np.int64(cells[address]) < weight, np.int64(carries[address])
        if wrapped and carry == _MOST_CARRIES:
            cells[address] = _MOST_CARRIES
        else:
            carries[address] = carry + wrapped


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _plus(count: int, more: int) -> int:
    """A sum in a plane of 32 bits."""
    return min(count + more, _MOST)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _count_hit(
    line: Line,
    point: tuple[int, int],
    weights: tuple[int, int],
    window: CellRect,
    touched: NDArray[np.int64],
    revision: int,
    column: NDArray[np.int64],
    passing: NDArray[np.uint32],
    hits: NDArray[np.uint32],
) -> tuple[int, int]:
    """Count the end of a hit, in halves; returns the number of updates, those of hits apart, and fresh tiles.

    `weights` are that of a column, and of the range.
    """
    (u, v), (weight, range_weight) = point, weights
    west = column[0] & (2 * TILE - 1)
    half, count, acc = half_columns(line)
    updates = fresh = 0
    for _ in range(count):
        i, j = cell_at(line, 2 * line.start + half, 2 * line.aside + (acc >> FRACTION_BITS))
        if half_inside(i, j, window):
            address = np.uint64(column[np.uint64(i)] + (j << (TILE_BITS + 1)))
            passing[address] = _plus(passing[address], weight)
            fresh += touch(touched, (i + west) >> 1, j >> 1, revision)
            updates += 1
        acc += line.step
        half += line.sign
    i, j = u >> 3, v >> 3
    if half_inside(i, j, window):
        address = np.uint64(column[np.uint64(i)] + (j << (TILE_BITS + 1)))
        passing[address] = _plus(passing[address], (weight * entered(line) + 8) >> 4)
        updates += 1
    return updates, fresh + _share_hit(u, v, range_weight, window, touched, revision, column, hits)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _share_hit(
    u: int,
    v: int,
    weight: int,
    window: CellRect,
    touched: NDArray[np.int64],
    revision: int,
    column: NDArray[np.int64],
    hits: NDArray[np.uint32],
) -> int:
    """Share a hit among the four halves around its point; returns the number of fresh tiles."""
    i, j, last = (u - 4) >> 3, (v - 4) >> 3, 2 * TILE - 1
    west = column[0] & last
    if (
        ((i + west) & last != last)
        & (j & last != last)
        & half_inside(i, j, window)
        & half_inside(i + 1, j + 1, window)
    ):
        address = np.uint64(column[np.uint64(i)] + (j << (TILE_BITS + 1)))
        for q in range(4):  # all in one tile
            at = address + np.uint64((q & 1) + (q >> 1) * 2 * TILE)
            hits[at] = _plus(hits[at], share_of_hit(q, u, v)[2] * weight)
        return int(touch(touched, (i + west) >> 1, j >> 1, revision))
    fresh = 0
    for q in range(4):
        i, j, share = share_of_hit(q, u, v)
        if share and half_inside(i, j, window):
            address = np.uint64(column[np.uint64(i)] + (j << (TILE_BITS + 1)))
            hits[address] = _plus(hits[address], share * weight)
            fresh += touch(touched, (i + west) >> 1, j >> 1, revision)
    return fresh


def strip_work(
    ends: NDArray[np.int64],
    weights: NDArray[np.int64],
    window: Plain,
    work: NDArray[np.float64],
) -> None:
    """Add to `work` about how many cells will be updated in each CUT columns of the window."""
    work_of_beams(ends, SUBCELL_BITS, window, CUT, work)


@njit(cache=True, nogil=True, error_model="numpy")
def update_planes(
    ends: NDArray[np.int64],
    weights: NDArray[np.int64],
    window: Plain,
    touched: NDArray[np.int64],
    revision: int,
    columns: tuple[NDArray[np.int64], NDArray[np.int64]],
    planes: tuple[Any, ...],
) -> tuple[int, int]:
    """Add a scan's beams to the planes of cells.rate, in its order, and write `revision` into their tiles.

    Returns the number of cell updates and of tiles that held 0 before. Only what lies in `window` changes;
    `columns`, which address cells and halves, begin in its corner, `touched` with the tile that holds it.
    """
    window = CellRect(*window)
    passing, carries, unanswered, near, hits = planes
    updates = fresh = 0
    for b in range(ends.shape[1]):
        counts, u0, v0, u1, v1 = points_in(window, ends, b)
        if not counts:
            continue
        line, kind, range_weight = line_of(u0, v0, u1, v1), ends[KIND, b], weights[b]
        advance = float(line.advance)
        weight = int(
            range_weight * math.sqrt(advance * advance + float(line.rise * line.rise)) / advance + 0.5
        )
        more, tiles = _count_passing(
            line, kind, weight, window, touched, revision, columns[0], passing, carries, unanswered
        )
        updates += more
        fresh += tiles
        if kind == HIT:
            more, tiles = _count_hit(
                line, (u1, v1), (weight, range_weight), window, touched, revision, columns[1], near, hits
            )
            updates += more
            fresh += tiles
    return updates, fresh
