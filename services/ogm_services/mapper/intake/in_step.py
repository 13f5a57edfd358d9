"""Robots in step: those that are resumed together are handed on by their stamps, as they came at first.

Where robots are skipped that others see, what becomes of one robot's scan depends on the others' poses.
"""

import threading
import time
from collections.abc import Iterable
from typing import NamedTuple

AHEAD_NS = 200_000_000
"""So far by its stamps a robot may be ahead of those that it is resumed with."""
PATIENCE = 3.0
"""A robot that gets no farther for so long, s, is not waited for: its caches do not answer, say."""
EXPECTED = 5.0
"""Robots of before a start are waited for so long, s: their links come back one after the other."""
_PAUSE = 0.005


class _Stage(NamedTuple):
    stamp: int | None
    """Of its next message; None as long as that is not known."""
    until: float
    """How long others wait for it to get farther, s."""


class InStep:
    """Lets none of the robots that are being resumed get ahead of the others. Any thread."""

    def __init__(self, expected: Iterable[str] = ()) -> None:
        """`expected` robots are waited for once it is `started`."""
        self._expected = list(expected)
        self._stages: dict[str, _Stage] = {}
        self._lock = threading.Lock()

    def started(self) -> None:
        """Wait for the expected robots from now on."""
        until = time.monotonic() + EXPECTED
        with self._lock:
            self._stages = {name: _Stage(None, until) for name in self._expected} | self._stages

    def begin(self, robot: str) -> None:
        """Wait for a robot: it is about to be resumed."""
        with self._lock:
            self._stages[robot] = _Stage(None, time.monotonic() + PATIENCE)

    def end(self, robot: str) -> None:
        """Wait for a robot no longer."""
        with self._lock:
            self._stages.pop(robot, None)

    def wait(self, robot: str, stamp: int, stopping: threading.Event) -> None:
        """Return once a robot's next message, of that stamp, has its turn; or once all is `stopping`."""
        with self._lock:
            self._stages[robot] = _Stage(stamp, time.monotonic() + PATIENCE)
        while self._somebody_lags(robot, stamp) and not stopping.wait(_PAUSE):
            continue

    def _somebody_lags(self, robot: str, stamp: int) -> bool:
        now, enough = time.monotonic(), stamp - AHEAD_NS
        with self._lock:
            return any(
                now < stage.until and (stage.stamp is None or stage.stamp < enough)
                for other, stage in self._stages.items()
                if other != robot
            )
