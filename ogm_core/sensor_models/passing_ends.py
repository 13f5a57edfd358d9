"""The ends of hits: the last columns that a beam passes before one, and the hit itself, counted in halves.

`point` is the end point, in sixteenths of a cell; `weights` are that of a column, and of the range. Sums stop
at the largest number that a plane holds. Halves are addressed as in tiles.store.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.lattice import CellRect
from ogm_core.sensor_models.bresenham import FRACTION_BITS
from ogm_core.sensor_models.counted_beams import cell_at, half_inside, share_of_hit
from ogm_core.sensor_models.passed_cells import touch_at
from ogm_core.sensor_models.true_line import Line, entered, half_columns
from ogm_core.tiles.prefetching import fetch_ahead
from ogm_core.tiles.store import TILE, TILE_BITS

_MOST = 2**32 - 1
_ROW_BITS = TILE_BITS + 1
TILE_OF_HALF = 2 * _ROW_BITS
"""The number of a half's tile is its address, shifted by that."""
_COLUMNS = 3
"""So many columns of halves are passed at most, before that of the end."""


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _add(plane: NDArray[np.uint32], address: int, more: int) -> None:
    """Add to a number of a plane."""
    at = np.uint64(address)
    number: Any = np.int64(plane[at])
    plane[at] = min(number + more, _MOST)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def all_in_one_tile(
    line: Line, point: tuple[int, int], count: int, window: CellRect, column: NDArray[np.int64]
) -> bool:
    """Whether all halves in which the end counts surely lie in one tile, and in the window.

    `count` is that of `half_columns`. Towards the sensor these are up to three halves from the end's own
    along the major axis, and four along the other: where the end lies at the far side of its half, the first
    of the columns has its middle three and a half before it. On all other sides it is one.
    """
    i, j, last = point[0] >> 3, point[1] >> 3, 2 * TILE - 1
    ahead, behind = (_COLUMNS, 1) if line.sign > 0 else (1, _COLUMNS)
    below, above = (_COLUMNS + 1, 1) if line.rise > 0 else (1, _COLUMNS + 1)
    west, east, south, north = (
        (ahead, behind, below, above) if line.along_i else (below, above, ahead, behind)
    )
    across = int(i + column[0]) & last
    inside = (across >= west) & (across <= last - east)
    inside &= (j & last >= south) & (j & last <= last - north)
    inside &= half_inside(i - west, j - south, window) & half_inside(i + east, j + north, window)
    return inside & (count >= _COLUMNS - 1)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def fetch_end(line: Line, at: int, passing: NDArray[np.uint32], hits: NDArray[np.uint32]) -> None:
    """Have near by what `count_end_in_tile` will change, some hundred cells later; `at` is likewise."""
    row = 2 * TILE
    back = line.sign if line.along_i else line.sign * row
    for q in range(3):
        fetch_ahead(passing, at - q * back)
    fetch_ahead(hits, at)
    fetch_ahead(hits, at - row)
    fetch_ahead(hits, at + row)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def count_end_in_tile(
    line: Line,
    point: tuple[int, int],
    weights: tuple[int, int],
    halves: tuple[int, int, int],
    at: int,
    passing: NDArray[np.uint32],
    hits: NDArray[np.uint32],
) -> int:
    """Count the end of a hit that lies `all_in_one_tile`; returns the number of updates, hits apart.

    `halves` are those of `half_columns`, `at` is the address of the end point's own. What would be counted in
    a column too many is 0, which is cheaper than to ask.
    """
    (u, v), (weight, range_weight), (half, count, acc) = point, weights, halves
    ahead, aside = (1, 2 * TILE) if line.along_i else (2 * TILE, 1)
    i, j = (u >> 3, v >> 3) if line.along_i else (v >> 3, u >> 3)
    first = at + ahead * (2 * line.start + half - i) + aside * (2 * line.aside - j)
    for n in range(_COLUMNS):
        row = (acc + n * line.step) >> FRACTION_BITS
        _add(passing, first + ahead * line.sign * n + aside * row, weight if n < count else 0)
    _add(passing, at, (weight * entered(line) + 8) >> 4)
    corner = at - int(u & 7 < 4) - (int(v & 7 < 4) << _ROW_BITS)
    for q in range(4):
        _add(hits, corner + (q & 1) + ((q >> 1) << _ROW_BITS), share_of_hit(q, u, v)[2] * range_weight)
    return count + 1


@njit(cache=True, nogil=True, error_model="numpy")
def count_end(
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
    """Count the end of a hit wherever it lies, half by half; `touched` is flat.

    Returns the number of updates, those of hits apart, and of fresh tiles.
    """
    (u, v), (weight, range_weight), corner = point, weights, column[0] >> TILE_OF_HALF
    half, count, acc = half_columns(line)
    updates = fresh = 0
    for n in range(count + 1):
        i, j = cell_at(line, 2 * line.start + half, 2 * line.aside + (acc >> FRACTION_BITS))
        more = weight
        if n == count:
            i, j, more = u >> 3, v >> 3, (weight * entered(line) + 8) >> 4
        if half_inside(i, j, window):
            address = column[np.uint64(i)] + (j << _ROW_BITS)
            _add(passing, address, more)
            fresh += touch_at(touched, (address >> TILE_OF_HALF) - corner, revision)
            updates += 1
        acc += line.step
        half += line.sign
    for q in range(4):
        i, j, share = share_of_hit(q, u, v)
        if share and half_inside(i, j, window):
            address = column[np.uint64(i)] + (j << _ROW_BITS)
            _add(hits, address, share * range_weight)
            fresh += touch_at(touched, (address >> TILE_OF_HALF) - corner, revision)
    return updates, fresh
