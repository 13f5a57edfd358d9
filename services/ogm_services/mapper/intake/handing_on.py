"""Handing on of messages: where they go, and what was decided of those before."""

from collections.abc import Callable
from typing import Literal, Protocol

from ogm_core.placing.robot import Skip
from ogm_core.types import PoseStamped, Scan
from ogm_core.wire.heads import read_head
from ogm_core.wire.keys import Source

WhyLost = Literal["not kept", "no answer", "not held"]
"""No cache has it any more; or one that may have it did not answer; or it came, and was too much to hold."""


class Decided(Protocol):
    """What was decided of robots' messages, in this life of the mapper or an earlier one. Any thread."""

    def is_decided(self, robot: str, sensor: str | None, run: str, seq: int) -> bool:
        """Whether a scan of that seq, or with None a pose, was integrated or dropped for good."""
        ...

    def last(self, robot: str, sensor: str | None, run: str) -> int | None:
        """The highest seq up to which all are decided; None if none is."""
        ...

    def skip(
        self,
        robot: str,
        sensor: str | None,
        run: str,
        first: int,
        last: int,
        outcome: Skip = "lost",
        count: int | None = None,
    ) -> None:
        """Note that messages, from a seq to another one, will never be taken: they are decided by that.

        `count` of them, None: all, were not before.
        """
        ...

    def drop_unnumbered(self, robot: str, sensor: str, outcome: Skip) -> None:
        """Note that a scan without a number is dropped."""
        ...

    def wait_on(self, robot: str, until: float) -> None:
        """Let a robot's scans wait for their poses at least until then, s: they may come later than usual."""
        ...


class Placing(Protocol):
    """Where messages end up: a `ScanPlacer`, or who takes them in its stead. The worker's, but for `decided`.

    Times, s, are of one clock.
    """

    @property
    def decided(self) -> Decided:
        """What was decided; any thread."""
        ...

    def add_pose(self, name: str, message: PoseStamped, now: float = 0.0) -> None:
        """Take a robot's pose."""
        ...

    def add_scan(self, name: str, sensor: str, scan: Scan, now: float = 0.0) -> None:
        """Take a scan."""
        ...

    def robot_here(self, name: str, run: str, now: float = 0.0) -> None:
        """Note that the liveliness token of a robot's run is there."""
        ...

    def robot_gone(self, name: str, run: str, now: float = 0.0) -> None:
        """Note that it is there no more."""
        ...

    def expire(self, now: float) -> None:
        """Give up what has waited for too long, and robots that are gone for long."""
        ...


def skipping(decided: Decided, outcome: Skip) -> Callable[[Source, bytes], None]:
    """What notes of a message, by its source and payload, that it is dropped, and will never be taken."""

    def skip(source: Source, payload: bytes) -> None:
        head = read_head(payload)
        if head is not None and head[2]:
            decided.skip(*source, head[2], head[1], head[1], outcome)
        elif source.sensor is not None:
            decided.drop_unnumbered(source.robot, source.sensor, outcome)

    return skip


class Intake(Protocol):
    """Where messages go, and what is told of those that do not come. Any thread."""

    def hand_on(self, source: Source, payload: bytes, *, resumed: bool = False) -> None:
        """Count a message, and put it into the queue; `resumed`: it was missed before, or held back."""
        ...

    def admits(self, robot: str) -> bool:
        """Whether messages of that robot are taken: there may be too many."""
        ...

    def has_room(self, robot: str, part: float) -> bool:
        """Whether nothing waits of a robot, or what is resumed takes less than this part of the queue."""
        ...

    def lost(self, source: Source, count: int, run: str, seqs: range, why: WhyLost) -> None:
        """Count so many of these seqs that cannot be had any more."""
        ...

    def replayed(self, source: Source) -> None:
        """Count a message that came again."""
        ...
