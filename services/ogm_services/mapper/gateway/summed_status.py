"""Summed status: what the shares of a map have counted, put together as one mapper would tell it.

What is counted before it is known where a scan was taken is the same in all shares: the first one's counts. A
scan that is placed is counted by its home, the share in which its sensor stood: these are added up. What a
share had no time for is its own, and makes its cells lack scans that others have: the first one's is told.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

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


@dataclass(frozen=True, slots=True)
class Sums:
    """What the shares have counted together."""

    counts: MessageCounts
    known_cells: int
    bytes: int

    @property
    def balanced(self) -> bool:
        """Whether every scan that was received is in the sums: not while one share is ahead of another.

        Nor after one of them was started again, which counts anew.
        """
        scans = self.counts.scans
        return scans.received == scans.integrated + scans.pending + sum(scans.dropped.values())


def summed(statuses: Mapping[int, Status]) -> Sums:
    """The counts of some shares, by share, as those of one mapper."""
    told = [statuses[share] for share in sorted(statuses)]
    if told:
        scans, first = _scans([status.scans for status in told]), told[0]
        counts = MessageCounts(scans, first.poses, first.other, _robots([status.robots for status in told]))
    else:
        poses = PoseCounts(**{field.name: 0 for field in fields(PoseCounts)})
        nothing = ScanCounts(0, 0, 0, dict.fromkeys(DROP_REASONS, 0))
        counts = MessageCounts(nothing, poses, OtherCounts(0), {})
    infos = [status.map_info for status in told]
    return Sums(counts, sum(info.known_cells for info in infos), sum(info.bytes for info in infos))


class _Placed(NamedTuple):
    """What became of scans, of all robots or of one sensor."""

    received: int
    integrated: int
    pending: int
    dropped: dict[str, int]
    beams_on_robots: int


def _placed(told: Sequence[ScanCounts] | Sequence[SourceStatus]) -> _Placed:
    first = told[0]
    reasons = {reason: None for counts in told for reason in counts.dropped}
    dropped = {
        reason: sum(counts.dropped.get(reason, 0) for counts in (told if reason in BY_HOME else told[:1]))
        for reason in reasons
    }
    return _Placed(
        received=first.received,
        integrated=sum(counts.integrated for counts in told),
        # Each waits in all shares until its place is known.
        pending=max(counts.pending for counts in told),
        dropped=dropped,
        beams_on_robots=sum(counts.beams_on_robots for counts in told),
    )


def _scans(told: Sequence[ScanCounts]) -> ScanCounts:
    first, placed = told[0], _placed(told)
    return ScanCounts(
        received=placed.received,
        integrated=placed.integrated,
        pending=placed.pending,
        dropped=placed.dropped,
        lost=first.lost,
        replayed=first.replayed,
        beams_on_robots=placed.beams_on_robots,
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
    first, placed = told[0], _placed(told)
    return SourceStatus(
        run=first.run,
        last_seq=first.last_seq,
        received=placed.received,
        pending=placed.pending,
        integrated=placed.integrated,
        dropped={reason: count for reason, count in placed.dropped.items() if count},
        hints=list(dict.fromkeys(hint for counts in told for hint in counts.hints)),
        lost=first.lost,
        beams_on_robots=placed.beams_on_robots,
    )
