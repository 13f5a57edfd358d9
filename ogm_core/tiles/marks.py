"""Dirty tiles: each keeps the revision of the last scan that wrote it.

`touched`, int64, shape (tiles in x, tiles in y), is that of store.TileStore; 0 stands for never.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.tiles.store import TILE_BITS


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def touch(touched: NDArray[np.int64], i: int, j: int, revision: int) -> int:
    """Write `revision` into the tile of cell (i, j); return 1 if it held 0, else 0."""
    tile = np.uint64(i >> TILE_BITS), np.uint64(j >> TILE_BITS)
    before = touched[tile]
    if before == revision:
        return 0  # at once: the loops around this take half as long again if both ways go on together
    touched[tile] = revision
    return int(before == 0)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def touch_rows(touched: NDArray[np.int64], i: int, j: int, end: int, revision: int) -> int:
    """Write `revision` into all tiles from cell (i, j) to (i, end); return how many held 0."""
    fresh = 0
    for row in range(min(j, end) >> TILE_BITS, (max(j, end) >> TILE_BITS) + 1):
        fresh += touch(touched, i, row << TILE_BITS, revision)
    return fresh


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def mark(touched: NDArray[np.int64], i: int, j: int, revision: int) -> None:
    """Write `revision` into the tile of cell (i, j).

    Kernels that update cells do no more there, and count `unmarked` tiles before and after: to look at the
    tile in between takes up to a seventh of their time.
    """
    touched[np.uint64(i >> TILE_BITS), np.uint64(j >> TILE_BITS)] = revision


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def mark_rows(touched: NDArray[np.int64], i: int, j: int, end: int, revision: int) -> None:
    """Write `revision` into all tiles from cell (i, j) to (i, end)."""
    for row in range(min(j, end) >> TILE_BITS, (max(j, end) >> TILE_BITS) + 1):
        mark(touched, i, row << TILE_BITS, revision)


@njit(cache=True, nogil=True, error_model="numpy")
def unmarked(touched: NDArray[np.int64], tiles: tuple[int, int, int, int]) -> int:
    """How many tiles hold 0, from a first column to an end one, and from a first row to an end one."""
    left, right, bottom, top = tiles
    count = 0
    for x in range(left, right):
        for y in range(bottom, top):
            count += int(touched[np.uint64(x), np.uint64(y)] == 0)
    return count
