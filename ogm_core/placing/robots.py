"""All robots that are known: who is let in, what all of them may hold, and their state."""

from collections import Counter
from collections.abc import Callable, ItemsView, Mapping, ValuesView

from ogm_core.placing import reasons
from ogm_core.placing.counts import SensorCounts
from ogm_core.placing.held import Held
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.robot import Robot
from ogm_core.placing.robot_poses import RobotPoses
from ogm_core.placing.rules import PlacingRules
from ogm_core.placing.state import PlacingState
from ogm_core.placing.waiting import WaitingScans

Complain = Callable[[str, str, str], None]
"""Told of a source, `<robot>/<sensor>` or `<robot>/pose`, of the kind of trouble, and what was wrong."""


class Robots:
    """What is known of robots that have counts, by name. One thread changes it; any thread may `get`."""

    def __init__(self, receipts: Receipts, complain: Complain, rules: PlacingRules, limit: float) -> None:
        """`limit`: bytes that poses, seqs and runs of all of them may hold."""
        self._receipts = receipts
        self._complain = complain
        self._rules = rules
        self._robots: dict[str, Robot] = {}
        self._told = 0
        """States of a robot that were told."""
        self.waiting = Held()
        """What their scans hold that wait for poses."""
        self.held = Held()
        """What their poses, seqs and runs hold."""
        self._limit = self._may_hold = limit
        self._gone: Counter[str] = Counter()
        """Outcomes of scans of robots that were forgotten."""

    def get(self, name: str) -> Robot | None:
        """What is known of a robot."""
        return self._robots.get(name)

    def items(self) -> ItemsView[str, Robot]:
        """All of them, by name."""
        return self._robots.items()

    def values(self) -> ValuesView[Robot]:
        """All of them."""
        return self._robots.values()

    def touched(self, name: str, now: float | None, messages: int) -> Robot | None:
        """What is known of a robot that changes now; None if it is one too many.

        `messages`: how many have come, of all robots.
        """
        robot = self._robots.get(name)
        if robot is None:
            if not self._receipts.admits(name, now):
                return None
            robot = self._robots[name] = self._new(name, messages)
        robot.told = None
        return robot

    def count(self, name: str, sensor: str, outcome: str, count: int = 1) -> None:
        """Put down what became of scans of a source, where their seqs are, so that both are stored at once.

        Not of a robot or a sensor too many.
        """
        robot = self._robots.get(name)
        source = None if robot is None else robot.sources.get(sensor)
        if robot is not None and source is not None:
            robot.told = None
            source.outcomes[outcome] += count

    @property
    def outcomes_of_gone(self) -> Mapping[str, int]:
        """Outcomes of scans of robots that were forgotten; the value does not change any more."""
        return dict(self._gone)

    def forget(self, name: str) -> None:
        """Know nothing of a robot any more, but for what became of its scans, in all."""
        robot = self._robots.pop(name)
        robot.held.clear()
        for source in robot.sources.values():
            self._gone += source.outcomes
        self._may_hold = self._limit

    def keep_within_limit(self) -> None:
        """Have the robot that holds the most let go of what it can do without, till all are within the limit.

        What it keeps in any case is little: where it can let go of nothing, no other one holds much.
        """
        while self.held.nbytes > self._may_hold:
            name, robot = max(self._robots.items(), key=lambda entry: entry[1].held.nbytes)
            robot.told = None
            what = robot.lighten()
            if not what:  # nobody looks again before they hold more
                self._may_hold = self.held.nbytes
                return
            self._complain(name, *reasons.holds_the_most(self._limit, what))

    def state(self, messages: int) -> PlacingState:
        """What is known of them, but for scans that wait; of those that have not changed it is the same."""
        states = {}
        for name, robot in self._robots.items():
            if robot.told is None:
                self._told += 1
                robot.told = robot.state(self._told, messages)
            states[name] = robot.told
        return states

    def restore(self, state: PlacingState, of_gone: Mapping[str, int], now: float) -> int:
        """Know what a state says, but for robots that are too many; how many messages had come.

        What became of scans is counted on: of those robots, and in all of `of_gone`, those that had gone.
        """
        self._gone.update(of_gone)
        self._receipts.restored_of_gone(SensorCounts.of(of_gone, None))
        for name, told in state.items():
            robot = self._new(name, told.life)
            robot.restore(told)
            sensors = {
                sensor: SensorCounts.of(source.outcomes, source.last)
                for sensor, source in robot.sources.items()
                if source.last is not None or source.outcomes
            }
            self._robots[name] = robot
            if not self._receipts.restored(name, now, sensors):
                self.forget(name)
        return max((told.head["messages"] for told in state.values()), default=0)

    def _new(self, name: str, life: int) -> Robot:
        held = Held(self.held)
        return Robot(name, life, held, RobotPoses(self._rules, held), WaitingScans(self.waiting))
