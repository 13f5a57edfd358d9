"""A simulated 2D LiDAR: the distances to a world's outlines, and what a noisy sensor makes of them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import BadSetting
from ogm_core.simulation.worlds import World
from ogm_core.types import Pose, Ranges
from ogm_core.wire.messages import DEFAULT_MAX_BEAMS, MAX_RANGE

FULL_CIRCLE = 2.0 * math.pi
_PAIRS = 2**19
"""Pairs of a beam and an obstacle that are looked at in one go, at most: bounds the memory."""
_SLACK = 1e-6
"""By how much the directions in which an obstacle is looked for are widened on either side, rad."""

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Lidar:
    """A sensor of `beams` beams evenly spread over `fov`, rad, around straight ahead.

    A full circle begins at -pi, and its last beam lies one step before the first; a smaller `fov` has a
    beam on either edge. Ranges and `noise` (standard deviation) in m.

    Raises:
        BadSetting: a value is out of range.
    """

    beams: int = 360
    fov: float = FULL_CIRCLE
    range_max: float = 8.0
    noise: float = 0.02
    range_min: float = 0.0

    def __post_init__(self) -> None:
        if not 1 <= self.beams <= DEFAULT_MAX_BEAMS:
            raise BadSetting(f"beams: 1 to {DEFAULT_MAX_BEAMS} are needed, got {self.beams}")
        if not 0.0 < self.fov <= FULL_CIRCLE:
            raise BadSetting(f"fov: more than 0 and at most 2 pi = {FULL_CIRCLE!r} rad, got {self.fov!r}")
        if not 0.0 < self.range_max <= MAX_RANGE:
            raise BadSetting(f"range_max: more than 0 and at most {MAX_RANGE:g} m, got {self.range_max:g}")
        if not 0.0 <= self.range_min < self.range_max:
            raise BadSetting(
                f"range_min: 0 <= range_min < range_max needed, got {self.range_min:g} and {self.range_max:g}"
            )
        if not 0.0 <= self.noise <= MAX_RANGE:
            raise BadSetting(f"noise: 0 to {MAX_RANGE:g} m are needed, got {self.noise:g}")

    @classmethod
    def lab(cls) -> "Lidar":
        """The sensor of preset `lab`: 360 beams from -pi, 8 m, noise 0.02 m."""
        return cls(beams=360, fov=FULL_CIRCLE, range_max=8.0, noise=0.02)

    @property
    def angle_min(self) -> float:
        """Bearing of beam 0, rad; a single beam of less than a full circle looks straight ahead."""
        if self.fov >= FULL_CIRCLE:
            return -math.pi
        return -self.fov / 2.0 if self.beams > 1 else 0.0

    @property
    def angle_increment(self) -> float:
        """From one beam's bearing to the next, rad; never 0."""
        if self.fov >= FULL_CIRCLE:
            return FULL_CIRCLE / self.beams
        return self.fov / max(1, self.beams - 1)

    @property
    def bearings(self) -> Floats:
        """Bearing of every beam in the sensor's frame, rad, shape (beams,)."""
        return self.angle_min + np.arange(self.beams, dtype=np.float64) * self.angle_increment


def true_ranges(world: World, pose: Pose, lidar: Lidar) -> Floats:
    """Distance along every beam to the nearest outline ahead, m, float64, shape (beams,).

    `pose` is the sensor's, in the world frame. A beam that meets nothing within range_max reads exactly
    range_max; from inside a circle a beam ends where it leaves it. An outline that only touches the
    beam (a tangent, the end of a wall, a wall seen edge-on) counts; one that the sensor stands on, at
    distance 0, does not.
    """
    angles = pose.theta + lidar.bearings
    dx, dy = np.cos(angles), np.sin(angles)
    ranges = np.full(lidar.beams, lidar.range_max)
    circles = world.circles - (pose.x, pose.y, 0.0)
    segments = world.segments - (pose.x, pose.y, pose.x, pose.y)
    for obstacles, directions, distances in (
        (circles, _circle_directions, _circle_distances),
        (segments, _segment_directions, _segment_distances),
    ):
        begin, width = directions(*obstacles.T)
        for part in _parts(lidar.beams, begin.size):
            beam, k = _candidates(angles[part], lidar.angle_increment, begin, width)
            distance = distances(dx[part][beam], dy[part][beam], *obstacles[k].T)
            ahead = distance > 0.0
            np.minimum.at(ranges[part], beam[ahead], distance[ahead])
    return ranges


def measure(world: World, pose: Pose, lidar: Lidar, rng: np.random.Generator) -> Ranges:
    """One sweep of the sensor at `pose` (its own, in the world frame), m, float32, shape (beams,).

    What a beam meets is read with Gaussian noise and clipped to [0, range_max]; a beam that meets nothing
    within range_max reads range_max. `rng` gives one number a beam, met or not, so that the noise of a
    beam does not depend on what the others meet.
    """
    exact = true_ranges(world, pose, lidar)
    noisy = np.clip(exact + lidar.noise * rng.standard_normal(lidar.beams), 0.0, lidar.range_max)
    nothing = (exact >= lidar.range_max) | (noisy >= lidar.range_max)
    return np.where(nothing, _no_return(lidar.range_max), noisy.astype(np.float32))


