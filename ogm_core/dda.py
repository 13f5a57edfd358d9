"""Traversal `dda`: every cell that a beam passes through (Amanatides & Woo 1987), in closed form.

With the major axis the one along which the beam is longer, the beam climbs by `slope` <= 1 cells from one
column of the major axis to the next. q counts columns from the sensor's, m(q) is the row in which the beam
enters column q, both counted from the sensor's cell, so column q holds rows m(q) to m(q + 1):

    m       .  .  .  .  +--+        column 0 holds what the beam passes before its first column edge, less the
    2       .  .  .  +--+##|        sensor's own cell; the last column ends at the end cell
    1       .  +--+--+##+--+
    0       S##+##+##+--+  .        m(q) = floor(side + (gap + q - 1) slope)
            q  1  2  3  4

where `gap` is the way to the first column edge and `side` the height at which the beam starts in its cell.
As in ogm_core.bresenham, m(q) is an integer part in fixed point: neither a branch nor a rounding error piles
up along the beam. An error of m displaces the place where the beam changes rows by the error over the slope,
so the fraction takes all the bits that the beam's rise leaves; a rise of one row, which a slope of nearly 0
may have, is placed by one division instead. For M columns that place is then right to M^2 / 2^60 cells, less
than 1e-6 for every M below 2^20.

`beams` and `lines` are the rows of ogm_core.projection.Beams; cells are addressed as in ogm_core.strips.
"""

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.beams import HIT, SKIPPED
from ogm_core.bresenham import counted_from
from ogm_core.cell_updates import add_free, add_occupied
from ogm_core.lattice import CellRect
from ogm_core.logodds import Update
from ogm_core.strips import TILE_BITS

_BITS = 61
"""Of a fixed-point number: what is left beside the sign and the carry."""
_BITS_OF_ONE_ROW = 41
"""Enough to tell one column from the next, few enough for their number: M^2 < 2^41."""


@njit(cache=True, nogil=True, error_model="numpy")
def staircase(
    di: int, dj: int, gap_u: float, gap_v: float, du: float, dv: float
) -> tuple[bool, int, int, int, int, int, int, int]:
    """What is needed to walk a beam by (du, dv), to the cell that is (di, dj) away.

    The edges of its first cell lie gap_u and gap_v ahead of its start, all in cells.

    Returns whether i is the major axis, the signs of i and j, the columns and rows to the end cell, and m(1)
    in fixed point, its step and the number of its fraction bits.
    """
    si, sj = 1 if du > 0.0 else -1, 1 if dv > 0.0 else -1
    along_i = abs(du) >= abs(dv)
    major, minor = (abs(di), abs(dj)) if along_i else (abs(dj), abs(di))
    gap, rest = (gap_u, gap_v) if along_i else (gap_v, gap_u)
    if major == 0 or minor == 0:
        return along_i, si, sj, major, minor, 0, 0, 0
    slope = abs(dv) / abs(du) if along_i else abs(du) / abs(dv)
    if minor == 1:
        # The one change of rows lies rest / slope ahead, in the column before number `after`.
        after = int(min(max(math.ceil(rest / slope - gap), 0.0), float(major))) + 1
        step = ((1 << _BITS_OF_ONE_ROW) + after - 1) // after
        return along_i, si, sj, major, minor, step, step, _BITS_OF_ONE_ROW
    bits = _BITS - math.frexp(float(minor))[1]
    one = math.ldexp(1.0, bits)
    return along_i, si, sj, major, minor, int((1.0 - rest + gap * slope) * one), int(slope * one), bits


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def rows_of_column(q: int, major: int, minor: int, first: int, step: int, bits: int) -> tuple[int, int]:
    """First and last row that the beam updates in column q; none if first > last."""
    low = min((first + (q - 1) * step) >> bits, minor) if q > 0 else 1
    high = min((first + q * step) >> bits, minor) if q < major else minor
    return low, high


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def span_inside(start: int, sign: int, size: int, farthest: int) -> tuple[int, int]:
    """The steps k in 0 ... farthest for which start + sign * k lies in [0, size)."""
    if sign > 0:
        return max(0, -start), min(farthest, size - 1 - start)
    return max(0, start - size + 1), min(farthest, start)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def inside(
    window: CellRect, along_i: bool, i0: int, j0: int, si: int, sj: int, major: int, minor: int
) -> tuple[int, int, int, int]:
    """First and last column, lowest and highest row of a beam that lie in the window."""
    if along_i:
        first, last = span_inside(i0, si, window.width, major)
        lowest, highest = span_inside(j0, sj, window.height, minor)
    else:
        first, last = span_inside(j0, sj, window.height, major)
        lowest, highest = span_inside(i0, si, window.width, minor)
    return first, last, lowest, highest


@njit(cache=True, nogil=True, error_model="numpy")
def extent(beams: NDArray[np.int64], lines: NDArray[np.float64]) -> tuple[int, int, int, int]:
    """Smallest rectangle (ix, iy, width, height) that holds every cell that the beams update.

    A beam is monotone in both axes, so its first and last cells span it. Width is 0 if nothing is updated.
    """
    imin = jmin = 2**62
    imax = jmax = -(2**62)
    for b in range(beams.shape[1]):
        i1, j1, i0, j0 = beams[0, b], beams[1, b], beams[3, b], beams[4, b]
        if beams[2, b] == SKIPPED or (i1 == i0 and j1 == j0):
            continue
        along_i, si, sj, major, minor, first, step, bits = staircase(
            i1 - i0, j1 - j0, lines[0, b], lines[1, b], lines[2, b], lines[3, b]
        )
        low, high = rows_of_column(0, major, minor, first, step, bits)
        q, m = (0, 1) if low <= high else (1, 0)
        i, j = (i0 + si * q, j0 + sj * m) if along_i else (i0 + si * m, j0 + sj * q)
        imin, imax = min(imin, i, i1), max(imax, i, i1)
        jmin, jmax = min(jmin, j, j1), max(jmax, j, j1)
    if imax < imin:
        return 0, 0, 0, 0
    return imin, jmin, imax - imin + 1, jmax - jmin + 1


