"""Trajectories of simulated robots: closed paths, stepped through pose by pose, round and round."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

from ogm_core.errors import BadWorld
from ogm_core.files.strict_yaml import shown
from ogm_core.types import Pose

MAX_POSES = 100_000
"""The most poses of one round."""
MAX_TURN = 0.2
"""The most that a robot turns between two poses of a waypoint path, rad."""
_WHOLE = 1e-9

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class CirclePath:
    """`count` poses, evenly spaced counter-clockwise on a circle, m, heading along it.

    Raises:
        BadWorld: the radius or the number of poses is out of range.
    """

    cx: float
    cy: float
    r: float
    count: int

    def __post_init__(self) -> None:
        if not self.r > 0.0:
            raise BadWorld(f"path: circle: a radius above 0 is needed, got {self.r:g}")
        if not 1 <= self.count <= MAX_POSES:
            raise BadWorld(f"path: poses: 1 to {MAX_POSES} are needed, got {shown(self.count)}")

    def pose(self, i: int) -> Pose:
        """Pose number `i`, at angle 2 pi (i mod count) / count from the x axis."""
        angle = 2.0 * math.pi * (i % self.count) / self.count
        x = self.cx + self.r * math.cos(angle)
        y = self.cy + self.r * math.sin(angle)
        return Pose(x, y, angle + math.pi / 2.0)


@dataclass(frozen=True)
class WaypointPath:
    """Straight from waypoint to waypoint and back to the first, turning on the spot at each.

    `points` in m; `spacing` is the largest distance between two poses, m (every leg is cut into equal
    steps, so that each waypoint is met). No two poses in a row differ by more than `MAX_TURN`, so that
    what lies between two poses is what a robot would have driven.

    Raises:
        BadWorld: fewer than two waypoints, two equal ones in a row, or a spacing that is out of range.
    """

    points: tuple[Point, ...]
    spacing: float

    def __post_init__(self) -> None:
        if len(self.points) < 2:
            raise BadWorld(f"path: waypoints: at least 2 are needed, got {len(self.points)}")
        for k, (start, end) in enumerate(self._legs()):
            if start == end:
                after = (k + 1) % len(self.points)
                hint = "; the last leads back to the first by itself" if after == 0 else ""
                raise BadWorld(f"path: waypoints: entries {k} and {after} are the same point{hint}")
        if not (math.isfinite(self.spacing) and self.spacing > 0.0):
            raise BadWorld(f"path: spacing: more than 0 m is needed, got {self.spacing:g}")
        length = sum(math.dist(start, end) for start, end in self._legs())
        if length / self.spacing > MAX_POSES:
            raise BadWorld(
                f"path: spacing: {self.spacing:g} m cuts {length:.6g} m into more than {MAX_POSES} poses; "
                "make it larger"
            )

    @property
    def count(self) -> int:
        """How many poses one round has."""
        return len(self._poses)

    def pose(self, i: int) -> Pose:
        """Pose number `i`; pose 0 stands at the first waypoint and looks to the second."""
        return self._poses[i % len(self._poses)]

    def _legs(self) -> Iterator[tuple[Point, Point]]:
        return pairwise((*self.points, self.points[0]))

    @cached_property
    def _poses(self) -> tuple[Pose, ...]:
        poses: list[Pose] = []
        legs = list(self._legs())
        headings = [math.atan2(y1 - y0, x1 - x0) for (x0, y0), (x1, y1) in legs]
        for k, ((x0, y0), (x1, y1)) in enumerate(legs):
            heading, after = headings[k], headings[(k + 1) % len(legs)]
            # The slack keeps 0.3 m at a spacing of 0.1 m from becoming four steps.
            steps = max(1, math.ceil(math.dist((x0, y0), (x1, y1)) / self.spacing - _WHOLE))
            poses += [
                Pose(x0 + (x1 - x0) * j / steps, y0 + (y1 - y0) * j / steps, heading) for j in range(steps)
            ]
            turn = math.remainder(after - heading, math.tau)
            steps = math.ceil(abs(turn) / MAX_TURN)
            poses += [Pose(x1, y1, heading + turn * j / steps) for j in range(steps)]
        return tuple(poses)
