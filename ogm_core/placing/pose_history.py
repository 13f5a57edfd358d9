"""Pose interpolation: a robot's pose at a time between its recent ones. Nothing is extrapolated."""

import math
from bisect import bisect_left
from contextlib import suppress
from itertools import pairwise
from struct import Struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import NoPose
from ogm_core.placing import reasons
from ogm_core.placing.held import Held
from ogm_core.placing.kept_poses import KeptPoses
from ogm_core.placing.reasons import Reason
from ogm_core.placing.rules import DEFAULT_RULES, PlacingRules
from ogm_core.types import IDENTITY, Pose, Scan, Sweep, shorter_arc

_LATELY = 16
"""So many poses are those of late."""
_new = tuple.__new__  # Pose() takes three times as long
_read_two = Struct("6d").unpack_from
NEAR_M = 0.01
NEAR_RAD = math.radians(0.5)
"""Poses that are within both of each other are nearly equal: a gap between them does not matter."""
STILL_THERE_NS = 500_000_000
"""A time that nothing else is said of may be so far from the newest pose for that to hold."""


class Piece(NamedTuple):
    """A piece of a robot's way: straight and steady from (x0, y0) at t0 to (x1, y1) at t1, m and ns."""

    t0: float
    t1: float
    x0: float
    y0: float
    x1: float
    y1: float


