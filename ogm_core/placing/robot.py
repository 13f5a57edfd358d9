"""All that is known of one robot, and what of it can be let go where robots hold too much memory."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from ogm_core.placing.held import Held
from ogm_core.placing.robot_poses import RobotPoses
from ogm_core.placing.rules import MAX_SENSORS
from ogm_core.placing.runs import Runs
from ogm_core.placing.source import Source
from ogm_core.placing.state import RobotState
from ogm_core.placing.waiting import WaitingScans
from ogm_core.types import Scan

MAX_GONE = 64
"""So many runs that are gone are remembered of a robot."""


Skip = Literal["lost", "overload", "malformed"]
"""What keeps a message from being taken."""


class Skipped(NamedTuple):
    """Messages that will never be taken: of poses (sensor None) or scans, from a seq to another one.

    Of those without numbers `run` is "", and there are no seqs.
    """

    robot: str
    sensor: str | None
    run: str
    first: int
    last: int
    outcome: Skip
    scans: int
    """How many of them were not decided before."""


class Expected(NamedTuple):
    """A scan that waited when the state was taken from which a placer goes on."""

    sensor: str
    run: str
    seq: int
    stamp: int
    number: int
    """Of the message, as of one that waits."""


@dataclass(slots=True)
class Robot:
    """All that decides where the scans of one robot go."""

    name: str
    life: int
    """Tells it from another of the same name, which was forgotten."""
    held: Held
    """What its poses, and the seqs and runs of its scans, take in memory."""
    poses: RobotPoses
    waiting: WaitingScans
    """Until a pose at or after their last beam arrives."""
    sources: dict[str, Source] = field(default_factory=dict)
    pose_heard: float = 0.0
    gone: dict[str, None] = field(default_factory=dict)
    """Runs whose liveliness token was there and is no more, the last one at the end."""

    seqs: Runs = field(init=False)
    """Of its poses: all that were taken, whatever was believed, and those that never will be."""
    expected: dict[tuple[str, str, int, int], Expected] = field(default_factory=dict)
    """Scans that waited, by sensor, run, seq and stamp, and have not come again."""
    told: RobotState | None = None
    """The state that was told last, until it changes."""

    def __post_init__(self) -> None:
        self.seqs = Runs(self.held)

    def source(self, sensor: str) -> Source | None:
        """What is known of a sensor; None if it is one too many."""
        source = self.sources.get(sensor)
        if source is None and len(self.sources) < MAX_SENSORS:
            source = self.sources[sensor] = Source(f"{self.name}/{sensor}", self.held)
        return source

    def skip(self, skipped: Skipped) -> None:
        """Take messages for decided that will never come: poses, or scans of a sensor."""
        _, sensor, run, first, last, outcome, count = skipped
        source = None if sensor is None else self.source(sensor)
        if sensor is None:
            self.seqs.skip(run, first, last)
        elif source is not None:
            source.runs.skip(run, first, last)
            source.outcomes[outcome] += count
        seqs = range(first, last + 1)
        self.forget_expected(lambda item: (item.sensor, item.run) == (sensor, run) and item.seq in seqs)

    def runs_of(self, sensor: str | None) -> Runs | None:
        """The seqs of a sensor's scans, or of the poses; None if there is no such sensor."""
        if sensor is None:
            return self.seqs
        source = self.sources.get(sensor)
        return None if source is None else source.runs

    def undecided(self, sensor: str | None, run: str) -> list[int]:
        """Seqs of the scans that wait, or did when the state was taken that it goes on from. Any thread."""
        waiting = [
            item.scan.seq for item in self.waiting.copy() if (item.sensor, item.scan.run) == (sensor, run)
        ]
        expected = self.expected.copy().values()
        return waiting + [item.seq for item in expected if (item.sensor, item.run) == (sensor, run)]

    def take_expected(self, sensor: str, scan: Scan) -> Expected | None:
        """Expect a scan no longer, for here it is; None if it is no such one."""
        return self.expected.pop((sensor, scan.run, scan.seq, scan.stamp), None)

    def forget_expected(self, which: Callable[[Expected], bool]) -> None:
        """Expect some scans no longer: should they come all the same, they are duplicates."""
        if self.expected:
            self.expected = {key: item for key, item in self.expected.items() if not which(item)}

    def state(self, serial: int, messages: int) -> RobotState:
        """All that decides where its scans go; `serial` and `messages` as RobotState has them."""
        waiting = [
            Expected(item.sensor, item.scan.run, item.scan.seq, item.scan.stamp, item.number)
            for item in self.waiting
        ]
        head = {
            "messages": messages,
            "poses": self.poses.state(),
            "seqs": self.seqs.state(),
            "gone": tuple(self.gone),
            "sources": {name: source.state() for name, source in self.sources.items()},
            "waiting": sorted([*self.expected.values(), *waiting], key=lambda item: item.number),
        }
        return RobotState(serial, self.life, self.poses.histories, head, self.poses.history.state)

    def restore(self, state: RobotState) -> None:
        """Go on from such a state, in a robot of which nothing is known yet."""
        head = state.head
        self.poses.restore(head["poses"], state.history)
        self.seqs.restore(head["seqs"])
        self.gone = dict.fromkeys(head["gone"])
        for sensor, told in head["sources"].items():
            source = self.source(sensor)
            if source is not None:
                source.restore(told)
        expected = (Expected(*item) for item in head["waiting"])
        self.expected = {item[:4]: item for item in expected}
        self.told = state

    def note_gone(self, run: str) -> None:
        """Remember a run that is gone."""
        self.gone[run] = None
        if len(self.gone) > MAX_GONE:
            del self.gone[next(iter(self.gone))]

    def lighten(self) -> str:
        """Let go of what it can do without, long histories first; what that was, "" if there is nothing."""
        history = self.poses.history
        before, count = self.held.nbytes, len(history)
        if history.shorten():
            return f"of its {count} poses the newest {len(history)} are kept"
        for runs in (self.seqs, *(source.runs for source in self.sources.values())):
            runs.forget_most()
        if self.held.nbytes < before:
            return (
                "of each of its sensors the last run is kept, and all seqs before its last one count as seen"
            )
        return ""
