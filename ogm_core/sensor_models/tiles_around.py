"""Tiles around beams: where kernels look for tiles that a scan is the first to write."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.lattice import CellRect
from ogm_core.sensor_models.beams import IX, IX0, IY, IY0, KIND, SKIPPED
from ogm_core.tiles.store import TILE, TILE_BITS


@njit(cache=True, nogil=True, error_model="numpy")
def tiles_around(ends: NDArray[np.int64], window: CellRect, west: int) -> tuple[int, int, int, int]:
    """The tiles that the box around all beams meets in the window: first and end column, first and end row.

    `ends` is that of projection.Beams, in cells. Tiles are counted from the one that holds the window's
    lower-left cell, which lies `west` cells from its left edge and on its lower one.
    """
    left = bottom = 2**62
    right = top = -(2**62)
    for b in range(ends.shape[1]):
        if ends[KIND, b] != SKIPPED:
            left, right = min(left, ends[IX, b], ends[IX0, b]), max(right, ends[IX, b], ends[IX0, b])
            bottom, top = min(bottom, ends[IY, b], ends[IY0, b]), max(top, ends[IY, b], ends[IY0, b])
    left, right = max(left - window.ix, 0), min(right - window.ix, window.width - 1)
    bottom, top = max(bottom - window.iy, 0), min(top - window.iy, window.height - 1)
    if right < left or top < bottom:
        return 0, 0, 0, 0
    return (
        (left + west) >> TILE_BITS,
        (right + west + TILE) >> TILE_BITS,
        bottom >> TILE_BITS,
        (top + TILE) >> TILE_BITS,
    )
