"""Answers in flight: what is being made and sent, counted until it is gone, and bounded together."""

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ogm_core.units import MEBIBYTE
from ogm_services.replies.answer import Busy

MAX_IN_FLIGHT = 256 * MEBIBYTE
"""Bytes of all answers that are being made and sent; one alone may be larger."""
SMALL = 64 * 1024
"""Bodies up to this are not counted: as many of them as there are connections are little."""
BUFFERED = MEBIBYTE
"""What the way to one reader holds besides the body, at most, bytes; of a smaller body no more than that."""


class InFlight:
    """The answers that are being made, and those that are being sent to slow and quick readers. Any thread.

    One body that is sent to many is one object, and counts once.
    """

    def __init__(
        self,
        limit: int = MAX_IN_FLIGHT,
        left: Callable[[], float] = lambda: math.inf,
        make_room: Callable[[], None] = lambda: None,
    ) -> None:
        """`left` says how many bytes there may be besides; `make_room` is called when more are held."""
        self.limit = limit
        self._left = left
        self._make_room = make_room
        self._lock = threading.Lock()
        self._readers: dict[int, int] = {}
        """How many are sent a body, by the object that it is."""
        self._held = 0

    @property
    def held(self) -> int:
        """Bytes that are held to make answers, and for readers."""
        return self._held

    @contextmanager
    def sending(self, body: bytes) -> Iterator[None]:
        """Hold a body while it is sent inside.

        Raises:
            Busy: too much is being sent already, or there is no memory for it.
        """
        if len(body) <= SMALL:
            yield
            return
        with self._lock:
            self._begin(body)
        try:
            yield
        finally:
            with self._lock:
                self._end(body)

    @contextmanager
    def making(self, size: int) -> Iterator[None]:
        """Hold so many bytes while an answer is made inside; its body is counted when it is sent.

        Raises:
            Busy: too much is being made and sent already, or there is no memory for it.
        """
        if size <= SMALL:
            yield
            return
        with self._lock:
            self._take(size, f"making this one takes {_mebibytes(size)}")
        try:
            yield
        finally:
            with self._lock:
                self._held -= size

    def _begin(self, body: bytes) -> None:
        readers = self._readers.get(id(body), 0)
        self._take(_on_the_way(body) + (0 if readers else len(body)), f"this one has {_mebibytes(len(body))}")
        self._readers[id(body)] = readers + 1

    def _take(self, size: int, this_one: str) -> None:
        # One alone may be larger than all that may be held together: nobody would ever get it.
        if not self._held and size > self._left():
            raise Busy(
                f"{this_one}, for which mapper.max_memory has no room: ask for a smaller region, or raise it"
            )
        if (self._held and self._held + size > self.limit) or size > self._left():
            raise Busy(
                f"answers of {_mebibytes(self._held)} are being made or sent, and {this_one}: "
                "try again later, or ask for a smaller region"
            )
        self._held += size
        self._make_room()

    def _end(self, body: bytes) -> None:
        readers = self._readers.pop(id(body)) - 1
        if readers:
            self._readers[id(body)] = readers
        self._held -= _on_the_way(body) + (0 if readers else len(body))


def _on_the_way(body: bytes) -> int:
    return min(len(body), BUFFERED)


def _mebibytes(size: int) -> str:
    return f"{size / MEBIBYTE:.0f} MiB"
