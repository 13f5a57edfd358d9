"""Traversal `bresenham`: the cells that a beam passes, and what the kernels do with them.

Bresenham's line (1965) from the sensor's cell (i0, j0) to the end cell: with M the larger and m the smaller
of |di|, |dj|, step k = 1 ... M moves one cell along the major axis and stands

    s(k) = floor((2 k m + M - 1) / (2 M))

cells along the minor one. That is the integer error form (err = |di| - |dj|; ...) solved for k. It is kept
in fixed point, 42 bits behind the point, acc(k) = floor((M - 1) 2^41 / M) + k ceil(m 2^42 / M), and
s(k) = acc(k) >> 42 is exact for every M below 2^20.5: the rounding errors add up to less than M / 2^42, and
no s(k) is nearer than 1 / (2 M) to the next integer without being one. Shifts and adds need no branch per
cell, and k need not begin at 1, so a beam that is clipped at a map's bounds costs only the cells inside.

Cells are addressed as in ogm_core.strips: address(i, j) = column[i] + 64 j. `beams` are the rows of
ogm_core.projection.Beams.cells, shape (5, N).
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.beams import HIT, SKIPPED
from ogm_core.cell_updates import TILE_BITS, add_free, add_occupied
from ogm_core.lattice import CellRect
from ogm_core.logodds import Update

FRACTION_BITS = 42


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def fixed_point(major: int, minor: int) -> tuple[int, int]:
    """Bias acc(0) and step of the fixed-point minor coordinate of a line; major >= 1."""
    bias = ((major - 1) << (FRACTION_BITS - 1)) // major
    step = ((minor << FRACTION_BITS) + major - 1) // major
    return bias, step


@njit(cache=True, nogil=True, error_model="numpy")
def steps_inside(
    first: int, last: int, bias: int, step: int, start: int, sign: int, size: int, farthest: int
) -> tuple[int, int]:
    """Narrow steps `first` ... `last` to those whose minor coordinate lies in [0, size).

    The coordinate of step k is start + sign * s(k), and s(k) runs from 0 to `farthest`.
    """
    nearest_inside = -start if sign > 0 else start - size + 1
    farthest_inside = size - 1 - start if sign > 0 else start
    if farthest_inside < 0 or nearest_inside > farthest:
        return 1, 0
    if nearest_inside > 0:
        first = max(first, -((bias - (nearest_inside << FRACTION_BITS)) // step))
    if farthest_inside < farthest:
        last = min(last, (((farthest_inside + 1) << FRACTION_BITS) - 1 - bias) // step)
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
        return steps_inside(first, last, bias, step, j0, sj, height, dj)
    first = max(1, -j0 if sj > 0 else j0 - height + 1)
    last = min(dj, height - 1 - j0 if sj > 0 else j0)
    return steps_inside(first, last, bias, step, i0, si, width, di)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def counted_from(window: CellRect, beams: NDArray[np.int64], b: int) -> tuple[int, int, int, int]:
    """Start and end cell of beam `b`, counted from the window's lower-left cell."""
    return beams[3, b] - window.ix, beams[4, b] - window.iy, beams[0, b] - window.ix, beams[1, b] - window.iy


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def clipped_line(
    i0: int, j0: int, i1: int, j1: int, width: int, height: int
) -> tuple[bool, int, int, int, int, int, int, int]:
    """What is needed to walk a line inside [0, width) x [0, height).

    Returns whether i is the major axis, the signs of i and j, M, bias and step of the fixed-point minor
    coordinate, and the first and last step inside; first > last if there is none.
    """
    di, dj = abs(i1 - i0), abs(j1 - j0)
    si, sj = 1 if i1 > i0 else -1, 1 if j1 > j0 else -1
    major, minor = max(di, dj), min(di, dj)
    if major == 0:
        return True, si, sj, 0, 0, 0, 1, 0
    bias, step = fixed_point(major, minor)
    first, last = clip(i0, j0, i1, j1, bias, step, width, height)
    return di >= dj, si, sj, major, bias, step, first, last


