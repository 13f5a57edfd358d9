"""Pose interpolation: a robot's recent poses, and its pose at a time between. Nothing is extrapolated."""

import math
from bisect import bisect_left
from collections import deque
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ogm_core.types import IDENTITY, Pose, Scan, Sweep

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
        return Pose(
            p0.x + f * (p1.x - p0.x), p0.y + f * (p1.y - p0.y), p0.theta + f * shorter_arc(p0.theta, p1.theta)
        )

    def along(self, scan: Scan) -> Sweep | None:
        """The sensor's poses while `scan` swept, one a beam; each as `at` gives it, with the scan's mount.

        None if one of them is not known.
        """
        first, last = sorted((scan.stamp, scan.end_stamp))
        if self.oldest is None or self.newest is None or first < self.oldest or last > self.newest:
            return None
        middle = self.at(scan.stamp + (scan.end_stamp - scan.stamp) // 2)
        base = self._at_each(scan.stamp, np.rint(np.arange(scan.ranges.size) * scan.time_increment * 1e9))
        if middle is None or base is None:
            return None
        return Sweep(middle.compose(scan.mount), _composed(base, scan.mount))

    def _at_each(self, stamp: int, after: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Poses, shape (N, 3), at `after` ns after `stamp`: times between the oldest and the newest pose."""
        first = max(0, bisect_left(self._stamps, stamp + int(after.min())) - 1)
        last = bisect_left(self._stamps, stamp + int(after.max()))
        times = np.array([self._stamps[n] - stamp for n in range(first, last + 1)], np.float64)
        poses = [self._poses[n] for n in range(first, last + 1)]
        nodes = np.array(poses)
        steps = np.zeros((len(poses), 3))
        for n, (p0, p1) in enumerate(pairwise(poses)):
            steps[n] = p1.x - p0.x, p1.y - p0.y, shorter_arc(p0.theta, p1.theta)
        upper = np.searchsorted(times, after)
        lower = np.maximum(upper - 1, 0)
        met = times[upper] == after
        gap = times[upper] - times[lower]
        if (gap > MAX_GAP_NS)[~met].any():
            return None
        f = (after - times[lower]) / np.where(gap > 0.0, gap, 1.0)
        return np.where(met[:, None], nodes[upper], nodes[lower] + f[:, None] * steps[lower])


def shorter_arc(start: float, end: float) -> float:
    """The shorter turn from one heading to another, both finite, rad."""
    turn = end - start
    if not math.isfinite(turn):
        # Two finite headings may differ by more than float64 holds; whole turns do not count.
        turn = math.remainder(end, math.tau) - math.remainder(start, math.tau)
    return math.remainder(turn, math.tau)


def _composed(base: NDArray[np.float64], mount: Pose) -> NDArray[np.float64]:
    """`Pose.compose` for many: poses of `mount` in the frame that the `base` poses are given in."""
    if mount == IDENTITY:
        return base
    x, y, theta = base.T
    c, s = np.cos(theta), np.sin(theta)
    return np.stack(
        (x + c * mount.x - s * mount.y, y + s * mount.x + c * mount.y, theta + mount.theta), axis=1
    )
