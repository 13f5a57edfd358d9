"""Warnings about messages, at a limited rate: a robot that sends nonsense must not fill the disk."""

import logging
import time

PERIOD = 1.0
"""Each source is complained about at most this often, s."""
MAX_SOURCES = 1000
"""Sources remembered; whoever sends under more names than that is a new source again."""


class LimitedLog:
    """Logs the first complaint of a source in every period, and how many like it were passed over."""

    def __init__(self, log: logging.Logger, period: float = PERIOD) -> None:
        self._log = log
        self._period = period
        self._last: dict[str, float] = {}
        self._passed_over: dict[str, int] = {}

    def warning(self, source: str, text: str) -> None:
        """Log `text` about `source`, unless it was complained about just now."""
        now = time.monotonic()
        if now - self._last.get(source, -self._period) < self._period:
            self._passed_over[source] = self._passed_over.get(source, 0) + 1
            return
        if len(self._last) >= MAX_SOURCES:
            self._last.clear()
            self._passed_over.clear()
        more = self._passed_over.pop(source, 0)
        self._last[source] = now
        self._log.warning("%s: %s%s", source, text, f" ({more} more were not logged)" if more else "")
