"""How well a finished map explains scans: agreement with those in it, prediction of those held out."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.beams import HIT, NO_RETURN, SKIPPED, BeamModel, classify
from ogm_core.bresenham import FRACTION_BITS, clipped_line

FREE, UNDECIDED, OCCUPIED = 1, 2, 3
"""Beliefs about a cell; 0 is unknown."""
FOUND_WALL, FOUND_NOTHING, FOUND_UNKNOWN = 0, 1, 2
"""Where a cast ray ends."""


@njit(cache=True, nogil=True, error_model="numpy")
def agreement(
    ends: NDArray[np.int64], i0: int, j0: int, beliefs: NDArray[np.uint8]
) -> tuple[int, int, int, int]:
    """Hit end cells in the map and those believed occupied; traversed cells and those believed free.

    Cells are counted from the lower-left one of `beliefs`, shape (h, w), [iy, ix]; others do not count. A
    no return's end cell is a traversed one. Each beam counts its cells anew.
    """
    hits = occupied = passed = free = 0
    height, width = beliefs.shape
    for b in range(ends.shape[1]):
        if ends[2, b] == SKIPPED:
            continue
        i1, j1 = ends[0, b], ends[1, b]
        along_i, si, sj, major, bias, step, first, last = clipped_line(i0, j0, i1, j1, width, height)
        for k in range(first, last + 1):
            aside = (bias + k * step) >> FRACTION_BITS
            i, j = (i0 + si * k, j0 + sj * aside) if along_i else (i0 + si * aside, j0 + sj * k)
            if k == major and ends[2, b] == HIT:
                hits += 1
                occupied += beliefs[j, i] == OCCUPIED
            else:
                passed += 1
                free += beliefs[j, i] == FREE
    return hits, occupied, passed, free


@njit(cache=True, nogil=True, error_model="numpy")
def cast_ray(
    u: float, v: float, bearing: float, longest: float, beliefs: NDArray[np.uint8]
) -> tuple[int, float]:
    """Follow a ray from (u, v) until it enters a cell that is not free; lengths in cells.

    u, v are counted from the lower-left corner of `beliefs`, shape (h, w), [iy, ix]; what lies outside is
    unknown. The cell that the ray starts in is not asked. Returns where the ray ends (FOUND_WALL,
    FOUND_NOTHING within `longest`, FOUND_UNKNOWN for an unknown or undecided cell) and the distance at
    which it enters that cell. Amanatides & Woo 1987.
    """
    height, width = beliefs.shape
    du, dv = math.cos(bearing), math.sin(bearing)
    i, j = math.floor(u), math.floor(v)
    si, sj = 1 if du > 0.0 else -1, 1 if dv > 0.0 else -1
    next_u = (i + (si > 0) - u) / du if du != 0.0 else math.inf
    next_v = (j + (sj > 0) - v) / dv if dv != 0.0 else math.inf
    while True:
        if next_u <= next_v:
            distance = next_u
            i += si
            next_u = (i + (si > 0) - u) / du
        else:
            distance = next_v
            j += sj
            next_v = (j + (sj > 0) - v) / dv
        if distance > longest:
            return FOUND_NOTHING, longest
        if not (0 <= i < width and 0 <= j < height) or beliefs[j, i] in (0, UNDECIDED):
            return FOUND_UNKNOWN, distance
        if beliefs[j, i] == OCCUPIED:
            return FOUND_WALL, distance


@njit(cache=True, nogil=True, error_model="numpy")
def predict_ranges(
    ranges: NDArray[np.float32],
    beam: BeamModel,
    u: float,
    v: float,
    theta: float,
    resolution: float,
    shorter_than: float,
    longest: float,
    beliefs: NDArray[np.uint8],
) -> NDArray[np.float64]:
    """Cast every beam that is a hit shorter than `shorter_than` m up to `longest` m through a map.

    (u, v, theta) is the sensor's pose, in cells from the lower-left corner of `beliefs`. Returns shape
    (3, n): measured range in m, where the cast ray ends (see `cast_ray`), predicted range in m.
    """
    judged = np.empty((3, ranges.size))
    n = 0
    for k in range(ranges.size):
        measured = float(ranges[k])
        kind, _ = classify(measured, beam)
        if kind in (SKIPPED, NO_RETURN) or measured >= shorter_than:
            continue
        bearing = theta + (beam.angle_min + k * beam.angle_increment)
        found, distance = cast_ray(u, v, bearing, longest / resolution, beliefs)
        judged[0, n], judged[1, n], judged[2, n] = measured, found, distance * resolution
        n += 1
    return judged[:, :n].copy()
