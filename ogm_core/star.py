"""A scan as the area that its beams see: a star around the sensor, for the sensor model `sector`.

Every beam stands for the directions that are nearer to it than to any other beam, and no farther from it than
half an increment. Going round the sensor once, counter-clockwise from the x axis, each ray of the star says
how far the scan saw from there on to the next ray:

    inner radius    everything nearer was free
    outer radius    everything between inner and outer is occupied

Both are equal where nothing was hit, and 0 where nothing was seen. Rays along the four axes are always there,
so that between two rays an arc never turns back. Lengths are in cells.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.beams import HIT, SKIPPED, BeamModel, classify
from ogm_core.grid_settings import GridSettings
from ogm_core.projection import beam_model, read_only
from ogm_core.types import PlacedScan, Scan

TURN = 2.0 * math.pi
SAME = 1e-12
"""Bearings that differ by less, rad, are the same: rounding alone makes such differences."""

Rays = NDArray[np.float64]
"""Shape (4, n): cosine, sine, inner and outer radius; the last one closes the round."""


def star_of(
    placed: PlacedScan, kinds: NDArray[np.int64], resolution: float, settings: GridSettings
) -> tuple[Rays, NDArray[np.int64]]:
    """The rays of a scan at its sensor's pose, and the quadrant (0 to 3) that each of them begins in.

    `kinds` says which beams count.
    """
    # Whole turns do not count, and the sum of a large heading and a bearing would lose digits.
    heading = math.atan2(math.sin(placed.pose.theta), math.cos(placed.pose.theta))
    found = wedges(
        read_only(placed.scan.ranges),
        beam_model(placed.scan, settings),
        kinds,
        _round(placed.scan),
        heading,
        float(resolution),
    )
    rays, quadrants = from_axis_to_axis(found)
    return rays, quadrants


def _round(scan: Scan) -> NDArray[np.int64]:
    """Beams in the order in which a counter-clockwise round meets them; of equal bearings only the first."""
    beams = np.arange(scan.ranges.size)
    if (beams.size - 1) * abs(scan.angle_increment) < TURN - SAME:
        return beams if scan.angle_increment > 0.0 else beams[::-1].copy()
    bearings = np.mod(beams * scan.angle_increment + SAME, TURN)
    order = np.argsort(bearings, kind="stable")
    new = np.diff(bearings[order], prepend=-1.0) > SAME
    return np.asarray(np.minimum.reduceat(order, np.flatnonzero(new)), np.int64)


@njit(cache=True, nogil=True, error_model="numpy")
def wedges(
    ranges: NDArray[np.float32],
    beam: BeamModel,
    kinds: NDArray[np.int64],
    order: NDArray[np.int64],
    heading: float,
    resolution: float,
) -> NDArray[np.float64]:
    """Angle, inner and outer radius of every ray but the axes', counter-clockwise from any one on.

    `order` are the beams as they are met counter-clockwise.
    """
    n = order.size
    half = abs(beam.angle_increment) / 2.0
    found = np.zeros((3, 2 * n))
    count = 0
    for p in range(n):
        bearing = beam.angle_min + order[p] * beam.angle_increment
        before = beam.angle_min + order[p - 1] * beam.angle_increment
        between = bearing - before - math.floor((bearing - before) / TURN) * TURN
        if n == 1:
            between = TURN
        if between > 2.0 * half + SAME:  # nobody looks between these two beams
            found[0, count] = heading + (before + half)
            count += 1
            found[0, count] = heading + (bearing - half)
        else:
            found[0, count] = heading + (bearing - between / 2.0)
        kind, length = classify(float(ranges[order[p]]), beam)
        # An increment that is lost in rounding leaves a beam no width, and nothing to see.
        width = (heading + (bearing + half)) - (heading + (bearing - half))
        if kinds[order[p]] != SKIPPED and width > SAME:
            thickness = beam.alpha / 2.0 if kind == HIT else 0.0
            found[1, count] = max(length - thickness, 0.0) / resolution
            found[2, count] = (length + thickness) / resolution
        count += 1
    # Copied: numba takes a part for another kind of array than a whole, and would compile for each.
    return found[:, :count].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def from_axis_to_axis(found: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Rays and quadrants of one round from the x axis on, with all four axes; `found` are the wedges."""
    angles = found[0] - np.floor(found[0] / TURN) * TURN
    count = angles.size
    # The round begins before the ray where the angles fall back from 2 pi to 0.
    begin = 0
    for r in range(count):
        if angles[r - 1] - angles[r] > angles[begin - 1] - angles[begin]:
            begin = r
    rays = np.zeros((4, count + 5))
    quadrants = np.zeros(count + 5, np.int64)
    inner, outer = found[1, begin - 1], found[2, begin - 1]
    m = 0
    quadrant = -1
    for t in range(count + 1):
        r = (begin + t) % count
        while quadrant < 3 and (t == count or quadrant == -1 or angles[r] >= (quadrant + 1) * math.pi / 2.0):
            quadrant += 1
            rays[0, m], rays[1, m] = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quadrant]
            rays[2, m], rays[3, m] = inner, outer
            quadrants[m] = quadrant
            m += 1
        if t == count:
            break
        inner, outer = found[1, r], found[2, r]
        c, s = math.cos(found[0, r]), math.sin(found[0, r])
        rays[0, m] = max(c, 0.0) if quadrant in (0, 3) else min(c, 0.0)
        rays[1, m] = max(s, 0.0) if quadrant < 2 else min(s, 0.0)
        rays[2, m], rays[3, m] = inner, outer
        quadrants[m] = quadrant
        m += 1
    rays[0, m] = 1.0
    quadrants[m] = 3
    return rays[:, : m + 1].copy(), quadrants[: m + 1].copy()
