"""Rate-limited log of warnings about messages: a robot that sends nonsense must not fill the disk."""

import logging
import time

PERIOD = 1.0
"""Each source is complained about at most this often, s."""
MAX_SOURCES = 1000
"""Sources remembered; whoever sends under more names than that is a new source again."""


class LimitedLog:
    """Logs the first complaint of a source, or kind, in every period, and how many more there were."""

    def __init__(self, log: logging.Logger, period: float = PERIOD) -> None:
        self._log = log
        self._period = period
        self._last: dict[str, float] = {}
        self._passed_over: dict[str, int] = {}

    def warning(self, source: str, text: str) -> None:
        """Log `text` about `source`, unless it was complained about just now."""
        line = self._due(source, f"{source}: {text}")
        if line is not None:
            self._log.warning("%s", line)

    def of_kind(self, source: str, kind: str, text: str) -> None:
        """Log `text` about `source`, unless there was a complaint of that kind about it just now."""
        line = self._due(f"{source}: {kind}", f"{source}: {text}")
        if line is not None:
            self._log.warning("%s", line)

    def failure(self, what: str) -> None:
        """Log that `what` failed, with the traceback of the error in hand, unless it failed just now."""
        line = self._due(what, f"{what} failed")
        if line is not None:
            self._log.exception("%s", line)

    def _due(self, source: str, text: str) -> str | None:
        """The line to log about a source; None if there was one just now."""
        now = time.monotonic()
        if now - self._last.get(source, -self._period) < self._period:
            self._passed_over[source] = self._passed_over.get(source, 0) + 1
            return None
        if len(self._last) >= MAX_SOURCES:
            self._last.clear()
            self._passed_over.clear()
        more = self._passed_over.pop(source, 0)
        self._last[source] = now
        return f"{text} ({more} more were not logged)" if more else text
