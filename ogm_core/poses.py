"""A robot's recent poses, and its pose at a time between them. Nothing is extrapolated."""

import math
from bisect import bisect_left
from collections import deque

from ogm_core.types import Pose

CAPACITY = 1024
MAX_GAP_NS = 500_000_000
"""Poses farther apart than this say nothing about the time between them."""


class PoseHistory:
    """The newest poses of one robot, in the order of their stamps (ns)."""

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._stamps: deque[int] = deque(maxlen=capacity)
        self._poses: deque[Pose] = deque(maxlen=capacity)

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def oldest(self) -> int | None:
        """Stamp of the oldest kept pose, ns."""
        return self._stamps[0] if self._stamps else None

    @property
    def newest(self) -> int | None:
        """Stamp of the newest pose, ns."""
        return self._stamps[-1] if self._stamps else None

    def append(self, stamp: int, pose: Pose) -> bool:
        """Keep a pose; False, and nothing happens, if it is not later than the newest."""
        if self._stamps and stamp <= self._stamps[-1]:
            return False
        self._stamps.append(stamp)
        self._poses.append(pose)
        return True

    def at(self, stamp: int) -> Pose | None:
        """Pose at `stamp`: linear in x and y, along the shortest arc in theta.

        An equal stamp gives that pose bit for bit. None if `stamp` lies outside of what is kept, or
        between poses more than 0.5 s apart.
        """
        after = bisect_left(self._stamps, stamp)
        if after == len(self._stamps):
            return None
        if self._stamps[after] == stamp:
            return self._poses[after]
        if after == 0:
            return None
        t0, t1 = self._stamps[after - 1], self._stamps[after]
        if t1 - t0 > MAX_GAP_NS:
            return None
        p0, p1 = self._poses[after - 1], self._poses[after]
        f = (stamp - t0) / (t1 - t0)
        turn = p1.theta - p0.theta
        if not math.isfinite(turn):
            # Two finite headings may differ by more than float64 holds; whole turns do not count.
            turn = math.remainder(p1.theta, math.tau) - math.remainder(p0.theta, math.tau)
        arc = math.remainder(turn, math.tau)
        return Pose(p0.x + f * (p1.x - p0.x), p0.y + f * (p1.y - p0.y), p0.theta + f * arc)
