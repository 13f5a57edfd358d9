"""Followed map: a copy of a mapper's map, and what who reads it waits for."""

import math
import threading
import time
from collections.abc import Callable

from ogm_client.errors import ClientError
from ogm_client.map_change import Change, change_since
from ogm_client.map_copy import MapCopy
from ogm_client.map_grid import MapGrid
from ogm_client.transport import Version
from ogm_core.errors import OgmError


class FollowedMap:
    """A copy that one thread writes, and that any thread reads and waits for; `_news` guards all of it."""

    def __init__(self, copy: MapCopy) -> None:
        self._copy = copy
        self._listeners: list[Callable[[], None]] = []
        self._news = threading.Condition()
        self._trouble: OgmError | None = None
        """Why the mapper is away; None while it is there."""
        self._away_since = 0.0
        self._ended: OgmError | None = None
        """Why nothing will come any more."""
        self._closed = False

    @property
    def connected(self) -> bool:
        """Whether the mapper was there when it was last asked, or has spoken since."""
        return self._trouble is None and self._ended is None and not self._closed

    @property
    def version(self) -> Version:
        """Which map the newest one is."""
        with self._news:
            version = self._copy.version
            assert version is not None  # since the first answer
            return version

    def grid(self) -> MapGrid:
        """The newest map, an array of its own; only what has changed since the last one is made anew.

        Raises:
            BadReply: the map's cells are none that this client can read, or take too much memory.
        """
        with self._news:
            return self._copy.grid()

    def wait(self, after: tuple[str, str, int] | None = None, timeout: float | None = None) -> Change | None:
        """Wait for a map that is not the one `after`, (epoch, run, revision); tell what has changed since.

        None: none has come within `timeout` s, or the follower was closed. While the mapper is away it
        waits on.

        Raises:
            OgmError: what has ended the follower: the mapper refuses, what answers is none, or the client
                was closed.
        """
        seen = None if after is None else Version(*after)
        deadline = math.inf if timeout is None else time.monotonic() + timeout
        with self._news:
            while self._copy.version == seen:
                if self._ended is not None:
                    raise self._ended
                left = deadline - time.monotonic()
                if self._closed or left <= 0.0:
                    return None
                self._news.wait(None if left == math.inf else left)
            return change_since(self._copy, seen)

    def next_grid(self, seen: Version | None, patience: float) -> MapGrid:
        """Wait for a map that is not the one `seen`; for a mapper that is away so many seconds.

        Raises:
            OgmError: it is still away, or as `wait`; ClientError, when the follower is closed.
        """
        with self._news:
            while (left := self.left_to_wait(seen, patience)) is not None:
                self._news.wait(None if left == math.inf else left)
            return self._copy.grid()

    def left_to_wait(self, seen: Version | None, patience: float) -> float | None:
        """How much longer to wait for a map that is not the one `seen`, s, inf: for news; None: it is there.

        Raises:
            OgmError: as `next_grid`.
        """
        with self._news:
            if self._copy.version != seen:
                return None
            if self._ended is not None:
                raise self._ended
            if self._closed:
                raise ClientError("follow: the follower is closed")
            if self._trouble is None:
                return math.inf
            left = self._away_since + patience - time.monotonic()
            if left <= 0.0:
                raise self._trouble
            return left

    def add_listener(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Have `listener` called, by whichever thread, when there is news; what ends that."""
        with self._news:
            self._listeners.append(listener)

        def end() -> None:
            with self._news:
                self._listeners.remove(listener)

        return end

    def _note_trouble(self, trouble: OgmError | None) -> None:
        with self._news:
            if self._trouble is None:
                self._away_since = time.monotonic()
            self._trouble = trouble
            self._notify()

    def _notify(self) -> None:
        """Wake up who waits; `_news` is held."""
        self._news.notify_all()
        for listener in self._listeners:
            listener()

    def _end(self, error: OgmError) -> None:
        with self._news:
            self._ended = error
            self._notify()
