"""Agreement of a finished map with scans: with those in it, and prediction of those held out."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.lattice import CellRect
from ogm_core.queries.ray_kernel import cast_ray
from ogm_core.sensor_models.beams import HIT, KIND, NO_RETURN, SKIPPED, BeamModel, classify
from ogm_core.sensor_models.bresenham import FRACTION_BITS, clipped_line, counted_from

BELIEF_FREE, BELIEF_UNDECIDED, BELIEF_OCCUPIED = 1, 2, 3
"""Beliefs about a cell; 0 is unknown."""


@njit(cache=True, nogil=True, error_model="numpy")
def agreement(
    ends: NDArray[np.int64], window: CellRect, beliefs: NDArray[np.uint8]
) -> tuple[int, int, int, int]:
    """Hit end cells in the map and those believed occupied; traversed cells and those believed free.

    Traversed are the cells of Bresenham's line, whatever made the map, so that maps compare; a no return's
    end cell is one of them. `beliefs`, [iy, ix], are those of the cells in `window`; others do not count.
    Each beam counts its cells anew.
    """
    hits = occupied = passed = free = 0
    for b in range(ends.shape[1]):
        if ends[KIND, b] == SKIPPED:
            continue
        i0, j0, i1, j1 = counted_from(window, ends, b)
        along_i, si, sj, major, bias, step, first, last = clipped_line(
            i0, j0, i1, j1, window.width, window.height
        )
        for k in range(first, last + 1):
            aside = (bias + k * step) >> FRACTION_BITS
            i, j = (i0 + si * k, j0 + sj * aside) if along_i else (i0 + si * aside, j0 + sj * k)
            if k == major and ends[KIND, b] == HIT:
                hits += 1
                occupied += beliefs[j, i] == BELIEF_OCCUPIED
            else:
                passed += 1
                free += beliefs[j, i] == BELIEF_FREE
    return hits, occupied, passed, free


@njit(cache=True, nogil=True, error_model="numpy")
def predict_ranges(
    ranges: NDArray[np.float32],
    beam: BeamModel,
    sensor: NDArray[np.float64],
    resolution: float,
    shorter_than: float,
    longest: float,
    beliefs: NDArray[np.uint8],
) -> NDArray[np.float64]:
    """Cast every beam that is a hit shorter than `shorter_than` m up to `longest` m through a map.

    `sensor` holds the sensor's poses (u, v, theta), u and v in cells from the lower-left corner of `beliefs`:
    shape (1, 3), or (N, 3) with one a beam. Returns shape
    (3, n): measured range in m, where the cast ray ends (see `ray_kernel.cast_ray`), predicted range in m.
    """
    judged = np.empty((3, ranges.size))
    n = 0
    for k in range(ranges.size):
        measured = float(ranges[k])
        kind, _ = classify(measured, beam)
        if kind in (SKIPPED, NO_RETURN) or measured >= shorter_than:
            continue
        p = k if len(sensor) > 1 else 0
        bearing = sensor[p, 2] + (beam.angle_min + k * beam.angle_increment)
        found, distance = cast_ray(
            sensor[p, 0],
            sensor[p, 1],
            math.cos(bearing),
            math.sin(bearing),
            longest / resolution,
            False,
            0,
            0,
            beliefs,
            BELIEF_FREE,
            BELIEF_OCCUPIED,
        )
        judged[0, n], judged[1, n], judged[2, n] = measured, found, distance * resolution
        n += 1
    return judged[:, :n].copy()
