"""Kept poses: the recent ones of a robot in memory, in the order of their stamps."""

from array import array
from bisect import bisect_left
from struct import Struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.placing.held import Held
from ogm_core.placing.rules import PlacingRules
from ogm_core.types import IDENTITY, Pose

SPAN_NS = 60_000_000_000
"""Older poses than that are forgotten, once there are more than are kept at least."""
POSE_BYTES = 8 + 3 * 8 + 1
"""A stamp, x, y, theta, and whether the stamp is ambiguous."""
_LEAST_ROOM = 16
_new = tuple.__new__  # Pose() takes three times as long
_write_pose = Struct("3d").pack_into
_read_pose = Struct("3d").unpack_from


class HistoryState(NamedTuple):
    """Poses of a history, of the `first` to before the `end`, counted from the one that it began with.

    `stamps` (int64, ns), `poses` (float64; x, y in m and theta in rad of each) and `ambiguous` (bytes, 1
    where the stamp is) are buffers that nobody changes any more.
    """

    first: int
    stamps: memoryview | NDArray[np.int64]
    poses: memoryview | NDArray[np.float64]
    ambiguous: bytes

    @property
    def end(self) -> int:
        """One past the number of the newest."""
        return self.first + len(self.stamps)


class KeptPoses:
    """The newest poses of one robot, in the order of their stamps (ns, below 2^63).

    Poses lie in arrays of a fixed size, a quarter larger than is needed; the next ones take their place when
    they are full. So what `state` shows stays as it is, whatever comes later.
    """

    def __init__(self, rules: PlacingRules, held: Held | None = None) -> None:
        """`rules`: how many poses are kept. `held` counts what they take in memory."""
        self._fewest, self._most = rules.fewest_poses, rules.most_poses
        self._held = Held() if held is None else held
        self._stamps = array("q")
        self._poses = array("d")
        """x, y, theta of each."""
        self._ambiguous = bytearray()
        """1 where the stamp is."""
        self._start = self._end = 0
        """Which part of them is kept."""
        self._moved = 0
        """The number of the first one in the arrays."""
        self._newest_pose = IDENTITY

    def __len__(self) -> int:
        return self._end - self._start

    @property
    def nbytes(self) -> int:
        """What it takes in memory, with the room for poses to come."""
        return len(self._stamps) * POSE_BYTES

    @property
    def state(self) -> HistoryState:
        """What is kept. Poses are not copied: those that are there never change."""
        start, end = self._start, self._end
        stamps = memoryview(self._stamps)[start:end].toreadonly()
        poses = memoryview(self._poses)[3 * start : 3 * end].toreadonly()
        return HistoryState(self._moved + start, stamps, poses, bytes(memoryview(self._ambiguous)[start:end]))

    def restore(self, state: HistoryState) -> None:
        """Go on from such a state, in a history without a pose."""
        self._stamps, self._poses = array("q", bytes(state.stamps)), array("d", bytes(state.poses))
        self._ambiguous = bytearray(state.ambiguous)
        self._moved, self._end = state.first, len(self._stamps)
        if self._end:
            self._newest_pose = self._pose(self._end - 1)
        self._held.add(self.nbytes)

    @property
    def oldest(self) -> int | None:
        """Stamp of the oldest kept pose, ns."""
        return self._stamps[self._start] if self._end else None

    @property
    def newest(self) -> int | None:
        """Stamp of the newest pose, ns."""
        return self._stamps[self._end - 1] if self._end else None

    @property
    def newest_pose(self) -> Pose:
        """The newest pose; there must be one."""
        return self._newest_pose

    def append(self, stamp: int, pose: Pose) -> None:
        """Keep a pose that is later than the newest, and forget the oldest ones if there are enough."""
        end, stamps, poses = self._end, self._stamps, self._poses
        if end == len(stamps):
            self._move()
            end, stamps, poses = self._end, self._stamps, self._poses
        stamps[end] = stamp
        _write_pose(poses, 24 * end, *pose)
        self._newest_pose = pose
        self._end = end = end + 1
        start, fewest = self._start, self._fewest
        if end - start > fewest:
            while end - start > fewest and (stamp - stamps[start] > SPAN_NS or end - start > self._most):
                start += 1
            self._start = start

    def shorten(self) -> bool:
        """Forget all poses but those that are kept at least; False if there are no others."""
        if len(self) <= self._fewest:
            return False
        self._start = self._end - self._fewest
        self._move()
        return True

    def doubt(self, stamp: int) -> None:
        """Mark a kept stamp as ambiguous: another pose has it, too."""
        n = bisect_left(self._stamps, stamp, self._start, self._end)
        if n < self._end and self._stamps[n] == stamp:
            self._ambiguous[n] = 1

    def _pose(self, n: int) -> Pose:
        return _new(Pose, _read_pose(self._poses, 24 * n))

    def _move(self) -> None:
        """Move what is kept into arrays with room for a quarter more."""
        start, end = self._start, self._end
        kept = end - start
        more = max(kept // 4, _LEAST_ROOM)
        before = self.nbytes
        self._stamps = self._stamps[start:end] + array("q", bytes(8 * more))
        self._poses = self._poses[3 * start : 3 * end] + array("d", bytes(24 * more))
        self._ambiguous = self._ambiguous[start:end] + bytes(more)
        self._moved += start
        self._start, self._end = 0, kept
        self._held.add(self.nbytes - before)
