"""A scan as the area that its beams see: a star around the sensor, for the sensor model `sector`.

Every beam stands for the directions that are nearer to it than to any other beam, and no farther from it than
half an increment. Going round the sensor once, counter-clockwise from the x axis, each ray of the star says
how far the scan saw from there on to the next ray:

    inner radius    everything nearer was free
    outer radius    everything between inner and outer is occupied

Both are equal where nothing was hit, and 0 where nothing was seen. Rays along the four axes are always there,
so that between two rays an arc never turns back. Lengths are in cells.

Where the rays lie in the sensor's frame depends on the beams' bearings alone, so that is worked out once for
all scans of a sensor: its fan. The sensor's heading turns the fan, and the ranges make a star of it.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.beams import HIT, SKIPPED, BeamModel, classify

TURN = 2.0 * math.pi
SAME = 1e-12
"""Bearings that differ by less, rad, are the same: rounding alone makes such differences."""

Rays = NDArray[np.float64]
"""Shape (4, n): cosine, sine, inner and outer radius; the last one closes the round."""


class Fan(NamedTuple):
    """The rays between which beams look, in the sensor's frame, counter-clockwise from any one on.

    `angles`, rad, float64, ascending, within one turn of the first, which lies in [0, 2 pi); `directions`,
    shape (2, n), their cosine and sine; `beams`, int64: the beam that looks from there on, -1 if none does.
    """

    angles: NDArray[np.float64]
    directions: NDArray[np.float64]
    beams: NDArray[np.int64]


@lru_cache(maxsize=16)
def fan_of(angle_min: float, angle_increment: float, count: int) -> Fan:
    """The fan of `count` beams; its arrays are read-only."""
    order = _round(angle_increment, count)
    half = abs(angle_increment) / 2.0
    bearings = angle_min + order * angle_increment
    before = np.roll(bearings, 1)
    between = (
        bearings - before - np.floor((bearings - before) / TURN) * TURN if count > 1 else np.array([TURN])
    )
    gap = between > 2.0 * half + SAME  # nobody looks between these two beams
    # An increment that is lost in rounding leaves a beam no width, and nothing to see.
    seeing = (bearings + half) - (bearings - half) > SAME
    angles = np.stack((before + half, np.where(gap, bearings - half, bearings - between / 2.0)), axis=1)
    beams = np.stack((np.full(order.size, -1), np.where(seeing, order, -1)), axis=1)
    kept = np.stack((gap, np.ones(order.size, np.bool_)), axis=1)
    angles, beams = angles[kept], beams[kept]
    directions = np.stack((np.cos(angles), np.sin(angles)))
    onward = angles - angles[0]
    onward = np.maximum.accumulate(np.maximum(onward - np.floor((onward + SAME) / TURN) * TURN, 0.0))
    fan = Fan(angles[0] - math.floor(angles[0] / TURN) * TURN + onward, directions, beams)
    for array in fan:
        array.flags.writeable = False
    return fan


def _round(angle_increment: float, count: int) -> NDArray[np.int64]:
    """Beams in the order in which a counter-clockwise round meets them; of equal bearings only the first."""
    beams = np.arange(count)
    if (count - 1) * abs(angle_increment) < TURN - SAME:
        return beams if angle_increment > 0.0 else beams[::-1].copy()
    bearings = np.mod(beams * angle_increment + SAME, TURN)
    order = np.argsort(bearings, kind="stable")
    new = np.diff(bearings[order], prepend=-1.0) > SAME
    return np.asarray(np.minimum.reduceat(order, np.flatnonzero(new)), np.int64)


@njit(cache=True, nogil=True, error_model="numpy")
def turned(
    ranges: NDArray[np.float32],
    beam: BeamModel,
    kinds: NDArray[np.int64],
    fan: Fan,
    heading: float,
    resolution: float,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The star of a scan: its rays in one round from the x axis on, and the quadrant (0 to 3) each begins in.

    `heading`, rad, in [-pi, pi], is the sensor's. A beam whose entry in `kinds` is SKIPPED does not count; if
    there are no entries, all count.
    """
    n = fan.beams.size
    radii = np.zeros((2, n))
    for r in range(n):
        b = fan.beams[r]
        if b < 0 or (kinds.size > 0 and kinds[b] == SKIPPED):
            continue
        kind, length = classify(float(ranges[b]), beam)
        if kind == SKIPPED:
            continue
        thickness = beam.alpha / 2.0 if kind == HIT else 0.0
        radii[0, r] = max(length - thickness, 0.0) / resolution
        radii[1, r] = (length + thickness) / resolution
    first = fan.angles[0] + heading
    turn = heading - math.floor(first / TURN) * TURN
    begin = np.searchsorted(fan.angles, TURN - turn)  # from here on a turn has been completed
    rays = np.zeros((4, n + 5))
    quadrants = np.zeros(n + 5, np.int64)
    ch, sh = math.cos(heading), math.sin(heading)
    m = 0
    quadrant = -1
    inner, outer = radii[0, begin - 1], radii[1, begin - 1]
    for t in range(n + 1):
        r = begin + t if begin + t < n else begin + t - n
        angle = fan.angles[r] + turn - (TURN if begin + t < n else 0.0)
        while quadrant < 3 and (t == n or quadrant == -1 or angle >= (quadrant + 1) * math.pi / 2.0):
            quadrant += 1
            rays[0, m], rays[1, m] = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quadrant]
            rays[2, m], rays[3, m] = inner, outer
            quadrants[m] = quadrant
            m += 1
        if t == n:
            break
        inner, outer = radii[0, r], radii[1, r]
        c = ch * fan.directions[0, r] - sh * fan.directions[1, r]
        s = sh * fan.directions[0, r] + ch * fan.directions[1, r]
        rays[0, m] = max(c, 0.0) if quadrant in (0, 3) else min(c, 0.0)
        rays[1, m] = max(s, 0.0) if quadrant < 2 else min(s, 0.0)
        rays[2, m], rays[3, m] = inner, outer
        quadrants[m] = quadrant
        m += 1
    rays[0, m] = 1.0
    quadrants[m] = 3
    # Copied: numba takes a part for another kind of array than a whole, and would compile for each.
    return rays[:, : m + 1].copy(), quadrants[: m + 1].copy()
