r"""Exact grid traversal (`dda`): every cell that a beam passes through (Amanatides & Woo 1987).

Each step goes on by one column or by one row, so after t steps both add up to t. The beam is then in the
cell whose falling diagonal it crosses, at a height x(t) that grows evenly:

    +-----+-----+-----+
    |     |     |\ 3 *|      * * *   the beam
    |     |     | \ * |      \       falling diagonal of the cell of step t = 1, 2, 3
    |     |     |  *  |
    +-----+-----+-----+      x(t) = v + (t + 1 - u - v) |dv| / (|du| + |dv|)
    |\    |\ 1 *|* 2  |      row m(t) = floor(x(t))
    | *  *|* *  |  \  |      column  t - m(t)
    |*  \ |  \  |   \ |
    +-----+-----+-----+

where (u, v) is where the beam starts in its first cell and (du, dv) the vector to its end, both turned so
that the beam goes to the upper right and is longer than it is high: what are rows here are columns for
others.

x is kept in fixed point, as in bresenham: there is no branch and no division per cell, and no error
piles up. An error of x displaces the place where the beam changes rows by the error over the slope, so the
fraction takes all the bits that the beam's rise leaves; a rise of one row, which a slope of nearly 0 may
have, is placed by one division instead. For M columns that place is then right to M^2 / 2^60 cells, less
than 1e-6 for every M below 2^20.

`ends` and `lines` are those of projection.Beams, `window` is the contents of a CellRect, `constants`
what cells.updates need; cells are addressed as in tiles.store.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.cells.updates import ended, passed
from ogm_core.lattice import CellRect
from ogm_core.sensor_models.beams import HIT, IX, IX0, IY, IY0, KIND, SKIPPED, Plain
from ogm_core.sensor_models.bresenham import counted_from, last_in_strip, left_in_tile, steps_inside
from ogm_core.sensor_models.strip_work import work_of_beams
from ogm_core.sensor_models.tiles_around import tiles_around
from ogm_core.tiles.marks import mark, mark_rows, touch_rows, unmarked
from ogm_core.tiles.store import TILE, TILE_BITS

CUT = 32
"""Parts for threads begin at every so many-th column: none writes into a cache line of another's."""
CELL_WORK = 1.8
"""How much work a cell is: one along Bresenham's line is 1."""
_BITS = 61
"""Of a fixed-point number: what is left beside the sign and the carry."""


class Stairs(NamedTuple):
    """A beam's way from its first cell: t counts the steps.

    `along_i` says whether i is the major axis, `si` and `sj` are the signs of i and j, `columns` and `rows`
    the cells to the end along the major and the minor axis. m(t) is the integer part of first + t * step,
    which has `bits` behind the point. `stretch` is how many steps one column takes.
    """

    along_i: bool
    si: int
    sj: int
    columns: int
    rows: int
    first: int
    step: int
    bits: int
    stretch: float


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def staircase(di: int, dj: int, gap_u: float, gap_v: float, du: float, dv: float) -> Stairs:
    """What is needed to walk a beam by (du, dv), to the cell that is (di, dj) away.

    The edges of its first cell lie gap_u and gap_v ahead of its start, all in cells.
    """
    si, sj = 1 if du > 0.0 else -1, 1 if dv > 0.0 else -1
    along_i = abs(du) >= abs(dv)
    columns, rows = (abs(di), abs(dj)) if along_i else (abs(dj), abs(di))
    gap, rest = (gap_u, gap_v) if along_i else (gap_v, gap_u)
    length, height = (abs(du), abs(dv)) if along_i else (abs(dv), abs(du))
    steps = columns + rows
    if steps == 0 or rows == 0:
        return Stairs(along_i, si, sj, columns, rows, 0, 0, 0, 1.0)
    rise = height / (length + height)
    bits = _BITS - math.frexp(float(rows + 1))[1]
    one = 1 << bits
    if rows == 1:
        # The one change of rows lies rest / slope ahead: there the number of steps is `change`.
        ahead = min(max(np.ceil(rest * length / height - gap), 0.0), float(columns))
        change = int(ahead) + 1
        step = one // (steps + 1)
        first = one - change * step
    else:
        start = 1.0 - rest + rise * (gap + rest - 1.0)
        # Rounding must lead neither below row 0 nor anywhere else than to the end cell.
        first = min(max(int(start * one), 0), one - 1)
        last = int((start + steps * rise) * one)
        last = min(max(last, rows * one + steps), (rows + 1) * one - 1)
        step = (last - first) // steps
    return Stairs(along_i, si, sj, columns, rows, first, step, bits, (length + height) / length)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def row_at(stairs: Stairs, t: int) -> int:
    """m(t)."""
    return (stairs.first + t * stairs.step) >> stairs.bits


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def last_in_column(stairs: Stairs, column: int) -> int:
    """The last t with column t - m(t), or one farther back, for a beam without end."""
    if stairs.rows == 0:
        return column
    t = int((column + 1) * stairs.stretch)
    while t - row_at(stairs, t) > column:
        t -= 1
    while t + 1 - row_at(stairs, t + 1) <= column:
        t += 1
    return t


