"""From a scan's ranges to beams on the lattice: which count, how far they reach, where they start and end.

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
def project(
    ranges: NDArray[np.float32],
    beam: BeamModel,
    sensor: NDArray[np.float64],
    anchor_x: float,
    anchor_y: float,
    resolution: float,
    exact: bool,
) -> tuple[bool, NDArray[np.int64], NDArray[np.float64]]:
    """Project every beam of a scan onto a lattice; the rows are those of ogm_core.projection.Beams.

    `sensor` holds the sensor's poses in the map frame: shape (1, 3), or (N, 3) with one a beam. Returns
    whether every end cell can be addressed, the beams' cells, and their lines if they are to be `exact`. A
    skipped beam's end cell is (0, 0). The arithmetic is that of `Lattice.cell_of`, in the same order.
    """
    cells = np.zeros((5, ranges.size), np.int64)
    lines = np.zeros((4, ranges.size if exact else 0))
    for k in range(ranges.size):
        kind, length = classify(float(ranges[k]), beam)
        if kind == SKIPPED:
            continue
        p = k if len(sensor) > 1 else 0
        x, y = sensor[p, 0], sensor[p, 1]
        bearing = sensor[p, 2] + (beam.angle_min + k * beam.angle_increment)
        if not math.isfinite(bearing):
            return False, cells, lines
        u0, v0 = (x - anchor_x) / resolution, (y - anchor_y) / resolution
        u = (x + length * math.cos(bearing) - anchor_x) / resolution
        v = (y + length * math.sin(bearing) - anchor_y) / resolution
        if not (max(abs(u), abs(v)) < MAX_INDEX and max(abs(u0), abs(v0)) < MAX_INDEX):
            return False, cells, lines
        cells[0, k], cells[1, k] = math.floor(u), math.floor(v)
        cells[2, k] = kind
        cells[3, k], cells[4, k] = math.floor(u0), math.floor(v0)
        if exact:
            lines[0, k] = math.floor(u0) + 1 - u0 if u > u0 else u0 - math.floor(u0)
            lines[1, k] = math.floor(v0) + 1 - v0 if v > v0 else v0 - math.floor(v0)
            lines[2, k], lines[3, k] = u - u0, v - v0
    return True, cells, lines


@njit(cache=True, nogil=True, error_model="numpy")
def drop_outside(beams: NDArray[np.int64], ix: int, iy: int, width: int, height: int) -> tuple[int, int]:
    """Skip the beams whose start or end cell lies outside a rectangle of cells.

    Changes the kinds in `beams`, shape (5, N). Returns how many counted before, and how many were dropped.
    """
    counted = 0
    dropped = 0
    for k in range(beams.shape[1]):
        if beams[2, k] == SKIPPED:
            continue
        counted += 1
        starts_inside = ix <= beams[3, k] < ix + width and iy <= beams[4, k] < iy + height
        if not (starts_inside and ix <= beams[0, k] < ix + width and iy <= beams[1, k] < iy + height):
            beams[2, k] = SKIPPED
            dropped += 1
    return counted, dropped