def _no_return(range_max: float) -> np.float32:
    """The smallest float32 that is not below `range_max`.

    A scan carries float32 ranges but a float64 range_max, and r >= range_max is what makes a beam a no
    return. The float32 next to 9.7, say, lies below 9.7: it would be an obstacle at the end of every beam.
    """
    nearest = np.float32(range_max)
    return nearest if float(nearest) >= range_max else np.nextafter(nearest, np.float32(np.inf))


def _parts(beams: int, obstacles: int) -> Iterator[slice]:
    """Slices of the beams with at most `_PAIRS` pairs each; none if there are no obstacles."""
    if obstacles == 0:
        return
    rows = max(1, _PAIRS // obstacles)
    for start in range(0, beams, rows):
        yield slice(start, start + rows)


def _candidates(angles: Floats, increment: float, begin: Floats, width: Floats) -> tuple[Indices, Indices]:
    """Every pair (beam, obstacle) that may meet, both shape (P,); the others need no second look.

    `angles` (B,) of the beams, `increment` apart, less than a turn in all; obstacle k fills the directions
    begin[k] to begin[k] + width[k].
    """
    first = np.mod(begin - _SLACK - angles[0], FULL_CIRCLE)
    # Obstacles that the sweep meets from its first beam on, left over from the turn before; then all others.
    first = np.concatenate((first - FULL_CIRCLE, first))
    last = first + np.tile(width, 2) + 2.0 * _SLACK
    start = np.clip(np.ceil(first / increment), 0, angles.size).astype(np.intp)
    stop = np.clip(np.floor(last / increment) + 1, start, angles.size).astype(np.intp)
    counts = stop - start
    obstacle = np.repeat(np.tile(np.arange(begin.size), 2), counts)
    # 0, 1, 2 ... within each window, counted on from its first beam.
    beam = np.arange(obstacle.size) + np.repeat(start - (np.cumsum(counts) - counts), counts)
    return beam, obstacle


def _circle_directions(cx: Floats, cy: Floats, r: Floats) -> tuple[Floats, Floats]:
    """Where circles (from the sensor) begin, and how wide they are seen, rad; all around from inside."""
    away = np.hypot(cx, cy)
    half = np.where(away > r, np.arcsin(r / np.maximum(away, r)), math.pi)
    return np.arctan2(cy, cx) - half, 2.0 * half


def _segment_directions(x1: Floats, y1: Floats, x2: Floats, y2: Floats) -> tuple[Floats, Floats]:
    """Where segments (from the sensor) begin, and how wide they are seen, rad."""
    angle1, angle2 = np.arctan2(y1, x1), np.arctan2(y2, x2)
    turn = np.mod(angle2 - angle1, FULL_CIRCLE)
    clockwise = turn > math.pi
    begin = np.where(clockwise, angle2, angle1)
    width = np.where(clockwise, FULL_CIRCLE - turn, turn)
    # The sensor stands on the segment, or so close that rounding decides on which side: look all around.
    return begin, np.where(width > math.pi - _SLACK, FULL_CIRCLE, width)


def _circle_distances(dx: Floats, dy: Floats, cx: Floats, cy: Floats, r: Floats) -> Floats:
    """Distance along beam (dx, dy) to circle (cx, cy, r) for P pairs, m; not positive if it is not met."""
    beside = dx * cy - dy * cx
    middle = dx * cx + dy * cy
    # From the beam's point nearest to the centre: half a chord back it enters, half a chord on it leaves.
    half = np.sqrt(np.maximum((r - beside) * (r + beside), 0.0))
    enters, leaves = middle - half, middle + half
    return np.where(np.abs(beside) <= r, np.where(enters > 0.0, enters, leaves), 0.0)


def _segment_distances(dx: Floats, dy: Floats, x1: Floats, y1: Floats, x2: Floats, y2: Floats) -> Floats:
    """Distance along beam (dx, dy) to segment (x1, y1, x2, y2) for P pairs, m; not positive if not met.

    A beam's line meets a segment whose ends lie on different sides of it. Segments that share a corner get
    the same side for it, bit for bit, so that no beam slips out between them.
    """
    left, right = dx * y1 - dy * x1, dx * y2 - dy * x2
    along1, along2 = dx * x1 + dy * y1, dx * x2 + dy * y2
    # Between the two ends, where the signed distance to the beam is 0: never off the segment, however flat
    # the beam meets it. Seen edge-on, both distances 0, it is met at its nearest end ahead.
    edge_on = left == right
    share = left / np.where(edge_on, 1.0, left - right)
    near, far = np.minimum(along1, along2), np.maximum(along1, along2)
    along = np.where(edge_on, np.where(near > 0.0, near, far), along1 + share * (along2 - along1))
    return np.where(left * right <= 0.0, along, 0.0)
