"""Limits of the placing of scans by poses: what a robot can do, and how long one waits."""

import math
from dataclasses import dataclass

from ogm_core.types import Pose, shorter_arc

POSE_GAP = 0.5
"""Poses farther apart than that, s, say nothing about the time between them, unless told otherwise."""
FEWEST_POSES = 1024
"""So many poses of a robot are kept at least, whatever their stamps."""
MOST_POSES = 65_536
"""So many are kept at most."""
JITTER_NS = 50_000_000
"""A stamp may lie so far before an earlier message's without that the clock went back."""
WAITING_NS = 60_000_000_000
"""A scan waits for its pose until one of its sensor that is so much newer waits, too."""
MAX_WAITING_SCANS = 4096
"""So many scans of a sensor wait at most, whatever their stamps."""
REMEMBERED = 8
"""So many replaced runs are remembered, those that were heard last."""

MAX_ROBOTS = 1000
"""Robots that are alive, or were heard within FORGOTTEN_AFTER; those that come then are refused."""
MAX_SENSORS = 16
"""Sensors of a robot; others are refused."""
FORGOTTEN_AFTER = 3600.0
"""Who is not alive, and was not heard for so long, is forgotten, s."""


@dataclass(frozen=True, slots=True)
class PlacingRules:
    """What is believed of poses and scans.

    `pose_gap`: poses farther apart say nothing about the time between, s, unless they are nearly equal.
    `pose_wait`: how long a scan waits for its pose, and how far its stamp may be ahead of the poses, s.
    No robot drives faster than `max_speed`, m/s, or turns faster than `max_turn_rate`, rad/s; inf: no limit.
    Of a robot `fewest_poses` are kept at least, and `most_poses` at most.
    """

    pose_gap: float = POSE_GAP
    pose_wait: float = 2.0
    max_speed: float = 20.0
    max_turn_rate: float = 10.0
    fewest_poses: int = FEWEST_POSES
    most_poses: int = MOST_POSES

    def reachable(self, dt_ns: int, start: Pose, end: Pose) -> bool:
        """Whether one gets from one pose to the other in `dt_ns` > 0; 5 cm and 0.1 rad are always free."""
        dt = dt_ns / 1e9
        return (
            math.hypot(end.x - start.x, end.y - start.y) <= self.max_speed * dt + 0.05
            and abs(shorter_arc(start.theta, end.theta)) <= self.max_turn_rate * dt + 0.1
        )


DEFAULT_RULES = PlacingRules()


def remember(replaced: list[str], run: str) -> None:
    """Put a replaced run at the end of those that were heard last; the one heard longest ago is forgotten."""
    if run in replaced:
        replaced.remove(run)
    replaced.append(run)
    del replaced[:-REMEMBERED]
