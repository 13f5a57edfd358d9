"""Rate-limited log of warnings about messages: a robot that sends nonsense must not fill the disk."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

FIRST_WAIT = 1.0
"""Between the first two lines about a source, or of a kind about it, s; then twice as long each time."""
LONGEST_WAIT = 60.0
"""Between two lines about what lasts, s; after so long without a complaint all begins anew."""
MAX_SOURCES = 1000
"""Sources remembered: the one without a complaint for longest is a new source again."""


@dataclass(slots=True)
class _Told:
    line: float
    """When a line was logged, s."""
    last: float
    """When it was complained about last, s."""
    wait: float
    """How long after the line no other one is logged, s."""
    left_out: int = 0
    """Complaints since the line."""


class LimitedLog:
    """Logs complaints about a source, or of a kind about it, ever more rarely while they go on.

    Each line says how many were left out before it. Any thread.
    """

    def __init__(self, log: logging.Logger, clock: Callable[[], float] = time.monotonic) -> None:
        self._log = log
        self._clock = clock
        self._lock = threading.Lock()
        self._told: dict[str, _Told] = {}
        """By source and kind, the one that was complained about last at the end."""

    def warning(self, source: str, text: str) -> None:
        """Log `text` about `source`, unless it was complained about not long ago."""
        line = self._due(source, f"{source}: {text}")
        if line is not None:
            self._log.warning("%s", line)

    def of_kind(self, source: str, kind: str, text: str) -> None:
        """Log `text` about `source`, unless there was a complaint of that kind about it not long ago."""
        line = self._due(f"{source}: {kind}", f"{source}: {text}")
        if line is not None:
            self._log.warning("%s", line)

    def failure(self, what: str) -> None:
        """Log that `what` failed, with the traceback of the error in hand, unless it failed not long ago."""
        line = self._due(what, f"{what} failed")
        if line is not None:
            self._log.exception("%s", line)

    def _due(self, source: str, text: str) -> str | None:
        """The line to log about a source; None if it is too soon for one."""
        with self._lock:
            now = self._clock()
            told = self._told.pop(source, None)
            if told is None or now - told.last >= LONGEST_WAIT:
                wait = FIRST_WAIT
            elif now - told.line >= told.wait:
                wait = min(2 * told.wait, LONGEST_WAIT)
            else:
                told.last = now
                told.left_out += 1
                self._told[source] = told
                return None
            if len(self._told) >= MAX_SOURCES:
                del self._told[next(iter(self._told))]
            self._told[source] = _Told(now, now, wait)
        left_out = 0 if told is None else told.left_out
        return f"{text} ({left_out} more were not logged)" if left_out else text