@njit(cache=True, nogil=True, error_model="numpy")
def touch_tiles(
    beams: NDArray[np.int64],
    lines: NDArray[np.float64],
    window: CellRect,
    touched: NDArray[np.int64],
    revision: int,
) -> int:
    """Write `revision` into every tile that the beams will update, and return how many held 0 before.

    Only cells in `window` count; `touched`, shape (tiles in x, tiles in y), begins in its corner. Between two
    tile edges of its major axis a beam climbs by at most 64 rows, so its lowest and highest row there tell
    the tiles.
    """
    fresh = 0
    for b in range(beams.shape[1]):
        if beams[2, b] == SKIPPED:
            continue
        i0, j0, i1, j1 = counted_from(window, beams, b)
        along_i, si, sj, major, minor, first, step, bits = staircase(
            i1 - i0, j1 - j0, lines[0, b], lines[1, b], lines[2, b], lines[3, b]
        )
        start, sign = (i0, si) if along_i else (j0, sj)
        q, last, lowest, highest = inside(window, along_i, i0, j0, si, sj, major, minor)
        while q <= last:
            here = start + sign * q
            end = min(q + (63 - (here & 63) if sign > 0 else here & 63), last)
            low, high = rows_of_column(q, major, minor, first, step, bits)
            if q == 0 and low > high:
                low = 0 if end > 0 else low  # the beam leaves column 0 in the sensor's own row
            if end > q:
                high = rows_of_column(end, major, minor, first, step, bits)[1]
            low, high = max(low, lowest), min(high, highest)
            m = low
            while m <= high:
                tile = (
                    (i0 + si * (q if along_i else m)) >> TILE_BITS,
                    (j0 + sj * (m if along_i else q)) >> TILE_BITS,
                )
                if touched[tile] == 0:
                    fresh += 1
                touched[tile] = revision
                m = high if m < high < m + 64 else m + 64
            q = end + 1
    return fresh


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _middle_columns(
    i0: int,
    j0: int,
    si: int,
    sj: int,
    along_i: bool,
    major: int,
    minor: int,
    first: int,
    step: int,
    bits: int,
    cells: NDArray[Any],
    column: NDArray[np.int64],
    update: Update,
) -> int:
    """Update the columns between the first and the last of a beam that lies wholly inside; count the updates.

    Each holds one row or two. A second one that is not there is the first once more, with an increment of
    nothing: to do it costs less than to ask.
    """
    acc = first
    low = begin = min(first >> bits, minor)
    for q in range(1, major):
        acc += step
        high = min(acc >> bits, minor)
        free = update.free * (high - low)
        again = Update(free, update.occupied, update.lower, update.upper, update.prior)
        if along_i:
            base = column[np.uint64(i0 + si * q)]
            one = np.uint64(base + ((j0 + sj * low) << TILE_BITS))
            two = np.uint64(base + ((j0 + sj * high) << TILE_BITS))
        else:
            row = (j0 + sj * q) << TILE_BITS
            one = np.uint64(column[np.uint64(i0 + si * low)] + row)
            two = np.uint64(column[np.uint64(i0 + si * high)] + row)
        cells[one] = add_free(cells[one], update)
        cells[two] = add_free(cells[two], again)
        low = high
    return major - 1 + low - begin


@njit(cache=True, nogil=True, error_model="numpy")
def update_cells(
    beams: NDArray[np.int64],
    lines: NDArray[np.float64],
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
        if i0 == i1 and j0 == j1:
            continue
        along_i, si, sj, major, minor, first, step, bits = staircase(
            i1 - i0, j1 - j0, lines[0, b], lines[1, b], lines[2, b], lines[3, b]
        )
        begin, last, lowest, highest = inside(window, along_i, i0, j0, si, sj, major, minor)
        whole = begin == 0 and last == major and lowest == 0 and highest == minor
        ends_inside = last == major and highest == minor
        q = begin
        while q <= last:
            if whole and 0 < q < major:
                updates += _middle_columns(
                    i0, j0, si, sj, along_i, major, minor, first, step, bits, cells, column, update
                )
                q = major
            low, high = rows_of_column(q, major, minor, first, step, bits)
            low, high = max(low, lowest), min(high, highest)
            if q == major and ends_inside:
                high -= 1
            for m in range(low, high + 1):
                i, j = (i0 + si * q, j0 + sj * m) if along_i else (i0 + si * m, j0 + sj * q)
                address = np.uint64(column[np.uint64(i)] + (j << TILE_BITS))
                cells[address] = add_free(cells[address], update)
                updates += 1
            q += 1
        if ends_inside and begin <= major and lowest <= minor:
            address = np.uint64(column[np.uint64(i1)] + (j1 << TILE_BITS))
            hit = beams[2, b] == HIT
            cells[address] = add_occupied(cells[address], update) if hit else add_free(cells[address], update)
            updates += 1
    return updates
