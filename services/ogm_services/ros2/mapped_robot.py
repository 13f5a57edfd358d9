"""Mapped robot: one that a mapper is told of, by our own messages, under one name."""

import uuid
from collections import Counter
from collections.abc import Callable
from typing import Protocol

from ogm_client.errors import NobodyAnswered
from ogm_core.types import IDENTITY, Pose, PoseStamped, Scan

LEAD_NS = 1_000_000_000
"""A mapper waits longer than that for a scan's pose, unless its `pose_wait`, 2 s, is set to less."""
MakeScan = Callable[[int, str], Scan]
"""A scan of a number and run."""


class Publisher(Protocol):
    """Where a robot's messages go, as through a RobotPublisher; `run` names the first run."""

    robot: str
    run: str

    def put_pose(self, message: PoseStamped) -> None:
        """Take a pose."""

    def put_scan(self, sensor: str, message: Scan) -> None:
        """Take a scan of a sensor."""

    def wait_for_mapper(self, timeout: float) -> None:
        """Wait until somebody takes them, s; NobodyAnswered if nobody does."""

    def close(self) -> None:
        """Take no more."""


class MappedRobot:
    """Sends a robot's poses and scans, numbered as they come, in a run that is new at each start."""

    def __init__(self, publisher: Publisher, origin: Pose | None) -> None:
        """`origin`: where the frame of the poses that are given lies in the map; None: it is the map's."""
        self.name = publisher.robot
        self.origin = origin
        self._publisher = publisher
        self._newest: int | None = None
        """Stamp of the newest pose that was sent in this run, ns."""
        self._begin(publisher.run)

    def begin_run(self) -> None:
        """Number anew, as what was sent before has no more to do with what follows."""
        self._begin(uuid.uuid4().hex)

    def send_pose(self, stamp: int, pose: Pose) -> None:
        """Send the pose of its base at a stamp, ns.

        Raises:
            BadMessage: the stamp is no mapper's.
        """
        placed = (self.origin or IDENTITY).compose(pose)
        self._publisher.put_pose(PoseStamped(stamp, placed, self._poses, self._run))
        self._poses += 1
        self._newest = stamp

    @property
    def heard(self) -> bool:
        """Whether somebody takes its poses."""
        try:
            self._publisher.wait_for_mapper(0.0)
        except NobodyAnswered:
            return False
        return True

    def is_ahead(self, stamp: int) -> bool:
        """Whether a stamp, ns, lies so far after the newest pose that a mapper might not wait for its own."""
        return self._newest is None or stamp - self._newest > LEAD_NS

    def send_scan(self, sensor: str, make: MakeScan) -> None:
        """Send a scan that is made for its number and run.

        Raises:
            BadMessage, Tilted: it cannot be made; no number is used up.
        """
        self._publisher.put_scan(sensor, make(self._seqs[sensor], self._run))
        self._seqs[sensor] += 1

    def close(self) -> None:
        """Withdraw; what it keeps for the mapper is gone."""
        self._publisher.close()

    def _begin(self, run: str) -> None:
        self._run = run
        self._seqs: Counter[str] = Counter()
        self._poses = 0
        self._newest = None
