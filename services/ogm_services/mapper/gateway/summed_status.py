"""Summed status: what the shares of a map have counted, put together as one mapper would tell it.

What is counted before it is known where a scan was taken is the same in all shares: the first one's counts. A
scan that is placed is counted by its home, the share in which its sensor stood: these are added up. What a
share had no time for is its own, and makes its cells lack scans that others have: the first one's is told.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeVar

from ogm_core.placing.receipts import DROP_REASONS
from ogm_core.status import (
    MessageCounts,
    OtherCounts,
    PoseCounts,
    RobotStatus,
    ScanCounts,
    SourceStatus,
    Status,
)

BY_HOME = frozenset({"limit", "outside", "failed"})
"""Reasons that a scan is dropped for once its place is known: each is counted by its home."""
OVERLOAD = "overload"
Counts = TypeVar("Counts", ScanCounts, SourceStatus)


@dataclass(frozen=True, slots=True)
class Sums:
    """What the shares have counted together."""

    counts: MessageCounts
    known_cells: int
    bytes: int

    @property
    def balanced(self) -> bool:
        """Whether every scan that was received is in the sums: not while one share is ahead of another.

        Nor ever again after one of them has lost its store, and counts anew.
        """
        scans = self.counts.scans
        return scans.received == scans.integrated + scans.pending + sum(scans.dropped.values())


def summed(statuses: Mapping[int, Status]) -> Sums:
    """The counts of some shares, by share, as those of one mapper."""
    told = [statuses[share] for share in sorted(statuses)]
    if told:
        scans, first = _summed([status.scans for status in told]), told[0]
        counts = MessageCounts(scans, first.poses, first.other, _robots([status.robots for status in told]))
    else:
        poses = PoseCounts(**{field.name: 0 for field in fields(PoseCounts)})
        nothing = ScanCounts(0, 0, 0, dict.fromkeys(DROP_REASONS, 0))
        counts = MessageCounts(nothing, poses, OtherCounts(0), {})
    infos = [status.map_info for status in told]
    return Sums(counts, sum(info.known_cells for info in infos), sum(info.bytes for info in infos))


def _summed(told: Sequence[Counts]) -> Counts:
    """Counts of scans, of all robots or of one sensor, by share: the first one's, with the sums of homes."""
    reasons = {reason: None for counts in told for reason in counts.dropped}
    return replace(
        told[0],
        integrated=sum(counts.integrated for counts in told),
        # Each waits in all shares until its place is known.
        pending=max(counts.pending for counts in told),
        dropped={
            reason: sum(counts.dropped.get(reason, 0) for counts in (told if reason in BY_HOME else told[:1]))
            for reason in reasons
        },
        beams_on_robots=sum(counts.beams_on_robots for counts in told),
        of_others=None,
    )


def _robots(told: Sequence[Mapping[str, RobotStatus]]) -> dict[str, RobotStatus]:
    names = {name: None for robots in told for name in robots}
    return {name: _robot([robots[name] for robots in told if name in robots]) for name in names}


def _robot(told: Sequence[RobotStatus]) -> RobotStatus:
    newest = max(told, key=lambda robot: -1 if robot.stamp is None else robot.stamp)
    ages = [robot.age_s for robot in told if robot.age_s is not None]
    sensors = {name: None for robot in told for name in robot.sources}
    return RobotStatus(
        pose=newest.pose,
        stamp=newest.stamp,
        alive=any(robot.alive for robot in told),
        age_s=min(ages, default=None),
        sources={
            name: _source([robot.sources[name] for robot in told if name in robot.sources])
            for name in sensors
        },
    )


def _source(told: Sequence[SourceStatus]) -> SourceStatus:
    sums = _summed(told)
    return replace(
        sums,
        dropped={reason: count for reason, count in sums.dropped.items() if count},
        hints=list(dict.fromkeys(hint for counts in told for hint in counts.hints)),
    )
