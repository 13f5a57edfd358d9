"""Counts of one robot, and of one sensor, as `Receipts` keeps them."""

from collections import Counter
from dataclasses import dataclass, field, replace

from ogm_core.placing.rules import FORGOTTEN_AFTER
from ogm_core.status import RobotStatus, ScansOfOthers, SourceStatus
from ogm_core.types import Pose


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

    def status(self, now: float | None, in_shares: bool) -> RobotStatus:
        """What its status says, `now` in s."""
        sources = {name: sensor.status(in_shares) for name, sensor in self.sensors.items()}
        return replace(self.place(now), sources=sources)

    def place(self, now: float | None) -> RobotStatus:
        """The same without its sensors."""
        age = None if now is None or self.heard is None else max(0.0, now - self.heard)
        return RobotStatus(self.pose, self.stamp, bool(self.runs_alive), age)
