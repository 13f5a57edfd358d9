"""Counts of one robot, and of one sensor, as `Receipts` keeps them."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace

from ogm_core.placing.rules import FORGOTTEN_AFTER
from ogm_core.status import RobotStatus, ScansOfOthers, SourceStatus
from ogm_core.types import Pose

_NO_DROPS = ("lost", "beams_on_robots", "integrated")
_OF_OTHERS = frozenset(field.name for field in fields(ScansOfOthers))


@dataclass(slots=True)
class SensorCounts:
    """What became of the scans of one sensor, or of all."""

    run: str = ""
    last_seq: int | None = None
    received: int = 0
    integrated: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    of_others: Counter[str] = field(default_factory=Counter)
    hints: list[str] = field(default_factory=list)
    lost: int = 0
    beams_on_robots: int = 0
    told: SourceStatus | None = None
    """What its status was, until it changes: of thousands few change between two who ask."""
    earlier: "SensorCounts | None" = None
    """What of it was counted in earlier lives of the mapper."""

    @classmethod
    def of(cls, outcomes: Mapping[str, int], last: tuple[str, int] | None) -> "SensorCounts":
        """Counts of scans that are decided: how many became what, and the run and seq of the last one."""
        left = Counter(outcomes)
        lost, beams_on_robots, integrated = (left.pop(name, 0) for name in _NO_DROPS)
        of_others = Counter({kind: left.pop(kind) for kind in _OF_OTHERS if kind in left})
        received = integrated + of_others.total() + left.total()
        run, seq = ("", None) if last is None else last
        return cls(run, seq, received, integrated, left, of_others, [], lost, beams_on_robots)

    def gone_on(self) -> "SensorCounts":
        """Counts that begin with these, which are of earlier lives."""
        return replace(
            self, dropped=self.dropped.copy(), of_others=self.of_others.copy(), hints=[], earlier=self
        )

    def since_start(self) -> "SensorCounts":
        """What of it was counted in this life of the mapper."""
        before = self.earlier
        if before is None:
            return self
        return replace(
            self,
            received=self.received - before.received,
            integrated=self.integrated - before.integrated,
            dropped=self.dropped - before.dropped,
            of_others=self.of_others - before.of_others,
            lost=self.lost - before.lost,
            beams_on_robots=self.beams_on_robots - before.beams_on_robots,
            told=None,
            earlier=None,
        )

    def add(self, other: "SensorCounts") -> None:
        """Add the counts of others, which are decided."""
        self.received += other.received
        self.integrated += other.integrated
        self.dropped += other.dropped
        self.of_others += other.of_others
        self.lost += other.lost
        self.beams_on_robots += other.beams_on_robots

    @property
    def pending(self) -> int:
        """Scans that were received, and of which nothing is decided yet."""
        return self.received - self.integrated - self.dropped.total() - self.of_others.total()

    def told_of_others(self, in_shares: bool) -> ScansOfOthers | None:
        """Those that other shares count; None where the map is not cut."""
        return ScansOfOthers(**self.of_others) if in_shares else None

    def status(self, in_shares: bool) -> SourceStatus:
        """What its status says."""
        if self.told is None:
            counts = self.received, self.pending, self.integrated
            dropped, hints = dict(self.dropped), list(self.hints)
            self.told = SourceStatus(
                *(self.run, self.last_seq, *counts, dropped, hints, self.lost),
                self.beams_on_robots,
                self.told_of_others(in_shares),
            )
        return self.told


@dataclass(slots=True)
class RobotCounts:
    """Where a robot is, whether it is alive, and what became of its sensors' scans."""

    pose: Pose | None = None
    stamp: int | None = None
    runs_alive: set[str] = field(default_factory=set)
    heard: float | None = None
    seen: float | None = None
    """When it was heard, or its token came or went, s; None where no times are told."""
    restored: bool = False
    """Whether it is known from an earlier life of the mapper."""
    sensors: dict[str, SensorCounts] = field(default_factory=dict)

    def seen_at(self, now: float | None) -> None:
        """Note that its token came or went, s."""
        if now is not None and (self.seen is None or now > self.seen):
            self.seen = now

    def heard_at(self, now: float) -> None:
        """Note that a message of it came, s."""
        if self.heard is None or now > self.heard:
            self.heard = now
        if self.seen is None or now > self.seen:
            self.seen = now

    def gone(self, now: float) -> bool:
        """Whether it may be forgotten."""
        if self.runs_alive or self.seen is None:
            return False
        # Of one that was never heard nothing is worth its place: tokens cost a stranger nothing.
        return (self.heard is None and not self.restored) or now - self.seen > FORGOTTEN_AFTER

    def status(self, now: float | None, in_shares: bool, *, since_start: bool = False) -> RobotStatus:
        """What its status says, `now` in s; `since_start`: without what earlier lives have counted."""
        sensors = {
            name: sensor.since_start() if since_start else sensor for name, sensor in self.sensors.items()
        }
        sources = {name: sensor.status(in_shares) for name, sensor in sensors.items()}
        return replace(self.place(now), sources=sources)

    def place(self, now: float | None) -> RobotStatus:
        """The same without its sensors."""
        age = None if now is None or self.heard is None else max(0.0, now - self.heard)
        return RobotStatus(self.pose, self.stamp, bool(self.runs_alive), age)
