"""Cache of answers: encoded maps that are kept for the next who asks, and whose turn it is to encode."""

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Protocol

from ogm_core.units import MEBIBYTE
from ogm_services.mapper.live.identity import Identity
from ogm_services.replies.answer import Answer

CACHE_BYTES = 64 * MEBIBYTE
"""Encoded maps of the current revision that are kept, unless there is less memory."""
BYTES_BESIDES = 4096
"""What an answer that is kept takes besides its body and what was asked, at most."""


class Cache(Protocol):
    """What keeps encoded maps, and can make them anew. Any thread."""

    @property
    def nbytes(self) -> int:
        """Bytes that are kept."""

    def let_go(self) -> None:
        """Keep nothing of what is kept."""


class AnswerCache:
    """Encoded answers of the newest revision that was encoded, and whose turn it is to encode.

    An answer will do for whoever asked when the map was not newer. So readers who come while one is encoded
    wait, and then one of them encodes for all: never two the same, and nobody gets a map older than his
    question, however fast it changes.
    """

    def __init__(self, now: Callable[[], Identity], room: int = CACHE_BYTES) -> None:
        """`now` tells the map's identity; `room`: bytes that may be kept."""
        self._now = now
        self._room = room
        self._lock = threading.Lock()
        self._of = Identity("", "", -1, None)
        self._answers: dict[object, Answer] = {}
        self._size = 0
        self._turns: dict[object, _Turn] = {}

    @property
    def nbytes(self) -> int:
        """Bytes that are kept."""
        return self._size

    def let_go(self) -> None:
        """Keep nothing of what is kept."""
        with self._lock:
            self._answers, self._size = {}, 0

    def find(self, key: object, asked: Identity) -> Answer | None:
        """What is kept under this key, if it is new enough for who asked when the map was `asked`."""
        with self._lock:
            new_enough = self._of.life == asked.life and self._of.revision >= asked.revision
            return self._answers.get(key) if new_enough else None

    def keep(self, key: object, of: Identity, answer: Answer) -> None:
        """Keep an answer of a map, in place of those of an older one, if there is room."""
        size = len(answer.body) + len(repr(key)) + BYTES_BESIDES
        with self._lock:
            # Asked under the lock: what is kept of a new epoch was kept after the reset that began it.
            if of.life != self._now().life:
                return
            if self._of.life == of.life and self._of.revision > of.revision:
                return
            if self._of != of or self._size + size > self._room:
                self._of, self._answers, self._size = of, {}, 0
            if size <= self._room:
                self._answers[key] = answer
                self._size += size

    def answer(
        self,
        key: object,
        asked: Identity,
        held: Callable[[], AbstractContextManager[None]],
        make: Callable[[], Answer],
    ) -> Answer:
        """What is kept under this key, or what `make` makes and keeps, inside of what `held` holds for it."""
        answer = self.find(key, asked)
        if answer is None:
            with held(), self.turn(key):
                # Whoever had the turn before may have made one that is new enough for this one too.
                answer = self.find(key, asked) or make()
        return answer

    @contextmanager
    def turn(self, key: object) -> Iterator[None]:
        """Wait until nobody else encodes what has this key."""
        with self._lock:
            turn = self._turns.setdefault(key, _Turn(threading.Lock()))
            turn.wanted += 1
        try:
            with turn.lock:
                yield
        finally:
            with self._lock:
                turn.wanted -= 1
                if not turn.wanted:
                    del self._turns[key]


@dataclass(slots=True)
class _Turn:
    lock: threading.Lock
    wanted: int = 0
