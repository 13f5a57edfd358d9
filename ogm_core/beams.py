"""From a scan's ranges to end cells: which beams count, how far they reach, and in which cell they end.

Readings follow REP-117; the inverse sensor model is Thrun, Burgard & Fox 2005, table 9.2, along a ray.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.lattice import MAX_INDEX

SKIPPED, NO_RETURN, HIT = 0, 1, 2
"""Kinds of beam: no evidence; saw nothing up to its free length; ended on something."""


class BeamModel(NamedTuple):
    """What the kernels need to know of a scan and a map to say what its ranges mean; metres, radians.

    `clear_range` and `reach` are infinite where there is no such limit.
    """

    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    alpha: float
    clear_range: float
    reach: float


@njit(cache=True, nogil=True, error_model="numpy")
def classify(r: float, beam: BeamModel) -> tuple[int, float]:
    """Kind of a beam that measured `r`, and the distance of its end point from the sensor, m."""
    if math.isnan(r) or r <= 0.0 or r < beam.range_min:
        return SKIPPED, 0.0
    if r >= beam.range_max:
        return NO_RETURN, min(beam.range_max, beam.clear_range, beam.reach)
    if r >= beam.range_max - beam.alpha / 2:
        return NO_RETURN, min(r, beam.clear_range, beam.reach)
    if r > beam.reach:
        return NO_RETURN, beam.reach
    return HIT, r


@njit(cache=True, nogil=True, error_model="numpy")
def end_cells(
    ranges: NDArray[np.float32],
    beam: BeamModel,
    x: float,
    y: float,
    theta: float,
    anchor_x: float,
    anchor_y: float,
    resolution: float,
) -> tuple[bool, NDArray[np.int64]]:
    """End cell and kind of every beam of a scan taken at sensor pose (x, y, theta) in the map frame.

    Returns whether every end cell can be addressed, and int64 of shape (3, N): ix, iy, kind. A skipped
    beam's cell is (0, 0). The arithmetic is that of `Lattice.cell_of`, in the same order.
    """
    ends = np.zeros((3, ranges.size), np.int64)
    for k in range(ranges.size):
        kind, length = classify(float(ranges[k]), beam)
        if kind == SKIPPED:
            continue
        bearing = theta + (beam.angle_min + k * beam.angle_increment)
        if not math.isfinite(bearing):
            return False, ends
        u = (x + length * math.cos(bearing) - anchor_x) / resolution
        v = (y + length * math.sin(bearing) - anchor_y) / resolution
        if not (abs(u) < MAX_INDEX and abs(v) < MAX_INDEX):
            return False, ends
        ends[0, k] = math.floor(u)
        ends[1, k] = math.floor(v)
        ends[2, k] = kind
    return True, ends


@njit(cache=True, nogil=True, error_model="numpy")
def drop_outside(
    ends: NDArray[np.int64], i0: int, j0: int, ix: int, iy: int, width: int, height: int
) -> tuple[int, int]:
    """Skip the beams that start (in cell i0, j0) or end outside a rectangle of cells.

    Changes the kinds in `ends`. Returns how many beams counted before, and how many were dropped.
    """
    starts_inside = ix <= i0 < ix + width and iy <= j0 < iy + height
    counted = 0
    dropped = 0
    for k in range(ends.shape[1]):
        if ends[2, k] == SKIPPED:
            continue
        counted += 1
        i, j = ends[0, k], ends[1, k]
        if not (starts_inside and ix <= i < ix + width and iy <= j < iy + height):
            ends[2, k] = SKIPPED
            dropped += 1
    return counted, dropped
