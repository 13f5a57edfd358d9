"""Decided messages: by robot, sensor and run, which were integrated, believed, or dropped for good."""

import math
import threading
from collections import deque
from collections.abc import Iterator

from ogm_core.placing.robot import Skip, Skipped
from ogm_core.placing.robots import Robots
from ogm_core.placing.rules import MAX_ROBOTS


class Decided:
    """What was decided of a placer's messages, those before the state that it goes on from, too. Any thread.

    A message is decided once the placer has it, but for a scan that waits for a pose; and once it is told
    that it will never have it. Run "" numbers nothing: nothing of it is decided.
    """

    def __init__(self, robots: Robots) -> None:
        self._robots = robots
        self.skipped: deque[Skipped] = deque()
        """What the placer has not taken yet."""
        self._waiting_until: dict[str, float] = {}
        """By robot, the one told last at the end."""
        self._lock = threading.Lock()

    def is_decided(self, robot: str, sensor: str | None, run: str, seq: int) -> bool:
        """Whether a scan of that seq, or with None a pose, was integrated or dropped for good."""
        known = self._robots.get(robot)
        runs = None if known is None else known.runs_of(sensor)
        if known is None or runs is None or not runs.has(run, seq):
            return False
        return seq not in known.undecided(sensor, run)

    def last(self, robot: str, sensor: str | None, run: str) -> int | None:
        """The highest seq up to which all are decided, from the first one known; None if none is."""
        known = self._robots.get(robot)
        runs = None if known is None else known.runs_of(sensor)
        if known is None or runs is None:
            return None
        return runs.up_to(run, known.undecided(sensor, run))

    def skip(
        self,
        robot: str,
        sensor: str | None,
        run: str,
        first: int,
        last: int | None = None,
        outcome: Skip = "lost",
        count: int | None = None,
    ) -> None:
        """Note that the placer will never have messages, from a seq to another one: they are lost or dropped.

        `count` of them, None: all, were not decided before. They are decided, and part of what a state has
        counted, when the placer handles its next message, or looks who waits for too long.
        """
        until = first if last is None else last
        counted = until + 1 - first if count is None else count
        self.skipped.append(Skipped(robot, sensor, run, first, until, outcome, counted))

    def drop_unnumbered(self, robot: str, sensor: str, outcome: Skip) -> None:
        """Note a scan without a number that is dropped: nothing is decided, it is counted alone."""
        self.skipped.append(Skipped(robot, sensor, "", 0, -1, outcome, 1))

    def wait_on(self, robot: str, until: float) -> None:
        """Let a robot's scans wait for poses as if one had come then, s: they may come later than usual."""
        with self._lock:
            self._waiting_until.pop(robot, None)
            self._waiting_until[robot] = until
            if len(self._waiting_until) > MAX_ROBOTS:
                del self._waiting_until[next(iter(self._waiting_until))]

    def waits_until(self, robot: str) -> float:
        """Until when a robot's scans wait for their poses in any case, s."""
        return self._waiting_until.get(robot, -math.inf)

    def taken(self) -> Iterator[Skipped]:
        """Take what was skipped and not taken yet; the placer's thread."""
        while self.skipped:
            yield self.skipped.popleft()
