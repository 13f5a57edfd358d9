"""Where counted beams count: the rectangle that holds it, and the tiles. What is counted: see `passing`."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.lattice import CellRect
from ogm_core.sensor_models.beams import HIT, IX, IX0, IY, IY0, KIND, SKIPPED, Plain
from ogm_core.sensor_models.bresenham import FRACTION_BITS, left_in_tile
from ogm_core.sensor_models.counted_beams import (
    cell_at,
    cell_of,
    half_inside,
    last_passed,
    points_in,
    share_of_hit,
)
from ogm_core.sensor_models.true_line import Line, half_columns, line_of, row_at_start, steps_inside
from ogm_core.tiles.marks import touch

_ONE_IN = 8
"""Beams of which one is looked at first: its neighbours end nearby."""


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _widened(box: tuple[int, int, int, int], i: int, j: int) -> tuple[int, int, int, int]:
    """The box of cells, west, south, east, north, that holds this one, too."""
    west, south, east, north = box
    return min(west, i), min(south, j), max(east, i), max(north, j)


@njit(cache=True, nogil=True, error_model="numpy")
def _box_of(
    line: Line, kind: int, u: int, v: int, box: tuple[int, int, int, int]
) -> tuple[int, int, int, int]:
    """The box that also holds every cell that a beam counts in; lines are monotone, so ends span them."""
    acc, last = row_at_start(line), last_passed(line, kind)
    if last >= 1:
        for k in (1, last):
            i, j = cell_at(
                line, line.start + line.sign * k, line.aside + ((acc + k * line.step) >> FRACTION_BITS)
            )
            box = _widened(box, i, j)
    if kind != HIT:
        return box
    half, count, acc = half_columns(line)
    if count:
        for k in (0, count - 1):
            row = (acc + k * line.step) >> FRACTION_BITS
            i, j = cell_at(line, 2 * line.start + half + line.sign * k, 2 * line.aside + row)
            box = _widened(box, i >> 1, j >> 1)
    for q in range(4):
        i, j, share = share_of_hit(q, u, v)
        if share:
            box = _widened(box, i >> 1, j >> 1)
    return box


@njit(cache=True, error_model="numpy")
def _farthest(ends: NDArray[np.int64], side: int) -> int:
    """Of some beams that one which ends farthest in the west, the east, the south or the north."""
    places, sign, found = ends[IX if side < 2 else IY], 1 - 2 * (side & 1), 0
    for b in range(1, places.size, _ONE_IN):
        if sign * places[b] < sign * places[found] and ends[KIND, b] != SKIPPED:
            found = b
    return found


@njit(cache=True, error_model="numpy")
def extent(ends: NDArray[np.int64], weights: NDArray[np.int64]) -> tuple[int, int, int, int]:
    """Smallest rectangle (ix, iy, width, height) of cells in which the beams count; width 0 if in none.

    Only beams that may reach out of what is found so far are looked at closely, the farthest ones first.
    """
    box = 2**62, 2**62, -(2**62), -(2**62)
    count = ends.shape[1]
    for n in range(-4 if count else 0, count):
        b = n if n >= 0 else _farthest(ends, n & 3)
        kind, u0, v0, u1, v1 = ends[KIND, b], ends[IX0, b], ends[IY0, b], ends[IX, b], ends[IY, b]
        if kind == SKIPPED or cell_of((u0 ^ u1) | (v0 ^ v1)) == 0:
            continue
        west, south, east, north = box
        inside = (cell_of(min(u0, u1)) > west) & (cell_of(max(u0, u1)) < east)
        inside &= (cell_of(min(v0, v1)) > south) & (cell_of(max(v0, v1)) < north)
        if not inside:
            box = _box_of(line_of(u0, v0, u1, v1), kind, u1, v1, box)
    west, south, east, north = box
    if east < west:
        return 0, 0, 0, 0
    return west, south, east - west + 1, north - south + 1


@njit(cache=True, error_model="numpy")
def touch_tiles(
    ends: NDArray[np.int64],
    weights: NDArray[np.int64],
    window: Plain,
    touched: NDArray[np.int64],
    revision: int,
) -> int:
    """Write `revision` into every tile that `update_planes` would write; return how many held 0 before.

    Between two tile edges of its major axis a line meets at most two tiles: those of the piece's ends.
    """
    window = CellRect(*window)
    fresh = 0
    for b in range(ends.shape[1]):
        counts, u0, v0, u1, v1 = points_in(window, ends, b)
        if not counts:
            continue
        line, kind = line_of(u0, v0, u1, v1), ends[KIND, b]
        acc = row_at_start(line)
        k, last = steps_inside(line, last_passed(line, kind), acc, window.width, window.height)
        while k <= last:
            end = min(k + left_in_tile(line.start + line.sign * k, line.sign), last)
            for at in (k, end):
                row = line.aside + ((acc + at * line.step) >> FRACTION_BITS)
                i, j = cell_at(line, line.start + line.sign * at, row)
                fresh += touch(touched, i, j, revision)
            k = end + 1
        if kind == HIT:
            fresh += _touch_hit(line, u1, v1, window, touched, revision)
    return fresh


@njit(cache=True, nogil=True, error_model="numpy")
def _touch_hit(
    line: Line, u: int, v: int, window: CellRect, touched: NDArray[np.int64], revision: int
) -> int:
    """Write `revision` into the tiles in which the end of a hit counts; return how many held 0 before."""
    half, count, acc = half_columns(line)
    fresh = 0
    for _ in range(count):
        i, j = cell_at(line, 2 * line.start + half, 2 * line.aside + (acc >> FRACTION_BITS))
        if half_inside(i, j, window):
            fresh += touch(touched, i >> 1, j >> 1, revision)
        acc += line.step
        half += line.sign
    for q in range(4):
        i, j, share = share_of_hit(q, u, v)
        if share and half_inside(i, j, window):
            fresh += touch(touched, i >> 1, j >> 1, revision)
    return fresh
