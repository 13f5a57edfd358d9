"""First walls that beams meet in a map, against where they ended: hits, the unknown, short, long."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import MAX_INDEX, CellRect
from ogm_core.quality.agreement import BELIEF_FREE, BELIEF_OCCUPIED
from ogm_core.quality.beam_likelihood import FARTHEST, crossed_cells, most_cells
from ogm_core.quality.held_out_beams import DX, DY, RANGE, X, Y, returns_of
from ogm_core.quality.judged_map import UNKNOWN, JudgedMap
from ogm_core.snapshot import MapSnapshot
from ogm_core.types import PlacedScan

SHORTER_THAN = 15.0
"""Beams of which it is judged where they end, m."""
HIT_WITHIN, OFF_BEYOND = 0.1, 0.2
"""Within the first, a wall is a hit; off by more than the second, it is short or long; m."""


class FirstWalls(NamedTuple):
    """Shares of the returns that are shorter than SHORTER_THAN; None if there are none.

    `hit`: the first occupied cell is entered within 0.1 m of the measured range; `unknown`: an unknown cell
    comes before one (the sensor's own cell, which nobody enters, is neither); `short`, `long`: off by more
    than 0.2 m, long also where there is none up to FARTHEST.
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


def count_hits(
    snapshot: MapSnapshot, placed: PlacedScan, settings: GridSettings, most: int
) -> tuple[int, int]:
    """How many returns of a scan, of about `most` of its beams, are hits, and how many are judged.

    For a scan on its way into the map: looked at are only the cells around it.
    """
    beams = max(1, placed.scan.ranges.size)
    rays = returns_of(placed, settings, -(-beams // most))
    rays = rays[rays[:, RANGE] < SHORTER_THAN]
    around = _around(snapshot, rays)
    if not around.cells:
        return 0, len(rays)
    judged = JudgedMap.of(snapshot.part(around))
    hits = count_early_walls(rays, judged.in_cells(rays), judged.resolution, judged.classes)
    return int(hits), len(rays)


def _around(snapshot: MapSnapshot, rays: NDArray[np.float64]) -> CellRect:
    """The cells of a map that hold some rays, and what lies around their ends."""
    if not len(rays):
        return CellRect(*snapshot.offset, 0, 0)
    starts = rays[:, [X, Y]]
    points = snapshot.lattice.in_cells(
        np.concatenate([starts, starts + rays[:, [RANGE]] * rays[:, [DX, DY]]])
    )
    margin = HIT_WITHIN / snapshot.lattice.resolution + 1.0
    low, high = (np.clip(edge, -MAX_INDEX, MAX_INDEX) for edge in (points.min(axis=0), points.max(axis=0)))
    (west, south), (east, north) = (
        np.floor(edge).astype(np.int64).tolist() for edge in (low - margin, high + margin)
    )
    return CellRect(west, south, east - west + 1, north - south + 1).intersection(snapshot.rect)


@njit(cache=True, nogil=True, error_model="numpy")
def count_early_walls(
    rays: NDArray[np.float64],
    starts: NDArray[np.float64],
    resolution: float,
    classes: NDArray[np.uint8],
) -> int:
    """How many rays are hits: followed no farther than to where one would have to be."""
    room = most_cells(resolution)
    found, ends = np.empty(room, np.int64), np.empty(room)
    hits = 0
    for k in range(len(rays)):
        longest = (rays[k, RANGE] + HIT_WITHIN) / resolution
        n = crossed_cells(rays[k], starts[k, 0], starts[k, 1], longest, classes, UNKNOWN, found, ends)
        i = first_stop(found, n)
        if i < n and found[i] == BELIEF_OCCUPIED:
            hits += abs(ends[i - 1] * resolution - rays[k, RANGE]) < HIT_WITHIN
    return hits


@njit(cache=True, nogil=True, error_model="numpy")
def first_stop(found: NDArray[np.int64], n: int) -> int:
    """The first of `n` cells that is occupied or unknown, but for the sensor's own; `n` if none is."""
    i = 1
    while i < n and found[i] not in (UNKNOWN, BELIEF_OCCUPIED):
        i += 1
    return i


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
        i = first_stop(found, n)
        if i == n:
            long += 1
        elif found[i] == UNKNOWN:
            unknown += 1
        else:
            off = ends[i - 1] * resolution - measured
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
