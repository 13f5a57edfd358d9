"""Outline of the area that a scan sees, for the sensor model `sector`.

It is star-shaped, as geometry calls a polygon that is seen whole from one point: the sensor.

Every beam stands for the directions that are nearer to it than to any other beam, and no farther from it than
half an increment. Going round the sensor once, counter-clockwise from the x axis, each ray of the outline
says how far the scan saw from there on to the next ray:

    inner radius    everything nearer was free
    outer radius    everything between inner and outer is occupied

Both are equal where nothing was hit, and 0 where nothing was seen. Rays along the four axes are always there,
so that between two rays an arc never turns back. Lengths are in cells.

Where the rays lie in the sensor's frame depends on the beams' bearings alone, so that is worked out once for
all scans of a sensor: its fan. The sensor's heading turns the fan, and the ranges make an outline of it.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.sensor_models.beams import SKIPPED, BeamModel, reading

TURN = 2.0 * math.pi
SAME = 1e-12
"""Bearings that differ by less, rad, are the same: rounding alone makes such differences."""

Rays = NDArray[np.float64]
"""Shape (4, n): cosine, sine, inner and outer radius; the last one closes the round."""


class Fan(NamedTuple):
    """The rays between which beams look, in the sensor's frame, counter-clockwise from any one on.

    `angles`, rad, float64, ascending, within one turn of the first, which lies in [0, 2 pi); `directions`,
    shape (2, n), their cosine and sine; `beams`, int64: the beam that looks from there on, or the number of
    beams if none does.
    """

    angles: NDArray[np.float64]
    directions: NDArray[np.float64]
    beams: NDArray[np.int64]


def heading_of(theta: float) -> float:
    """The heading in [-pi, pi]: the sum of a large one and a bearing would lose digits."""
    return math.atan2(math.sin(theta), math.cos(theta))


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
    beams = np.stack((np.full(order.size, count), np.where(seeing, order, count)), axis=1)
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
) -> tuple[Rays, NDArray[np.int64]]:
    """Outline of a scan: its rays in one round from the x axis on, and where each quadrant's begin and end.

    Those of quadrant q are rays[:, quarters[q] : quarters[q + 1]]: the axis and the fan's rays in it; all of
    the fan's have been laid when the last quadrant ends. `heading`, rad, in [-pi, pi], is the
    sensor's. A beam whose entry in `kinds` is SKIPPED does not count; if there are no entries, all count.
    """
    radii = _radii(ranges, beam, kinds, resolution)
    n = fan.beams.size
    turn = heading - math.floor((fan.angles[0] + heading) / TURN) * TURN
    begin = int(np.searchsorted(fan.angles, TURN - turn))  # from here on a turn has been completed
    late, early = begin, 0  # in two parts: the fan's rays from `begin` on, then those before
    rays = np.empty((4, n + 5))
    quarters = np.empty(5, np.int64)
    m = 0
    for quadrant in range(4):
        last = early - 1 if early > 0 else late - 1
        rays[0, m], rays[1, m] = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quadrant]
        rays[2, m], rays[3, m] = radii[0, fan.beams[last]], radii[1, fan.beams[last]]
        quarters[quadrant] = m
        m += 1
        end = (quadrant + 1) * math.pi / 2.0 - turn if quadrant < 3 else math.inf
        until = int(np.searchsorted(fan.angles, end + TURN))
        m = _lay(rays, m, radii, fan, late, until, heading, quadrant)
        late = max(late, until)
        if late == n:
            until = min(int(np.searchsorted(fan.angles, end)), begin)
            m = _lay(rays, m, radii, fan, early, until, heading, quadrant)
            early = max(early, until)
    rays[0, m], rays[1, m], rays[2, m], rays[3, m] = 1.0, 0.0, 0.0, 0.0
    quarters[4] = m
    return rays, quarters


@njit(cache=True, nogil=True, error_model="numpy")
def _radii(
    ranges: NDArray[np.float32], beam: BeamModel, kinds: NDArray[np.int64], resolution: float
) -> NDArray[np.float64]:
    """Inner and outer radius of what every beam sees, cells; shape (2, N + 1), the last is no beam's: 0."""
    n = ranges.size
    radii = np.zeros((2, n + 1))
    half = beam.alpha / 2.0
    for k in range(n):
        _, hit, length = reading(float(ranges[k]), beam)
        thickness = half if hit else 0.0
        radii[0, k] = max(length - thickness, 0.0) / resolution
        radii[1, k] = (length + thickness) / resolution
    for k in range(kinds.size):
        if kinds[k] == SKIPPED:
            radii[0, k] = radii[1, k] = 0.0
    return radii


@njit(cache=True, nogil=True, error_model="numpy")
def _lay(
    rays: Rays,
    m: int,
    radii: NDArray[np.float64],
    fan: Fan,
    first: int,
    end: int,
    heading: float,
    quadrant: int,
) -> int:
    """Write the fan's rays `first` to `end`, which the heading turns into one quadrant, from rays[:, m] on.

    Returns where they end. What lies outside the quadrant by rounding is moved to its edge.
    """
    ch, sh = math.cos(heading), math.sin(heading)
    right, top = 1.0 if quadrant in (0, 3) else -1.0, 1.0 if quadrant < 2 else -1.0
    for k in range(end - first):
        r, at = np.uint64(first + k), np.uint64(m + k)
        c = ch * fan.directions[0, r] - sh * fan.directions[1, r]
        s = sh * fan.directions[0, r] + ch * fan.directions[1, r]
        rays[0, at] = right * max(right * c, 0.0)
        rays[1, at] = top * max(top * s, 0.0)
    for k in range(end - first):
        b, at = np.uint64(fan.beams[first + k]), np.uint64(m + k)
        rays[2, at], rays[3, at] = radii[0, b], radii[1, b]
    return m + max(end - first, 0)
