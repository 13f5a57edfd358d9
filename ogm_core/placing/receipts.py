"""Receipts of messages: what came in, and what became of it."""

import threading
from collections import Counter
from dataclasses import dataclass, field
from typing import Literal, get_args

from ogm_core.status import MessageCounts, OtherCounts, PoseCounts, RobotStatus, ScanCounts, SourceStatus
from ogm_core.types import Pose

DropReason = Literal["malformed", "no_pose", "duplicate", "stale", "overload", "limit", "outside", "failed"]
DROP_REASONS: tuple[DropReason, ...] = get_args(DropReason)


@dataclass(slots=True)
class _Sensor:
    run: str = ""
    last_seq: int | None = None
    received: int = 0
    integrated: int = 0
    dropped: Counter[str] = field(default_factory=Counter)

    @property
    def pending(self) -> int:
        return self.received - self.integrated - self.dropped.total()

    def status(self) -> SourceStatus:
        return SourceStatus(self.run, self.last_seq, self.received, self.pending, self.integrated)


@dataclass(slots=True)
class _Robot:
    pose: Pose | None = None
    stamp: int | None = None
    sensors: dict[str, _Sensor] = field(default_factory=dict)

    def status(self) -> RobotStatus:
        sources = {name: sensor.status() for name, sensor in self.sensors.items()}
        return RobotStatus(self.pose, self.stamp, sources)


class Receipts:
    """Counts of poses and scans. Any thread; one lock, held for a few assignments.

    A scan is received once, and later either integrated or dropped for one reason: what is neither yet is
    pending, so received = integrated + pending + dropped at every moment.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._robots: dict[str, _Robot] = {}
        self._poses = {"received": 0, "malformed": 0, "late": 0}
        self._ignored = 0

    def pose_received(self, robot: str) -> None:
        """Count a pose at its arrival."""
        with self._lock:
            self._robot(robot)
            self._poses["received"] += 1

    def pose_refused(self, reason: Literal["malformed", "late"]) -> None:
        """Count a pose that is not used."""
        with self._lock:
            self._poses[reason] += 1

    def ignored(self) -> None:
        """Count a message that is neither a pose nor a scan."""
        with self._lock:
            self._ignored += 1

    def located(self, robot: str, stamp: int, pose: Pose) -> None:
        """Note where a robot's base was last said to be."""
        with self._lock:
            entry = self._robot(robot)
            entry.stamp, entry.pose = stamp, pose

    def scan_received(self, robot: str, sensor: str) -> None:
        """Count a scan at its arrival."""
        with self._lock:
            self._sensor(robot, sensor).received += 1

    def scan_taken(self, robot: str, sensor: str, run: str, seq: int) -> None:
        """Note the last scan that the worker has taken from the queue."""
        with self._lock:
            entry = self._sensor(robot, sensor)
            entry.run, entry.last_seq = run, seq

    def scan_integrated(self, robot: str, sensor: str) -> None:
        """Count a scan that is in the map."""
        with self._lock:
            self._sensor(robot, sensor).integrated += 1

    def scan_dropped(self, robot: str, sensor: str, reason: DropReason) -> None:
        """Count a scan that will never be in the map."""
        with self._lock:
            self._sensor(robot, sensor).dropped[reason] += 1

    def status(self) -> MessageCounts:
        """The `scans`, `poses`, `other` and `robots` of a mapper's status, of one moment."""
        with self._lock:
            sensors = [sensor for robot in self._robots.values() for sensor in robot.sensors.values()]
            return MessageCounts(
                scans=ScanCounts(
                    received=sum(sensor.received for sensor in sensors),
                    integrated=sum(sensor.integrated for sensor in sensors),
                    pending=sum(sensor.pending for sensor in sensors),
                    dropped={reason: sum(s.dropped[reason] for s in sensors) for reason in DROP_REASONS},
                ),
                poses=PoseCounts(**self._poses),
                other=OtherCounts(self._ignored),
                robots={name: robot.status() for name, robot in self._robots.items()},
            )

    def _robot(self, robot: str) -> _Robot:
        entry = self._robots.get(robot)
        if entry is None:
            entry = self._robots[robot] = _Robot()
        return entry

    def _sensor(self, robot: str, sensor: str) -> _Sensor:
        sensors = self._robot(robot).sensors
        entry = sensors.get(sensor)
        if entry is None:
            entry = sensors[sensor] = _Sensor()
        return entry