class PoseHistory(KeptPoses):
    """The newest poses of one robot, and where it was between them.

    Between two poses more than `pose_gap` apart the robot may have been anywhere: nothing is said of that
    time, unless the two are nearly equal. Nor is anything said by a pose whose stamp is ambiguous.
    """

    def __init__(self, rules: PlacingRules = DEFAULT_RULES, held: Held | None = None) -> None:
        """`rules`: their pose_gap, and how many poses are kept. `held` counts what they take in memory."""
        super().__init__(rules, held)
        self._gap_ns = rules.pose_gap * 1e9

    def at(self, stamp: int) -> Pose:
        """Pose at `stamp`: linear in x and y, along the shortest arc in theta.

        An equal stamp gives that pose bit for bit.

        Raises:
            NoPose: `stamp` lies outside of what is kept, or nothing can be said of it; the text says why.
        """
        stamps, end = self._stamps, self._end
        after = bisect_left(stamps, stamp, self._start, end)
        if after == end or (after == self._start and stamps[after] != stamp):
            raise _no_pose(reasons.BEYOND)
        t1 = stamps[after]
        if t1 == stamp:
            if self._ambiguous[after]:
                raise _no_pose(reasons.AMBIGUOUS)
            return self._newest_pose if after == end - 1 else self._pose(after)
        before = after - 1
        if (why_not := self._gap_after(before)) is not None:
            raise _no_pose(why_not)
        t0 = stamps[before]
        x0, y0, theta0, x1, y1, theta1 = _read_two(self._poses, 24 * before)
        f = (stamp - t0) / (t1 - t0)
        return _new(Pose, (x0 + f * (x1 - x0), y0 + f * (y1 - y0), theta0 + f * shorter_arc(theta0, theta1)))

    def along(self, scan: Scan) -> Sweep:
        """The sensor's poses while `scan` swept, one a beam; each as `at` gives it, with the scan's mount.

        Raises:
            NoPose: one of them cannot be told.
        """
        first, last = sorted((scan.stamp, scan.end_stamp))
        if not self._end or first < self._stamps[self._start] or last > self._stamps[self._end - 1]:
            raise _no_pose(reasons.BEYOND)
        middle = self.at(scan.stamp + (scan.end_stamp - scan.stamp) // 2)
        base = self._at_each(scan.stamp, scan.beam_times)
        return Sweep(middle.compose(scan.mount), _composed(base, scan.mount))

    def about(self, stamp: int) -> Pose | None:
        """Pose at `stamp`, or else the newest if it is at most STILL_THERE_NS away; None: nobody knows."""
        end = self._end
        if not end:
            return None
        newest = self._stamps[end - 1]
        if stamp <= newest:
            with suppress(NoPose):
                return self.at(stamp)
        there = abs(stamp - newest) <= STILL_THERE_NS and not self._ambiguous[end - 1]
        return self._newest_pose if there else None

    def lately(self) -> tuple[int, tuple[float, float, float, float]]:
        """From which stamp on a robot with a pose was in a box, and that: xmin, ymin, xmax, ymax."""
        begin, end = max(self._start, self._end - _LATELY), self._end
        xs, ys = self._poses[3 * begin : 3 * end : 3], self._poses[3 * begin + 1 : 3 * end : 3]
        since = self._stamps[begin] if begin > self._start else -1
        return since, (min(xs), min(ys), max(xs), max(ys))

    def pieces(self, stamp: int, first: int, last: int) -> list[Piece]:
        """What `about` says of all times from `first` to `last`, which are told in ns after `stamp`.

        Of each time the first piece that holds it says where the robot was; if none does, nobody knows.
        """
        start, end, stamps, poses = self._start, self._end, self._stamps, self._poses
        if not end:
            return []
        newest = stamps[end - 1] - stamp
        found = []
        if first <= newest:
            low = max(start, bisect_left(stamps, stamp + first, start, end) - 1)
            high = min(bisect_left(stamps, stamp + last, low, end), end - 1)
            for n in range(low, high):
                if self._gap_after(n) is None:
                    x0, y0, _, x1, y1, _ = _read_two(poses, 24 * n)
                    found.append(Piece(stamps[n] - stamp, stamps[n + 1] - stamp, x0, y0, x1, y1))
            if len(found) < max(high - low, 1):  # some poses stand alone
                alone = [n for n in range(low, high + 1) if not self._ambiguous[n]]
                found += [
                    Piece(stamps[n] - stamp, stamps[n] - stamp, *poses[3 * n : 3 * n + 2] * 2) for n in alone
                ]
        if not self._ambiguous[end - 1]:
            there = self._newest_pose[:2] * 2
            found.append(Piece(newest - STILL_THERE_NS, newest + STILL_THERE_NS, *there))
        return found

    def _gap_after(self, n: int) -> Reason | None:
        """Why nothing is said of the time between a pose and the next one; None if they are joined."""
        ambiguous, stamps = self._ambiguous, self._stamps
        if ambiguous[n] or ambiguous[n + 1]:
            return reasons.AMBIGUOUS
        between = stamps[n + 1] - stamps[n]
        if between <= self._gap_ns or nearly_equal(self._pose(n), self._pose(n + 1)):
            return None
        return reasons.gap(between, self._gap_ns)

    def _at_each(self, stamp: int, after: NDArray[np.float64]) -> NDArray[np.float64]:
        """Poses, shape (N, 3), at `after` ns after `stamp`: times between the oldest and the newest pose."""
        kept = self._start, self._end
        first = max(self._start, bisect_left(self._stamps, stamp + int(after.min()), *kept) - 1)
        last = bisect_left(self._stamps, stamp + int(after.max()), *kept)
        times = np.array([kept - stamp for kept in self._stamps[first : last + 1]], np.float64)
        nodes = np.array(self._poses[3 * first : 3 * last + 3]).reshape(-1, 3)
        rows = nodes.tolist()
        steps = np.zeros(nodes.shape)
        joined = np.ones(len(rows), np.bool_)  # to the next one
        for n, ((x0, y0, theta0), (x1, y1, theta1)) in enumerate(pairwise(rows)):
            steps[n] = x1 - x0, y1 - y0, shorter_arc(theta0, theta1)
            joined[n] = self._gap_after(first + n) is None
        upper = np.searchsorted(times, after)
        lower = np.maximum(upper - 1, 0)
        met = times[upper] == after
        sure = np.array([not ambiguous for ambiguous in self._ambiguous[first : last + 1]])
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
        math.hypot(other.x - one.x, other.y - one.y) <= NEAR_M
        and abs(shorter_arc(one.theta, other.theta)) <= NEAR_RAD
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
