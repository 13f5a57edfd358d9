"""Receipts of messages: what came in, and what became of it."""

import threading
from collections import Counter
from dataclasses import dataclass, field, fields
from typing import Literal, NamedTuple, get_args

from ogm_core.status import MessageCounts, OtherCounts, PoseCounts, RobotStatus, ScanCounts, SourceStatus
from ogm_core.types import Pose

DropReason = Literal[
    "malformed",
    "no_pose",
    "duplicate",
    "stale",
    "overload",
    "limit",
    "outside",
    "superseded",
    "failed",
    "refused",
]
DROP_REASONS: tuple[DropReason, ...] = get_args(DropReason)
PoseNote = Literal["malformed", "late", "restarted", "ambiguous", "outlier", "superseded", "refused"]
"""What is odd about a pose."""


@dataclass(slots=True)
class _Sensor:
    run: str = ""
    last_seq: int | None = None
    received: int = 0
    integrated: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    hints: list[str] = field(default_factory=list)

    @property
    def pending(self) -> int:
        return self.received - self.integrated - self.dropped.total()

    def status(self) -> SourceStatus:
        counts = self.received, self.pending, self.integrated
        return SourceStatus(self.run, self.last_seq, *counts, dict(self.dropped), list(self.hints))


@dataclass(slots=True)
class _Robot:
    pose: Pose | None = None
    stamp: int | None = None
    runs_alive: set[str] = field(default_factory=set)
    heard: float | None = None
    sensors: dict[str, _Sensor] = field(default_factory=dict)

    def status(self, now: float | None) -> RobotStatus:
        sources = {name: sensor.status() for name, sensor in self.sensors.items()}
        age = None if now is None or self.heard is None else max(0.0, now - self.heard)
        return RobotStatus(self.pose, self.stamp, bool(self.runs_alive), age, sources)


class Presence(NamedTuple):
    """Whether a robot's liveliness token is there, and when it was heard last, s; None: never."""

    alive: bool
    heard: float | None


class Receipts:
    """Counts of poses and scans. Any thread; one lock, held for a few assignments.

    A scan is received once, and later either integrated or dropped for one reason: what is neither yet is
    pending, so received = integrated + pending + dropped at every moment.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._robots: dict[str, _Robot] = {}
        self._poses: Counter[str] = Counter()
        self._ignored = 0

    def pose_received(self, robot: str) -> None:
        """Count a pose at its arrival."""
        with self._lock:
            self._robot(robot)
            self._poses["received"] += 1

    def pose_noted(self, note: PoseNote) -> None:
        """Count a pose that is not used, or that is odd in another way."""
        with self._lock:
            self._poses[note] += 1

    def heard(self, robot: str, now: float) -> None:
        """Note that any message of a robot has arrived, at `now`, s of the clock that `status` is told."""
        with self._lock:
            self._robot(robot).heard = now

    def robot_alive(self, robot: str, run: str, alive: bool) -> None:
        """Note whether the liveliness token of a robot's run is there."""
        with self._lock:
            runs = self._robot(robot).runs_alive
            if alive:
                runs.add(run)
            else:
                runs.discard(run)

    def hint(self, robot: str, sensor: str, slug: str) -> None:
        """Note what looks wrong with a source's data, each once."""
        with self._lock:
            hints = self._sensor(robot, sensor).hints
            if slug not in hints:
                hints.append(slug)

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

    def status(self, now: float | None = None) -> MessageCounts:
        """The `scans`, `poses`, `other` and `robots` of a mapper's status, of one moment, `now` in s."""
        with self._lock:
            sensors = [sensor for robot in self._robots.values() for sensor in robot.sensors.values()]
            return MessageCounts(
                scans=ScanCounts(
                    received=sum(sensor.received for sensor in sensors),
                    integrated=sum(sensor.integrated for sensor in sensors),
                    pending=sum(sensor.pending for sensor in sensors),
                    dropped={reason: sum(s.dropped[reason] for s in sensors) for reason in DROP_REASONS},
                ),
                poses=PoseCounts(**{field.name: self._poses[field.name] for field in fields(PoseCounts)}),
                other=OtherCounts(self._ignored),
                robots={name: robot.status(now) for name, robot in self._robots.items()},
            )

    def presence(self) -> dict[str, Presence]:
        """Which robots are known, and whether they are there."""
        with self._lock:
            return {
                name: Presence(bool(robot.runs_alive), robot.heard) for name, robot in self._robots.items()
            }

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
