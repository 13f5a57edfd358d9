"""Gathering up of messages: where many come, each by itself, they are taken in a few at a time."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, TypeVar

from ogm_services.runtime.limited_log import LimitedLog

OFTEN = 32
OFTEN_SECONDS = 0.064
"""So many messages within so long, s: a thread that handles each as it comes finds caches cold each time."""
PAUSE = 0.004
"""For so long they gather then, s."""
MOST = 128
"""So many may wait; who brings one more takes in all that wait."""

log = logging.getLogger(__name__)
_M = TypeVar("_M")


class GatheringUp:
    """Has messages taken in, in the order in which they come: at once, or a few at a time where many come.

    Threads: those that bring messages, Zenoh's, and one of its own, which sleeps while few come. Who holds
    `_taking` takes in all that wait; who brings one meanwhile leaves it to that one. Where many come it is
    left to the thread of its own, which looks every PAUSE. Past MOST that wait, or with one that `weighs`
    much, who brings it waits for its turn: that slows down who sends too many.
    """

    def __init__(self) -> None:
        self._waiting: deque[tuple[Callable[[Any, float], None], Any, float]] = deque()
        self._taking = threading.Lock()
        self._arrivals: deque[float] = deque(maxlen=OFTEN)
        """Of the messages that were taken in last, s; whose `_taking` is held."""
        self._gathers = False
        """Whether the thread of its own looks every PAUSE."""
        self._many = threading.Event()
        self._stopping = False
        self._failures = LimitedLog(log)
        self._thread = threading.Thread(target=self._run, name="ogm-intake")

    def start(self) -> None:
        """Begin to gather where it is worth while."""
        self._thread.start()

    def stop(self) -> None:
        """Take in what waits, and end; nothing is brought any more."""
        self._gathers, self._stopping = False, True
        self._many.set()
        if self._thread.is_alive():
            self._thread.join()
        self._take(in_turn=True)

    def bring(self, take_in: Callable[[_M, float], None], message: _M, *, weighs: bool = False) -> None:
        """Have a message taken in after those that were brought before; any thread.

        `take_in` is told it, and when it was brought, s of the monotonic clock.
        """
        self._waiting.append((take_in, message, time.monotonic()))
        if weighs or len(self._waiting) > MOST:
            self._take(in_turn=True)
        elif not self._gathers:  # looked at last: who ends the gathering takes what was brought before
            self._take()
            if not self._gathers and self._many_come(time.monotonic()):
                self._gathers = not self._stopping
                self._many.set()

    def _run(self) -> None:
        while not self._stopping:
            self._many.wait()
            self._many.clear()
            while self._gathers:
                time.sleep(PAUSE)
                self._take(in_turn=True)
                if not self._many_come(time.monotonic()):
                    self._gathers = False
                    self._take()

    def _many_come(self, now: float) -> bool:
        """Whether so many have come of late that more will within PAUSE."""
        return len(self._arrivals) == OFTEN and now - self._arrivals[0] < OFTEN_SECONDS

    def _take(self, *, in_turn: bool = False) -> None:
        """Take in all that wait, unless another thread is at it; `in_turn`: once it is not."""
        while self._waiting:
            if not self._taking.acquire(blocking=in_turn):
                return  # who has it looks once more after letting go of it
            try:
                while self._waiting:
                    take_in, message, came = self._waiting.popleft()
                    self._arrivals.append(came)
                    take_in(message, came)
            except Exception:  # noqa: BLE001 (logged with its traceback)
                self._failures.failure("taking in a message")
            finally:
                self._taking.release()
