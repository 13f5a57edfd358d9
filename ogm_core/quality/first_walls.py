"""First walls that beams meet in a map, against where they ended: hits, the unknown, short, long."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.quality.agreement import BELIEF_FREE, BELIEF_OCCUPIED
from ogm_core.quality.beam_likelihood import FARTHEST, crossed_cells, most_cells
from ogm_core.quality.held_out_beams import DX, DY, RANGE
from ogm_core.quality.judged_map import UNKNOWN, JudgedMap

SHORTER_THAN = 15.0
"""Beams of which it is judged where they end, m."""
HIT_WITHIN, OFF_BEYOND = 0.1, 0.2
"""Within the first, a wall is a hit; off by more than the second, it is short or long; m."""


class FirstWalls(NamedTuple):
    """Shares of the returns that are shorter than SHORTER_THAN; None if there are none.

    `hit`: the first occupied cell is entered within 0.1 m of the measured range; `unknown`: an unknown cell
    comes before one; `short`, `long`: off by more than 0.2 m, long also where there is none up to FARTHEST.
    `false_free`: the beam ended in a free cell, and no cell within 0.1 m is occupied.
    """

    hit: float | None
    unknown: float | None
    short: float | None
    long: float | None
    false_free: float | None


def first_walls(judged: JudgedMap, rays: NDArray[np.float64]) -> FirstWalls:
    """How well a map says where beams end."""
    rays = rays[rays[:, RANGE] < SHORTER_THAN]
    if not len(rays):
        return FirstWalls(None, None, None, None, None)
    counts = count_first_walls(rays, judged.in_cells(rays), judged.resolution, judged.classes)
    return FirstWalls(*(int(count) / len(rays) for count in counts))


@njit(cache=True, nogil=True, error_model="numpy")
def count_first_walls(
    rays: NDArray[np.float64],
    starts: NDArray[np.float64],
    resolution: float,
    classes: NDArray[np.uint8],
) -> tuple[int, int, int, int, int]:
    """How many rays each field of FirstWalls counts; `starts`: in cells of `classes`."""
    room = most_cells(resolution)
    found, ends = np.empty(room, np.int64), np.empty(room)
    hit = unknown = short = long = false_free = 0
    for k in range(len(rays)):
        measured = rays[k, RANGE]
        false_free += ends_in_free(rays[k], starts[k], resolution, classes)
        n = crossed_cells(
            rays[k], starts[k, 0], starts[k, 1], FARTHEST / resolution, classes, UNKNOWN, found, ends
        )
        i = 0
        while i < n and found[i] not in (UNKNOWN, BELIEF_OCCUPIED):
            i += 1
        if i == n:
            long += 1
        elif found[i] == UNKNOWN:
            unknown += 1
        else:
            off = (ends[i - 1] * resolution if i else 0.0) - measured
            hit += abs(off) < HIT_WITHIN
            short += off < -OFF_BEYOND
            long += off > OFF_BEYOND
    return hit, unknown, short, long, false_free


@njit(cache=True, nogil=True, error_model="numpy")
def ends_in_free(
    ray: NDArray[np.float64], start: NDArray[np.float64], resolution: float, classes: NDArray[np.uint8]
) -> bool:
    """Whether a ray's end lies in a free cell, and no cell whose square comes within 0.1 m is occupied."""
    height, width = classes.shape
    length, around = ray[RANGE] / resolution, HIT_WITHIN / resolution
    u, v = start[0] + length * ray[DX], start[1] + length * ray[DY]
    i, j = math.floor(u), math.floor(v)
    if not (0 <= i < width and 0 <= j < height) or classes[j, i] != BELIEF_FREE:
        return False
    for y in range(max(0, math.floor(v - around)), min(height, math.floor(v + around) + 1)):
        for x in range(max(0, math.floor(u - around)), min(width, math.floor(u + around) + 1)):
            du, dv = max(x - u, u - (x + 1), 0.0), max(y - v, v - (y + 1), 0.0)
            if classes[y, x] == BELIEF_OCCUPIED and du * du + dv * dv <= around * around:
                return False
    return True