@njit(cache=True, nogil=True, error_model="numpy")
def clip(i0: int, j0: int, stairs: Stairs, width: int, height: int) -> tuple[int, int]:
    """First and last step t >= 1 whose cells lie in [0, width) x [0, height); first > last if none."""
    along_i, si, sj, columns, rows, first, step, bits, _ = stairs
    i1 = i0 + si * (columns if along_i else rows)
    j1 = j0 + sj * (rows if along_i else columns)
    if min(i0, i1, j0, j1) >= 0 and max(i0, i1) < width and max(j0, j1) < height:
        return 1, columns + rows
    major, sign, size = (i0, si, width) if along_i else (j0, sj, height)
    minor, sign_aside, size_aside = (j0, sj, height) if along_i else (i0, si, width)
    nearest, farthest = (-major, size - 1 - major) if sign > 0 else (major - size + 1, major)
    if nearest > columns or farthest < 0:
        return 1, 0
    begin = 1 if nearest <= 0 else last_in_column(stairs, nearest - 1) + 1
    end = columns + rows if farthest >= columns else last_in_column(stairs, farthest)
    return steps_inside(max(begin, 1), end, first, step, minor, sign_aside, size_aside, rows, bits)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _stairs_of(
    ends: NDArray[np.int64], lines: NDArray[np.float64], b: int, window: CellRect
) -> tuple[int, int, Stairs, int, int]:
    """Start cell of beam `b`, its stairs, first and last step inside the window."""
    i0, j0, i1, j1 = counted_from(window, ends, b)
    if ends[KIND, b] == SKIPPED or max(i0, i1) < 0 or min(i0, i1) >= window.width:
        return i0, j0, Stairs(True, 1, 1, 0, 0, 0, 0, 0, 1.0), 1, 0
    stairs = staircase(i1 - i0, j1 - j0, lines[0, b], lines[1, b], lines[2, b], lines[3, b])
    if stairs.columns + stairs.rows == 0:
        return i0, j0, stairs, 1, 0
    first, last = clip(i0, j0, stairs, window.width, window.height)
    return i0, j0, stairs, first, last


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _cell_at(i0: int, j0: int, stairs: Stairs, t: int) -> tuple[int, int]:
    row = row_at(stairs, t)
    if stairs.along_i:
        return i0 + stairs.si * (t - row), j0 + stairs.sj * row
    return i0 + stairs.si * row, j0 + stairs.sj * (t - row)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _last_in_strip(i: int, stairs: Stairs, t: int, last: int) -> int:
    """The last step, up to `last`, in the same strip as step `t`, which is in column `i` of the map."""
    left = left_in_tile(i, stairs.si)
    row = row_at(stairs, t)
    if stairs.along_i:
        return last if t - row + left >= stairs.columns else min(last, last_in_column(stairs, t - row + left))
    if row + left >= stairs.rows:
        return last
    return last_in_strip(t, last, left, stairs.first, stairs.step, stairs.bits)


@njit(cache=True, error_model="numpy")
def extent(ends: NDArray[np.int64], lines: NDArray[np.float64]) -> tuple[int, int, int, int]:
    """Smallest rectangle (ix, iy, width, height) that holds every cell that the beams update.

    A beam is monotone in both axes, so its first and last cells span it. Width is 0 if nothing is updated.
    """
    imin = jmin = 2**62
    imax = jmax = -(2**62)
    for b in range(ends.shape[1]):
        i1, j1, i0, j0 = ends[IX, b], ends[IY, b], ends[IX0, b], ends[IY0, b]
        if ends[KIND, b] == SKIPPED or (i1 == i0 and j1 == j0):
            continue
        imin, imax = min(imin, i1), max(imax, i1)
        jmin, jmax = min(jmin, j1), max(jmax, j1)
        if imin <= i0 <= imax and jmin <= j0 <= jmax:
            continue
        stairs = staircase(i1 - i0, j1 - j0, lines[0, b], lines[1, b], lines[2, b], lines[3, b])
        i, j = _cell_at(i0, j0, stairs, 1)
        imin, imax = min(imin, i), max(imax, i)
        jmin, jmax = min(jmin, j), max(jmax, j)
    if imax < imin:
        return 0, 0, 0, 0
    return imin, jmin, imax - imin + 1, jmax - jmin + 1


