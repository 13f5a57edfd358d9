"""Bresenham's line (traversal `bresenham`): the cells that a beam passes, and the kernels that update them.

Bresenham's line (1965) from the sensor's cell (i0, j0) to the end cell: with M the larger and m the smaller
of |di|, |dj|, step k = 1 ... M moves one cell along the major axis and stands

    s(k) = floor((2 k m + M - 1) / (2 M))

cells along the minor one. That is the integer error form (err = |di| - |dj|; ...) solved for k. It is kept
in fixed point, 42 bits behind the point, acc(k) = floor((M - 1) 2^41 / M) + k ceil(m 2^42 / M), and
s(k) = acc(k) >> 42 is exact for every M below 2^20.5: the rounding errors add up to less than M / 2^42, and
no s(k) is nearer than 1 / (2 M) to the next integer without being one. Shifts and adds need no branch per
cell, and k need not begin at 1, so a beam that is clipped at a map's bounds costs only the cells inside.

Cells are addressed as in tiles.store: address(i, j) = column[i] + 64 j. `ends` is that of
projection.Beams; `window` is the contents of a CellRect, `constants` what cells.updates need.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.cells.updates import ended, passed
from ogm_core.lattice import CellRect
from ogm_core.sensor_models.beams import HIT, IX, IX0, IY, IY0, KIND, SKIPPED, Plain
from ogm_core.sensor_models.strip_work import work_of_beams
from ogm_core.sensor_models.tiles_around import tiles_around
from ogm_core.tiles.marks import mark, mark_rows, touch, unmarked
from ogm_core.tiles.store import TILE, TILE_BITS

FRACTION_BITS = 42
CUT = 32
"""Parts for threads begin at every so many-th column: none writes into a cache line of another's."""
CELL_WORK = 1.0
"""How much work a cell is: this is the measure of all."""
_ONE = 2.0**FRACTION_BITS
_HALF = _ONE / 2.0
_LONGEST_PIECE = 4000
"""Rows that are walked in one go: addresses in fixed point stay below 2^63."""


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def slope(minor: int, major: int) -> int:
    """Step of the fixed-point minor coordinate of a line, ceil(minor 2^42 / major); |minor| <= major >= 1."""
    step = int(minor * (1.0 / major) * _ONE)
    rest = (minor << FRACTION_BITS) - step * major
    return step + int(rest > 0) + int(rest > major) - int(rest <= -major)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def fixed_point(major: int, minor: int) -> tuple[int, int]:
    """Bias acc(0) and step of the fixed-point minor coordinate of a line; major >= 1.

    Float64 quotients are right to 2^-9, so one step up or down makes them exact: much cheaper than to divide
    64-bit integers.
    """
    inverse = 1.0 / major
    bias = int((major - 1) * inverse * _HALF)
    rest = ((major - 1) << (FRACTION_BITS - 1)) - bias * major
    bias += int(rest >= major) - int(rest < 0)
    return bias, slope(minor, major)


