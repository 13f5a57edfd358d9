"""Pose interpolation: a robot's recent poses, and its pose at a time between. Nothing is extrapolated."""

import math
from bisect import bisect_left
from collections import deque

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import NoPose
from ogm_core.placing import reasons
from ogm_core.placing.reasons import Reason
from ogm_core.placing.rules import POSE_GAP
from ogm_core.types import IDENTITY, Pose, Scan, Sweep, shorter_arc

CAPACITY = 1024
"""So many poses are kept at least, whatever their stamps."""
SPAN_NS = 60_000_000_000
"""Older poses than that are forgotten once there are more than CAPACITY."""
MAX_KEPT = 65_536
"""So many are kept at most."""
_NEAR_M = 0.01
_NEAR_RAD = math.radians(0.5)


class PoseHistory:
    """The newest poses of one robot, in the order of their stamps (ns).

    Between two poses more than `gap_ns` apart the robot may have been anywhere: nothing is said of that time,
    unless the two are nearly equal. Nor is anything said by a pose whose stamp is ambiguous.
    """

    def __init__(self, gap_ns: float = POSE_GAP * 1e9) -> None:
        self._gap_ns = gap_ns
        self._stamps: deque[int] = deque()
        self._poses: deque[Pose] = deque()
        self._ambiguous: set[int] = set()

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

    @property
    def newest_pose(self) -> Pose:
        """The newest pose; there must be one."""
        return self._poses[-1]

    def append(self, stamp: int, pose: Pose) -> None:
        """Keep a pose that is later than the newest, and forget the oldest ones if there are enough."""
        stamps = self._stamps
        stamps.append(stamp)
        self._poses.append(pose)
        while len(stamps) > CAPACITY and (stamp - stamps[0] > SPAN_NS or len(stamps) > MAX_KEPT):
            self._ambiguous.discard(stamps.popleft())
            self._poses.popleft()

    def doubt(self, stamp: int) -> None:
        """Mark a kept stamp as ambiguous: another pose has it, too."""
        self._ambiguous.add(stamp)

    def at(self, stamp: int) -> Pose:
        """Pose at `stamp`: linear in x and y, along the shortest arc in theta.

        An equal stamp gives that pose bit for bit.

        Raises:
            NoPose: `stamp` lies outside of what is kept, or nothing can be said of it; the text says why.
        """
        stamps = self._stamps
        after = bisect_left(stamps, stamp)
        if after == len(stamps) or (after == 0 and stamps[0] != stamp):
            raise _no_pose(reasons.BEYOND)
        t1, p1 = stamps[after], self._poses[after]
        if t1 == stamp:
            if stamp in self._ambiguous:
                raise _no_pose(reasons.AMBIGUOUS)
            return p1
        t0, p0 = stamps[after - 1], self._poses[after - 1]
        if (why_not := self._gap_between(t0, p0, t1, p1)) is not None:
            raise _no_pose(why_not)
        f = (stamp - t0) / (t1 - t0)
        return Pose(
            p0.x + f * (p1.x - p0.x), p0.y + f * (p1.y - p0.y), p0.theta + f * shorter_arc(p0.theta, p1.theta)
        )

    def along(self, scan: Scan) -> Sweep:
        """The sensor's poses while `scan` swept, one a beam; each as `at` gives it, with the scan's mount.

        Raises:
            NoPose: one of them cannot be told.
        """
        first, last = sorted((scan.stamp, scan.end_stamp))
        if not self._stamps or first < self._stamps[0] or last > self._stamps[-1]:
            raise _no_pose(reasons.BEYOND)
        middle = self.at(scan.stamp + (scan.end_stamp - scan.stamp) // 2)
        base = self._at_each(scan.stamp, np.rint(np.arange(scan.ranges.size) * scan.time_increment * 1e9))
        return Sweep(middle.compose(scan.mount), _composed(base, scan.mount))

    def _gap_between(self, t0: int, p0: Pose, t1: int, p1: Pose) -> Reason | None:
        """Why nothing is said of the time between two neighbours; None if they are joined."""
        if self._ambiguous and not self._ambiguous.isdisjoint((t0, t1)):
            return reasons.AMBIGUOUS
        if t1 - t0 <= self._gap_ns or nearly_equal(p0, p1):
            return None
        return reasons.gap(t1 - t0, self._gap_ns)

    def _at_each(self, stamp: int, after: NDArray[np.float64]) -> NDArray[np.float64]:
        """Poses, shape (N, 3), at `after` ns after `stamp`: times between the oldest and the newest pose."""
        first = max(0, bisect_left(self._stamps, stamp + int(after.min())) - 1)
        last = bisect_left(self._stamps, stamp + int(after.max()))
        stamps = [self._stamps[n] for n in range(first, last + 1)]
        poses = [self._poses[n] for n in range(first, last + 1)]
        times = np.array([kept - stamp for kept in stamps], np.float64)
        nodes = np.array(poses)
        steps = np.zeros((len(poses), 3))
        joined = np.ones(len(poses), np.bool_)  # to the next one
        for n in range(len(poses) - 1):
            p0, p1 = poses[n], poses[n + 1]
            steps[n] = p1.x - p0.x, p1.y - p0.y, shorter_arc(p0.theta, p1.theta)
            joined[n] = self._gap_between(stamps[n], p0, stamps[n + 1], p1) is None
        upper = np.searchsorted(times, after)
        lower = np.maximum(upper - 1, 0)
        met = times[upper] == after
        sure = np.array([kept not in self._ambiguous for kept in stamps])
        told = np.where(met, sure[upper], joined[lower])
        if not told.all():
            self.at(stamp + int(after[np.argmin(told)]))  # says why not
        gap = times[upper] - times[lower]
        f = (after - times[lower]) / np.where(gap > 0.0, gap, 1.0)
        return np.where(met[:, None], nodes[upper], nodes[lower] + f[:, None] * steps[lower])


def _no_pose(reason: Reason) -> NoPose:
    return NoPose(reason.text, reason.kind)


def nearly_equal(one: Pose, other: Pose) -> bool:
    """Whether two poses are within 1 cm and 0.5 degrees of each other."""
    return (
        math.hypot(other.x - one.x, other.y - one.y) <= _NEAR_M
        and abs(shorter_arc(one.theta, other.theta)) <= _NEAR_RAD
    )


def _composed(base: NDArray[np.float64], mount: Pose) -> NDArray[np.float64]:
    """`Pose.compose` for many: poses of `mount` in the frame that the `base` poses are given in."""
    if mount == IDENTITY:
        return base
    x, y, theta = base.T
    c, s = np.cos(theta), np.sin(theta)
    return np.stack(
        (x + c * mount.x - s * mount.y, y + s * mount.x + c * mount.y, theta + mount.theta), axis=1
    )