@njit(cache=True, nogil=True, error_model="numpy")
def extent(beams: NDArray[np.int64]) -> tuple[int, int, int, int]:
    """Smallest rectangle (ix, iy, width, height) that holds every cell that the beams update.

    A line is monotone in both axes, so its first and last cells span it. Width is 0 if nothing is updated.
    """
    imin = jmin = 2**62
    imax = jmax = -(2**62)
    for k in range(beams.shape[1]):
        i0, j0 = beams[3, k], beams[4, k]
        di, dj = beams[0, k] - i0, beams[1, k] - j0
        major, minor = max(abs(di), abs(dj)), min(abs(di), abs(dj))
        if beams[2, k] == SKIPPED or major == 0:
            continue
        aside = (2 * minor + major - 1) // (2 * major)
        ahead_i, ahead_j = (1, aside) if abs(di) >= abs(dj) else (aside, 1)
        first_i = i0 + (ahead_i if di > 0 else -ahead_i)
        first_j = j0 + (ahead_j if dj > 0 else -ahead_j)
        imin = min(imin, first_i, beams[0, k])
        imax = max(imax, first_i, beams[0, k])
        jmin = min(jmin, first_j, beams[1, k])
        jmax = max(jmax, first_j, beams[1, k])
    if imax < imin:
        return 0, 0, 0, 0
    return imin, jmin, imax - imin + 1, jmax - jmin + 1


@njit(cache=True, nogil=True, error_model="numpy")
def touch_tiles(
    beams: NDArray[np.int64],
    window: CellRect,
    touched: NDArray[np.int64],
    revision: int,
) -> int:
    """Write `revision` into every tile that the beams will update, and return how many held 0 before.

    Only cells in `window` count; `touched`, shape (tiles in x, tiles in y), begins in its corner. Between two
    tile edges of its major axis a line meets at most two tiles: those of the piece's first and last cell.
    """
    fresh = 0
    for b in range(beams.shape[1]):
        if beams[2, b] == SKIPPED:
            continue
        i0, j0, i1, j1 = counted_from(window, beams, b)
        along_i, si, sj, _, bias, step, k, last = clipped_line(i0, j0, i1, j1, window.width, window.height)
        while k <= last:
            along, sign = (i0 + si * k, si) if along_i else (j0 + sj * k, sj)
            left = 63 - (along & 63) if sign > 0 else along & 63
            end = min(k + left, last)
            for q in (k, end):
                aside = (bias + q * step) >> FRACTION_BITS
                i = i0 + si * (q if along_i else aside)
                j = j0 + sj * (aside if along_i else q)
                tile = i >> TILE_BITS, j >> TILE_BITS
                if touched[tile] == 0:
                    fresh += 1
                touched[tile] = revision
            k = end + 1
    return fresh


@njit(cache=True, nogil=True, error_model="numpy")
def update_cells(
    beams: NDArray[np.int64],
    window: CellRect,
    cells: NDArray[Any],
    column: NDArray[np.int64],
    update: Update,
) -> int:
    """Add the scan's evidence to the cells, beam after beam; return the number of cell updates.

    Only cells in `window` are touched; the store of `cells` begins in its corner. The sensor's own cell is
    never updated. Unsigned addresses spare numba's check for negative indices.
    """
    updates = 0
    for b in range(beams.shape[1]):
        if beams[2, b] == SKIPPED:
            continue
        i0, j0, i1, j1 = counted_from(window, beams, b)
        along_i, si, sj, major, bias, step, first, last = clipped_line(
            i0, j0, i1, j1, window.width, window.height
        )
        if first > last:
            continue
        updates += last - first + 1
        hit_inside = beams[2, b] == HIT and last == major
        acc = bias + (first - 1) * step
        free_steps = last - first + (0 if hit_inside else 1)
        if along_i:
            i = i0 + si * (first - 1)
            for _ in range(free_steps):
                acc += step
                i += si
                address = np.uint64(column[np.uint64(i)] + ((j0 + sj * (acc >> FRACTION_BITS)) << TILE_BITS))
                cells[address] = add_free(cells[address], update)
        else:
            row = (j0 + sj * (first - 1)) << TILE_BITS
            row_step = sj << TILE_BITS
            for _ in range(free_steps):
                acc += step
                row += row_step
                address = np.uint64(column[np.uint64(i0 + si * (acc >> FRACTION_BITS))] + row)
                cells[address] = add_free(cells[address], update)
        if hit_inside:
            address = np.uint64(column[np.uint64(i1)] + (j1 << TILE_BITS))
            cells[address] = add_occupied(cells[address], update)
    return updates
