"""Likelihood of measured ranges in a map that says, of every cell, how often a metre of beam ends there.

A beam that has come as far as a cell ends in it with probability 1 - exp(-rate * length): Schaefer, Luft &
Burgard 2017, "An analytical lidar sensor model based on ray path information", doi 10.1109/LRA.2017.2669376.
Beside that, one reading in twenty may be anything.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.lattice import MAX_INDEX
from ogm_core.quality.held_out_beams import DX, DY, RANGE
from ogm_core.queries.crossings import begin, step

FARTHEST = 20.0
"""A beam is followed so far, m: of a longer one it counts that it came so far."""
NOISE = 0.05
"""Standard deviation of a measured range, m."""
INLIERS = 0.95
"""Share of readings that the map is to explain."""
ANY_RANGE, ANY_FAR = 0.05 / 40.0, 0.05 / 2.0
"""Density of any other reading, 1/m, evenly up to 40 m, and the probability that it is 20 m or more."""
_SIGMAS = 6.0


@njit(cache=True, nogil=True, error_model="numpy")
def crossed_cells(
    ray: NDArray[np.float64],
    u: float,
    v: float,
    longest: float,
    cells: NDArray[np.uint8],
    beyond: int,
    values: NDArray[np.int64],
    ends: NDArray[np.float64],
) -> int:
    """Follow a ray from (u, v), in cells of `cells`, [iy, ix], over a length, in cells.

    Writes the value of every cell on its way, the one that it starts in included, and at which distance it
    leaves it; `beyond` for what lies outside. Returns how many there are.
    """
    height, width = cells.shape
    if not (abs(u) < MAX_INDEX and abs(v) < MAX_INDEX):
        values[:2], ends[0], ends[1] = beyond, 0.0, longest
        return 2
    du, dv = ray[DX], ray[DY]
    i, j, next_u, next_v = begin(u, v, du, dv)
    n = 0
    while True:
        values[n] = cells[j, i] if 0 <= i < width and 0 <= j < height else beyond
        distance, i, j, next_u, next_v = step(u, v, du, dv, i, j, next_u, next_v)
        ends[n] = min(distance, longest)
        n += 1
        if not distance < longest:
            return n


@njit(cache=True, nogil=True, error_model="numpy")
def most_cells(resolution: float) -> int:
    """How many cells a beam crosses at most, as far as it is followed."""
    return math.ceil(2.0 * FARTHEST / resolution) + 4


@njit(cache=True, nogil=True, error_model="numpy")
def _explained(
    ray: NDArray[np.float64],
    start: NDArray[np.float64],
    resolution: float,
    bins: NDArray[np.uint8],
    rates: NDArray[np.float64],
    found: NDArray[np.int64],
    ends: NDArray[np.float64],
    shares: NDArray[np.float64],
) -> tuple[int, float, float]:
    """Walk a beam as far as it matters: how many cells it crosses, density of its range, what is left.

    Writes the bins of the cells, where it leaves each, m, and each one's part of the density, 1/m.
    """
    measured, unknown = ray[RANGE], len(rates) - 1
    far = measured >= FARTHEST
    widest = _SIGMAS * math.sqrt(NOISE**2 + 2.0 * resolution**2 / 12.0) + resolution
    # The last cell is cut off: it lies beyond all that counts for this range.
    longest = FARTHEST if far else min(FARTHEST, measured + widest + 2.0 * resolution)
    n = crossed_cells(ray, start[0], start[1], longest / resolution, bins, unknown, found, ends)
    density, left, entered = 0.0, 1.0, 0.0
    for i in range(n):
        ends[i] *= resolution
        length = ends[i] - entered
        gone = -left * math.expm1(-rates[found[i]] * length)
        sigma = math.sqrt(NOISE**2 + length**2 / 12.0)
        off = abs(measured - (entered + length / 2.0))
        shares[i] = 0.0
        if not far and off < _SIGMAS * sigma + resolution:
            shares[i] = gone * math.exp(-0.5 * (off / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi))
            density += shares[i]
        left -= gone
        entered = ends[i]
    return n, density, left


@njit(cache=True, nogil=True, error_model="numpy")
def probability_of_range(far: bool, density: float, left: float) -> float:
    """Density of a range, 1/m, or of a `far` one the probability, with what may be anything."""
    return INLIERS * left + ANY_FAR if far else INLIERS * density + ANY_RANGE


@njit(cache=True, nogil=True, error_model="numpy")
def nats_of_ranges(
    rays: NDArray[np.float64],
    starts: NDArray[np.float64],
    resolution: float,
    bins: NDArray[np.uint8],
    rates: NDArray[np.float64],
) -> NDArray[np.float64]:
    """-ln p(r) of every ray in a map whose cells have these `bins`, of these `rates` per metre.

    `starts`: in cells, from the lower-left corner of `bins`; the last rate is that of unknown cells.
    """
    room = most_cells(resolution)
    found, ends, shares = np.empty(room, np.int64), np.empty(room), np.empty(room)
    nats = np.empty(len(rays))
    for k in range(len(rays)):
        _, density, left = _explained(rays[k], starts[k], resolution, bins, rates, found, ends, shares)
        nats[k] = -math.log(probability_of_range(rays[k, RANGE] >= FARTHEST, density, left))
    return nats


@njit(cache=True, nogil=True, error_model="numpy")
def ends_and_lengths(
    rays: NDArray[np.float64],
    starts: NDArray[np.float64],
    resolution: float,
    bins: NDArray[np.uint8],
    rates: NDArray[np.float64],
) -> NDArray[np.float64]:
    """How many rays end in cells of each bin, and over how many metres they pass them: shape (2, bins).

    Expected, if the rates are these: a beam's end is shared among the cells that may have stopped it.
    """
    room = most_cells(resolution)
    found, ends, shares = np.empty(room, np.int64), np.empty(room), np.empty(room)
    counts = np.zeros((2, len(rates)))
    for k in range(len(rays)):
        n, density, left = _explained(rays[k], starts[k], resolution, bins, rates, found, ends, shares)
        far = rays[k, RANGE] >= FARTHEST
        p = probability_of_range(far, density, left)
        # Times the probability that the map explains it, and by what explains it: no division by 0.
        passing, entered = INLIERS * (left if far else density) / p, 0.0
        for i in range(n):
            share = 0.0 if far else INLIERS * shares[i] / p
            counts[0, found[i]] += share
            counts[1, found[i]] += (passing - share / 2.0) * (ends[i] - entered)
            passing -= share
            entered = ends[i]
    return counts
