"""Receipts of messages: what came in, and what became of it."""

import threading
from collections import Counter
from collections.abc import Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import Literal, NamedTuple, get_args

from ogm_core.placing.counts import RobotCounts, SensorCounts
from ogm_core.placing.rules import MAX_ROBOTS, MAX_SENSORS
from ogm_core.status import MessageCounts, OtherCounts, PoseCounts, RobotStatus, ScanCounts
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
Whose = Literal["home", "border", "elsewhere"]
"""Whose a placed scan is to count where a map is cut (see `ogm_core.shares`): its home's, the share in which
its sensor stood. To others it may reach across the border, or is elsewhere."""
OfOthers = Literal["border", "border_dropped", "elsewhere"]
"""What a share counts of those that are others': `border_dropped` those that may reach it and are
missing in it, for want of memory or by a bug."""
_NO_SENSORS: Mapping[str, SensorCounts] = MappingProxyType({})
_MAX_RUNS_ALIVE = 64
"""Runs of a robot whose liveliness tokens are told apart; more are not heard of."""


class Presence(NamedTuple):
    """Whether a robot's liveliness token is there, and when it was heard last, s; None: never."""

    alive: bool
    heard: float | None


class Receipts:
    """Counts of poses and scans. Any thread; one lock, held for a few assignments.

    A scan is received once, and later either integrated or dropped for one reason: what is neither yet is
    pending, so received = integrated + pending + dropped at every moment. What never came, and cannot be had
    again, is lost; what comes again though it was decided before is replayed: neither is received.

    Every robot and sensor has counts of its own, up to MAX_ROBOTS robots and MAX_SENSORS sensors of each; the
    messages of more are refused: counted in all, and to be handed on to nobody. A robot that is gone, by the
    times that are told (s, of one clock), makes room when it is forgotten; what was counted of it stays in
    the totals.

    Scans that were decided in earlier lives of a mapper that stores its map are counted on; poses, and
    scans that came again, are counted of this life alone.

    Where the map is cut into shares, a scan that is placed is integrated or dropped in its home alone; the
    other shares count it as of others: received = integrated + pending + dropped + those of others.
    """

    def __init__(self, *, in_shares: bool = False) -> None:
        self._in_shares = in_shares
        self._lock = threading.Lock()
        self._robots: dict[str, RobotCounts] = {}
        self._scans = SensorCounts()
        """Of all robots, those that have no counts of their own, too."""
        self._poses: Counter[str] = Counter()
        self._ignored = 0
        self._replayed = 0
        """Scans that came again."""
        self.moves = 0
        """How often a robot's pose, or whether it is alive, was noted."""

    def pose_received(self, robot: str, now: float | None = None) -> bool:
        """Count a pose at its arrival; False: it is refused, and counted so."""
        with self._lock:
            self._poses["received"] += 1
            entry = self._heard(robot, now)
            if entry is None:
                self._poses["refused"] += 1
            return entry is not None

    def scan_received(self, robot: str, sensor: str, now: float | None = None) -> bool:
        """Count a scan at its arrival; False: it is refused, and counted so."""
        with self._lock:
            self._scans.received += 1
            entry = self._heard(robot, now)
            if entry is None or (sensor not in entry.sensors and len(entry.sensors) >= MAX_SENSORS):
                self._scans.dropped["refused"] += 1
                return False
            if sensor not in entry.sensors:
                entry.sensors[sensor] = SensorCounts()
            self._changing(robot, sensor).received += 1
            return True

    def scan_lost(self, robot: str, sensor: str, count: int) -> None:
        """Count scans of a source that never came, and that cannot be had again."""
        with self._lock:
            self._scans.lost += count
            self._changing(robot, sensor).lost += count

    def pose_lost(self, count: int) -> None:
        """Count poses that never came, likewise."""
        with self._lock:
            self._poses["lost"] += count

    def scan_replayed(self) -> None:
        """Count a scan that has come again, of which it was decided before what becomes of it."""
        with self._lock:
            self._replayed += 1

    def pose_replayed(self) -> None:
        """Count a pose that has come again, likewise."""
        with self._lock:
            self._poses["replayed"] += 1

    def admits(self, robot: str, now: float | None = None) -> bool:
        """Whether a robot has counts of its own, or gets them now: there is a last one."""
        with self._lock:
            return self._admitted(robot, now) is not None

    def restored(
        self, robot: str, now: float | None = None, sensors: Mapping[str, SensorCounts] = _NO_SENSORS
    ) -> bool:
        """Know a robot from an earlier life of the mapper, for as long as if it had been heard now.

        `sensors`: what was counted then of its scans, of those that are decided. False if it is one robot too
        many: then they count in all alone.
        """
        with self._lock:
            entry = self._admitted(robot, now)
            for name, counts in sensors.items():
                self._add_earlier(counts)
                if entry is not None:
                    entry.sensors[name] = counts.gone_on()
            if entry is not None:
                entry.restored = True
            return entry is not None

    def restored_of_gone(self, counts: SensorCounts) -> None:
        """Count in all what was counted in earlier lives of robots that were forgotten."""
        with self._lock:
            self._add_earlier(counts)

    def gone(self, now: float) -> list[str]:
        """Robots that are not alive, and were never heard, or neither heard nor alive for FORGOTTEN_AFTER."""
        with self._lock:
            return [name for name, robot in self._robots.items() if robot.gone(now)]

    def forget(self, robot: str, now: float) -> bool:
        """Give up the counts of one of those; False if it has come back, or a scan of it is pending."""
        with self._lock:
            entry = self._robots[robot]
            if not entry.gone(now) or any(sensor.pending for sensor in entry.sensors.values()):
                return False
            del self._robots[robot]
            return True

    def pose_noted(self, note: PoseNote) -> None:
        """Count a pose that is not used, or that is odd in another way."""
        with self._lock:
            self._poses[note] += 1

    def robot_alive(self, robot: str, run: str, alive: bool, now: float | None = None) -> None:
        """Note whether the liveliness token of a robot's run is there; one that goes makes no robot known."""
        with self._lock:
            entry = self._admitted(robot, now) if alive else self._robots.get(robot)
            if entry is None:
                return
            entry.seen_at(now)
            self.moves += 1
            if not alive:
                entry.runs_alive.discard(run)
            elif len(entry.runs_alive) < _MAX_RUNS_ALIVE:
                entry.runs_alive.add(run)

    def hint(self, robot: str, sensor: str, slug: str) -> None:
        """Note what looks wrong with a source's data, each once."""
        with self._lock:
            hints = self._changing(robot, sensor).hints
            if slug not in hints:
                hints.append(slug)

    def ignored(self) -> None:
        """Count a message that is neither a pose nor a scan."""
        with self._lock:
            self._ignored += 1

    def located(self, robot: str, stamp: int, pose: Pose) -> None:
        """Note where a robot's base was last said to be."""
        with self._lock:
            entry = self._robots.get(robot)
            if entry is not None:
                entry.stamp, entry.pose = stamp, pose
                self.moves += 1

    def scan_taken(self, robot: str, sensor: str, run: str, seq: int) -> None:
        """Note the last scan that the worker has taken from the queue."""
        with self._lock:
            entry = self._changing(robot, sensor)
            entry.run, entry.last_seq = run, seq

    def scan_integrated(self, robot: str, sensor: str, beams_on_robots: int = 0) -> None:
        """Count a scan that is in the map, but for so many beams that ended at other robots."""
        with self._lock:
            counts = self._changing(robot, sensor)
            self._scans.integrated += 1
            counts.integrated += 1
            if beams_on_robots:
                self._scans.beams_on_robots += beams_on_robots
                counts.beams_on_robots += beams_on_robots

    def scan_dropped(self, robot: str, sensor: str, reason: DropReason) -> None:
        """Count a scan that will never be in the map."""
        with self._lock:
            self._scans.dropped[reason] += 1
            self._changing(robot, sensor).dropped[reason] += 1

    def scan_of_others(self, robot: str, sensor: str, kind: OfOthers) -> None:
        """Count a scan that another share is to count: what became of it here."""
        with self._lock:
            self._scans.of_others[kind] += 1
            self._changing(robot, sensor).of_others[kind] += 1

    def status(self, now: float | None = None, *, since_start: bool = False) -> MessageCounts:
        """The `scans`, `poses`, `other` and `robots` of a mapper's status, of one moment, `now` in s.

        `since_start`: without what earlier lives of the mapper have counted.
        """
        with self._lock:
            scans = self._scans.since_start() if since_start else self._scans
            return MessageCounts(
                scans=ScanCounts(
                    received=scans.received,
                    integrated=scans.integrated,
                    pending=scans.pending,
                    dropped={reason: scans.dropped[reason] for reason in DROP_REASONS},
                    lost=scans.lost,
                    replayed=self._replayed,
                    beams_on_robots=scans.beams_on_robots,
                    of_others=scans.told_of_others(self._in_shares),
                ),
                poses=PoseCounts(**{field.name: self._poses[field.name] for field in fields(PoseCounts)}),
                other=OtherCounts(self._ignored),
                robots={
                    name: robot.status(now, self._in_shares, since_start=since_start)
                    for name, robot in self._robots.items()
                },
            )

    def places(self, now: float) -> dict[str, RobotStatus]:
        """Where the robots are that have said so and are not gone, `now` in s; nothing of their sensors."""
        with self._lock:
            found = {name: robot.place(now) for name, robot in self._robots.items() if robot.pose is not None}
        return {name: robot for name, robot in found.items() if not robot.gone}

    def presence(self) -> dict[str, Presence]:
        """Which robots are known, and whether they are there."""
        with self._lock:
            return {
                name: Presence(bool(robot.runs_alive), robot.heard) for name, robot in self._robots.items()
            }

    def _add_earlier(self, counts: SensorCounts) -> None:
        if self._scans.earlier is None:
            self._scans.earlier = SensorCounts()
        self._scans.add(counts)
        self._scans.earlier.add(counts)

    def _heard(self, robot: str, now: float | None) -> RobotCounts | None:
        """Note that a message of a robot has arrived; None if it is one robot too many."""
        entry = self._robots.get(robot) or self._admitted(robot, now)
        if entry is not None and now is not None:
            entry.heard_at(now)
        return entry

    def _admitted(self, robot: str, now: float | None) -> RobotCounts | None:
        entry = self._robots.get(robot)
        if entry is None and len(self._robots) < MAX_ROBOTS:
            entry = self._robots[robot] = RobotCounts(seen=now)
        return entry

    def _changing(self, robot: str, sensor: str) -> SensorCounts:
        """The counts of a sensor, to change them; some that nobody looks at if it has none."""
        entry = self._robots.get(robot)
        found = None if entry is None else entry.sensors.get(sensor)
        if found is None:
            return SensorCounts()
        found.told = None
        return found
