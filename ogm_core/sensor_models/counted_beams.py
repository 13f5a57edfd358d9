"""Counted beams: which kinds there are, how much each weighs, in which cells it begins, passes and ends.

`ends` is that of projection.Beams, in sixteenths of a cell, with the kind BEYOND. A half is half a cell wide.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.lattice import CellRect
from ogm_core.sensor_models.beams import (
    HIT,
    IX,
    IX0,
    IY,
    IY0,
    KIND,
    NO_RETURN,
    SKIPPED,
    BeamModel,
    Plain,
    reading,
)
from ogm_core.sensor_models.true_line import SUBCELL_BITS, SUBCELLS, Line

BEYOND = 3
"""Kind of beam: it answered, but from farther away than the map listens."""
_HALF_WEIGHT = 16.0
"""A beam of so many metres counts half."""
_MARGIN = 2 * SUBCELLS
"""No cell that a beam counts in lies farther outside the box around its ends, in sixteenths of a cell."""


@njit(cache=True, error_model="numpy")
def weigh(ranges: NDArray[np.float32], beam: Plain, ends: NDArray[np.int64]) -> NDArray[np.int64]:
    """The weights of the beams' ranges, in sixteenths, shape (N,); what lies BEYOND gets that kind in `ends`.

    What is so long that it would count nothing is skipped.
    """
    model = BeamModel(*beam)
    saw_nothing = model.range_max - model.alpha / 2
    weights = np.empty(ranges.size, np.int64)
    for k in range(ranges.size):
        r = float(ranges[k])
        _, _, length = reading(r, model)
        far, kind = length / _HALF_WEIGHT, ends[KIND, k]
        weights[k] = int(16.0 / (1.0 + far * far) + 0.5)
        if kind == NO_RETURN and model.reach < r < saw_nothing:
            kind = BEYOND
        ends[KIND, k] = SKIPPED if weights[k] == 0 and kind != NO_RETURN else kind
    return weights


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def cell_of(place: int) -> int:
    """The cell in which a place, in sixteenths of a cell, lies."""
    return place >> SUBCELL_BITS


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def points_in(window: CellRect, ends: NDArray[np.int64], b: int) -> tuple[bool, int, int, int, int]:
    """Whether beam `b` may count in a window, and its start and end point from the window's corner."""
    west, south = window.ix << SUBCELL_BITS, window.iy << SUBCELL_BITS
    u0, v0, u1, v1 = ends[IX0, b] - west, ends[IY0, b] - south, ends[IX, b] - west, ends[IY, b] - south
    width, height = window.width << SUBCELL_BITS, window.height << SUBCELL_BITS
    meets = (max(u0, u1) >= -_MARGIN) & (min(u0, u1) < width + _MARGIN)
    meets &= (max(v0, v1) >= -_MARGIN) & (min(v0, v1) < height + _MARGIN)
    own = ((u0 ^ u1) | (v0 ^ v1)) >> SUBCELL_BITS == 0
    return meets and not own and ends[KIND, b] != SKIPPED, u0, v0, u1, v1


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def last_passed(line: Line, kind: int) -> int:
    """The last column of cells in which a beam counts as passing, from the sensor's on."""
    return line.columns - 2 if kind == HIT else line.columns


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def cell_at(line: Line, column: int, row: int) -> tuple[int, int]:
    """Cell (i, j) of a column and a row of a line."""
    return (column, row) if line.along_i else (row, column)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def half_inside(i: int, j: int, window: CellRect) -> bool:
    """Whether a half lies in the window."""
    return (0 <= i < 2 * window.width) & (0 <= j < 2 * window.height)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def share_of_hit(q: int, along: int, across: int) -> tuple[int, int, int]:
    """The q-th of the four halves around a point in sixteenths, and its share of 64."""
    g, h = (along - 4) & 7, (across - 4) & 7
    east, north = q & 1, q >> 1
    share = (g if east else 8 - g) * (h if north else 8 - h)
    return ((along - 4) >> 3) + east, ((across - 4) >> 3) + north, share
