"""Large answers: so few of them are made at a time that small ones always find a thread."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from ogm_services.replies.answer import Busy

LARGE = 10_000_000
"""Answers that look at more cells take seconds."""
LARGE_AT_ONCE = 4
"""So many of them are made or waited for at a time: half of the threads that a protocol has for maps."""


class LargeAnswers:
    """Those that are being made, of live and of saved maps together. Any thread."""

    def __init__(self) -> None:
        self._places = threading.Semaphore(LARGE_AT_ONCE)

    @contextmanager
    def making(self, cells: int) -> Iterator[None]:
        """Make, or wait for, an answer that looks at so many cells inside.

        Raises:
            Busy: it is large, and LARGE_AT_ONCE others are.
        """
        large = cells > LARGE
        if large and not self._places.acquire(blocking=False):
            raise Busy(
                f"{LARGE_AT_ONCE} answers of more than {LARGE} cells are being made: "
                "try again later, or ask for a smaller region"
            )
        try:
            yield
        finally:
            if large:
                self._places.release()