@njit(cache=True, error_model="numpy")
def touch_tiles(
    ends: NDArray[np.int64],
    lines: NDArray[np.float64],
    window: Plain,
    touched: NDArray[np.int64],
    revision: int,
) -> int:
    """Write `revision` into every tile that the beams will update, and return how many held 0 before.

    Only cells in `window` count; `touched`, shape (tiles in x, tiles in y), begins in its corner. Within a
    strip a beam goes from one row to the next, so it meets every tile from its first cell's to its last's.
    """
    window = CellRect(*window)
    fresh = 0
    for b in range(ends.shape[1]):
        i0, j0, stairs, t, last = _stairs_of(ends, lines, b, window)
        while t <= last:
            i, j = _cell_at(i0, j0, stairs, t)
            end = _last_in_strip(i, stairs, t, last)
            fresh += touch_rows(touched, i, j, _cell_at(i0, j0, stairs, end)[1], revision)
            t = end + 1
    return fresh


def strip_work(
    ends: NDArray[np.int64],
    lines: NDArray[np.float64],
    window: Plain,
    work: NDArray[np.float64],
) -> None:
    """Add to `work` about how many cells will be updated in each CUT columns of the window."""
    work_of_beams(ends, 0, window, CUT, work)


@njit(cache=True, nogil=True, error_model="numpy")
def update_cells(
    ends: NDArray[np.int64],
    lines: NDArray[np.float64],
    window: Plain,
    touched: NDArray[np.int64],
    revision: int,
    cells: NDArray[Any],
    column: NDArray[np.int64],
    constants: Plain,
) -> tuple[int, int]:
    """Add the scan's evidence to the cells, beam after beam, and write `revision` into their tiles.

    Returns the number of cell updates and of tiles that held 0 before. Only cells in `window` are updated;
    `column` begins in its corner, `touched` with the tile that holds it. The sensor's own cell never is.

    A beam is cut where it enters another strip: within one, every step along the major axis changes the
    address by `ahead`, and one along the minor axis by `climb` more. Unsigned addresses spare numba's check
    for negative indices.
    """
    window, west = CellRect(*window), column[0] & (TILE - 1)
    tiles = tiles_around(ends, window, west)
    updates, fresh = 0, unmarked(touched, tiles)
    for b in range(ends.shape[1]):
        i0, j0, stairs, t, last = _stairs_of(ends, lines, b, window)
        if t > last:
            continue
        updates += last - t + 1
        hit_inside = ends[KIND, b] == HIT and last == stairs.columns + stairs.rows
        last_free = last - int(hit_inside)
        upward = stairs.sj << TILE_BITS
        ahead = stairs.si if stairs.along_i else upward
        climb = (upward if stairs.along_i else stairs.si) - ahead
        step, bits = stairs.step, stairs.bits
        while t <= last_free:
            i, j = _cell_at(i0, j0, stairs, t)
            end = _last_in_strip(i + west, stairs, t, last_free)
            mark_rows(touched, i + west, j, _cell_at(i0, j0, stairs, end)[1], revision)
            acc = stairs.first + (t - 1) * step
            base = column[np.uint64(i)] + (j << TILE_BITS) - ((acc + step) >> bits) * climb - ahead
            for _ in range(end - t + 1):
                acc += step
                base += ahead
                address = np.uint64(base + (acc >> bits) * climb)
                cells[address] = passed(cells[address], 1.0, constants)
            t = end + 1
        if hit_inside:
            i, j = ends[IX, b] - window.ix, ends[IY, b] - window.iy
            address = np.uint64(column[np.uint64(i)] + (j << TILE_BITS))
            cells[address] = ended(cells[address], 1.0, constants)
            mark(touched, i + west, j, revision)
    return updates, fresh - unmarked(touched, tiles)