@njit(cache=True, nogil=True, error_model="numpy")
def steps_inside(
    first: int, last: int, bias: int, step: int, start: int, sign: int, size: int, farthest: int, bits: int
) -> tuple[int, int]:
    """Narrow steps `first` ... `last` to those whose minor coordinate lies in [0, size).

    The coordinate of step k is start + sign * s(k), and s(k), which has `bits` behind the point, runs from 0
    to `farthest`.
    """
    nearest_inside = -start if sign > 0 else start - size + 1
    farthest_inside = size - 1 - start if sign > 0 else start
    if farthest_inside < 0 or nearest_inside > farthest:
        return 1, 0
    if nearest_inside > 0:
        first = max(first, -((bias - (nearest_inside << bits)) // step))
    if farthest_inside < farthest:
        last = min(last, (((farthest_inside + 1) << bits) - 1 - bias) // step)
    return first, last


@njit(cache=True, nogil=True, error_model="numpy")
def clip(
    i0: int, j0: int, i1: int, j1: int, bias: int, step: int, width: int, height: int
) -> tuple[int, int]:
    """First and last step k >= 1 whose cells lie in [0, width) x [0, height); first > last if none."""
    di, dj = abs(i1 - i0), abs(j1 - j0)
    if min(i0, i1, j0, j1) >= 0 and max(i0, i1) < width and max(j0, j1) < height:
        return 1, max(di, dj)
    si, sj = 1 if i1 > i0 else -1, 1 if j1 > j0 else -1
    if di >= dj:
        first = max(1, -i0 if si > 0 else i0 - width + 1)
        last = min(di, width - 1 - i0 if si > 0 else i0)
        return steps_inside(first, last, bias, step, j0, sj, height, dj, FRACTION_BITS)
    first = max(1, -j0 if sj > 0 else j0 - height + 1)
    last = min(dj, height - 1 - j0 if sj > 0 else j0)
    return steps_inside(first, last, bias, step, i0, si, width, di, FRACTION_BITS)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def counted_from(window: CellRect, ends: NDArray[np.int64], b: int) -> tuple[int, int, int, int]:
    """Start and end cell of beam `b`, counted from the window's lower-left cell."""
    return (
        ends[IX0, b] - window.ix,
        ends[IY0, b] - window.iy,
        ends[IX, b] - window.ix,
        ends[IY, b] - window.iy,
    )


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def clipped_line(
    i0: int, j0: int, i1: int, j1: int, width: int, height: int
) -> tuple[bool, int, int, int, int, int, int, int]:
    """What is needed to walk a line inside [0, width) x [0, height): see `walk_inside`."""
    di, dj = abs(i1 - i0), abs(j1 - j0)
    bias, step = fixed_point(max(di, dj, 1), min(di, dj))
    return walk_inside(i0, j0, i1, j1, bias, step, width, height)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def walk_inside(
    i0: int, j0: int, i1: int, j1: int, bias: int, step: int, width: int, height: int
) -> tuple[bool, int, int, int, int, int, int, int]:
    """What is needed to walk a line of this bias and step inside [0, width) x [0, height).

    Returns whether i is the major axis, the signs of i and j, M, bias and step of the fixed-point minor
    coordinate, and the first and last step inside; first > last if there is none.
    """
    di, dj = abs(i1 - i0), abs(j1 - j0)
    si, sj = 1 if i1 > i0 else -1, 1 if j1 > j0 else -1
    major = max(di, dj)
    if major == 0:
        return True, si, sj, 0, 0, 0, 1, 0
    first, last = clip(i0, j0, i1, j1, bias, step, width, height)
    return di >= dj, si, sj, major, bias, step, first, last


@njit(cache=True, nogil=True, error_model="numpy")
def _fixed_points(ends: NDArray[np.int64]) -> NDArray[np.int64]:
    """Bias and step of the lines of all beams, int64, shape (2, N).

    They are computed together, many at once: one by one each would wait until the line before is walked.
    """
    found = np.empty((2, ends.shape[1]), np.int64)
    for b in range(ends.shape[1]):
        di, dj = abs(ends[IX, b] - ends[IX0, b]), abs(ends[IY, b] - ends[IY0, b])
        found[0, b], found[1, b] = fixed_point(max(di, dj, 1), min(di, dj))
    return found


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def left_in_tile(place: int, sign: int) -> int:
    """How many more cells of its tile lie ahead of a place, seen along `sign`."""
    return TILE - 1 - (place & (TILE - 1)) if sign > 0 else place & (TILE - 1)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def signed(bias: int, step: int, sign: int) -> tuple[int, int]:
    """Bias and step whose integer part counts along `sign`: floor of (b + k s) is sign * s(k).

    For sign -1 these are -1 - bias and -step, because floor((-1 - a) / 2^42) = -floor(a / 2^42) - 1; the
    fraction wants one whole more.
    """
    return (bias, step) if sign > 0 else ((1 << FRACTION_BITS) - 1 - bias, -step)


@njit(cache=True, error_model="numpy")
def extent(ends: NDArray[np.int64]) -> tuple[int, int, int, int]:
    """Smallest rectangle (ix, iy, width, height) that holds every cell that the beams update.

    A line is monotone in both axes, so its first and last cells span it. Width is 0 if nothing is updated.
    """
    imin = jmin = 2**62
    imax = jmax = -(2**62)
    for k in range(ends.shape[1]):
        i0, j0 = ends[IX0, k], ends[IY0, k]
        di, dj = ends[IX, k] - i0, ends[IY, k] - j0
        major, minor = max(abs(di), abs(dj)), min(abs(di), abs(dj))
        if ends[KIND, k] == SKIPPED or major == 0:
            continue
        aside = int(2 * minor > major)  # s(1) = floor((2 m + M - 1) / (2 M))
        ahead_i, ahead_j = (1, aside) if abs(di) >= abs(dj) else (aside, 1)
        first_i = i0 + (ahead_i if di > 0 else -ahead_i)
        first_j = j0 + (ahead_j if dj > 0 else -ahead_j)
        imin = min(imin, first_i, ends[IX, k])
        imax = max(imax, first_i, ends[IX, k])
        jmin = min(jmin, first_j, ends[IY, k])
        jmax = max(jmax, first_j, ends[IY, k])
    if imax < imin:
        return 0, 0, 0, 0
    return imin, jmin, imax - imin + 1, jmax - jmin + 1


@njit(cache=True, error_model="numpy")
def touch_tiles(
    ends: NDArray[np.int64],
    window: Plain,
    touched: NDArray[np.int64],
    revision: int,
) -> int:
    """Write `revision` into every tile that the beams will update, and return how many held 0 before.

    Only cells in `window` count; `touched`, shape (tiles in x, tiles in y), begins in its corner. Between two
    tile edges of its major axis a line meets at most two tiles: those of the piece's first and last cell.
    """
    window = CellRect(*window)
    fresh = 0
    for b in range(ends.shape[1]):
        if ends[KIND, b] == SKIPPED:
            continue
        i0, j0, i1, j1 = counted_from(window, ends, b)
        along_i, si, sj, _, bias, step, k, last = clipped_line(i0, j0, i1, j1, window.width, window.height)
        start, sign, aside, sign_aside = (i0, si, j0, sj) if along_i else (j0, sj, i0, si)
        while k <= last:
            along = start + sign * k
            end = min(k + left_in_tile(along, sign), last)
            for at in (k, end):
                place = aside + sign_aside * ((bias + at * step) >> FRACTION_BITS)
                i, j = (along, place) if along_i else (place, along)
                fresh += touch(touched, i, j, revision)
            k = end + 1
    return fresh


def strip_work(ends: NDArray[np.int64], window: Plain, work: NDArray[np.float64]) -> None:
    """Add to `work` about how many cells will be updated in each CUT columns of the window."""
    work_of_beams(ends, 0, window, CUT, work)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def last_in_strip(k: int, last: int, left: int, bias: int, step: int, bits: int) -> int:
    """Last step, up to `last`, whose minor coordinate is at most `left` cells beyond that of step `k`."""
    beyond = (((bias + k * step) >> bits) + left + 1) << bits
    return last if bias + last * step < beyond else (beyond - 1 - bias) // step


@njit(cache=True, nogil=True, error_model="numpy")
def update_cells(
    ends: NDArray[np.int64],
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

    Unsigned addresses spare numba's check for negative indices, and signs are part of the numbers that are
    added. A line is cut at the edges of the strips: within one, where j is the major axis, the address of its
    cells is a fixed-point number itself, and one addition a cell is enough.
    """
    window, west = CellRect(*window), column[0] & (TILE - 1)
    tiles = tiles_around(ends, window, west)
    updates, fresh = 0, unmarked(touched, tiles)
    lines = _fixed_points(ends)
    for b in range(ends.shape[1]):
        if ends[KIND, b] == SKIPPED:
            continue
        i0, j0, i1, j1 = counted_from(window, ends, b)
        if max(i0, i1) < 0 or min(i0, i1) >= window.width:
            continue  # in another thread's strips, most often (see update_threads)
        along_i, si, sj, major, bias, step, first, last = walk_inside(
            i0, j0, i1, j1, lines[0, b], lines[1, b], window.width, window.height
        )
        if first > last:
            continue
        updates += last - first + 1
        hit_inside = ends[KIND, b] == HIT and last == major
        last_free = last - int(hit_inside)
        if along_i:
            acc, gain = signed(bias, step, sj)
            acc += (first - 1) * gain
            k = first
            while k <= last_free:
                i = i0 + si * k
                left = left_in_tile(i + west, si)
                end = min(k + left, last_free)
                base = column[np.uint64(i)] + (j0 << TILE_BITS) - si
                mark(touched, i + west, j0 + ((acc + gain) >> FRACTION_BITS), revision)
                for _ in range(end - k + 1):
                    acc += gain
                    base += si
                    address = np.uint64(base + ((acc >> FRACTION_BITS) << TILE_BITS))
                    cells[address] = passed(cells[address], 1.0, constants)
                mark(touched, i + west, j0 + (acc >> FRACTION_BITS), revision)
                k = end + 1
        else:
            origin, turn = signed(bias, step, si)
            gain = turn + (sj << (TILE_BITS + FRACTION_BITS))
            k = first
            while k <= last_free:
                s = (origin + k * turn) >> FRACTION_BITS
                i = i0 + s
                left = left_in_tile(i + west, si)
                end = min(k + _LONGEST_PIECE, last_in_strip(k, last_free, left, bias, step, FRACTION_BITS))
                mark_rows(touched, i + west, j0 + sj * k, j0 + sj * end, revision)
                acc = origin + (k - 1) * turn
                base = column[np.uint64(i)] - s + ((j0 + sj * (k - 1)) << TILE_BITS)
                for _ in range(end - k + 1):
                    acc += gain
                    address = np.uint64(base + (acc >> FRACTION_BITS))
                    cells[address] = passed(cells[address], 1.0, constants)
                k = end + 1
        if hit_inside:
            address = np.uint64(column[np.uint64(i1)] + (j1 << TILE_BITS))
            cells[address] = ended(cells[address], 1.0, constants)
            mark(touched, i1 + west, j1, revision)
    return updates, fresh - unmarked(touched, tiles)
