"""Status of a mapper, made once for all who ask at the same time; a dear one is kept for a while."""

import threading
import time
from collections.abc import Callable
from typing import NamedTuple

from ogm_core.status import Status, encode_status

CHEAP = 0.01
"""A status that takes less than this to make, s of a thread's time, is made for everyone who asks later."""
KEPT_TIMES = 10
"""Another is kept for so many times as long as it took: a tenth of a core at most goes into it,"""
MAX_KEPT = 1.0
"""or for so long, s."""
OBJECTS = 3
"""A status takes about so many times its JSON."""


class Told(NamedTuple):
    """A status, and its JSON."""

    status: Status
    body: bytes


class KeptStatus:
    """The newest status that was made. Any thread; one of those who ask makes it, the others wait for it.

    How many robots and sensors it names is up to strangers, and so is how often it is asked for. Nobody gets
    one that is older than his question, unless it was dear: then it may be as old as it is kept. One of an
    epoch that has ended is never kept.
    """

    def __init__(
        self,
        make: Callable[[], Status],
        epoch: Callable[[], str],
        clock: Callable[[], float] = time.monotonic,
        worked: Callable[[], float] = time.thread_time,
    ) -> None:
        """`worked`: how long the calling thread has computed so far, s."""
        self._make = make
        self._epoch = epoch
        self._clock = clock
        self._worked = worked
        self._lock = threading.Lock()
        self._told: Told | None = None
        self._begun = self._until = 0.0

    @property
    def nbytes(self) -> int:
        """What is kept takes, about."""
        told = self._told
        return 0 if told is None else (1 + OBJECTS) * len(told.body)

    def get(self) -> Told:
        """The status, new or kept."""
        asked = self._clock()
        with self._lock:
            if self._told is None or not (asked <= self._begun or self._lasts(self._told)):
                self._begun, worked = self._clock(), self._worked()
                status = self._make()
                self._told = Told(status, encode_status(status))
                worked = self._worked() - worked
                kept = min(KEPT_TIMES * worked, MAX_KEPT) if worked >= CHEAP else 0.0
                self._until = self._clock() + kept
            return self._told

    def _lasts(self, told: Told) -> bool:
        return self._clock() < self._until and told.status.epoch == self._epoch()
