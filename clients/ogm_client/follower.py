"""Map follower: a copy of a mapper's map that a thread keeps up to date."""

import atexit
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import Final, Self

from ogm_client.errors import BadReply, CannotConnect, ClientError, MapperError, NobodyAnswered
from ogm_client.map_change import Change, change_since
from ogm_client.map_copy import MapCopy, Taken
from ogm_client.map_grid import MapGrid
from ogm_client.transport import Transport, Version
from ogm_core.errors import BadMessage, OgmError
from ogm_core.wire.map_update import MapUpdate, decode_updates

SILENCE: Final = 3.0
"""A mapper that tells what changes is asked when it has said nothing for so long, s."""
_MAX_HEARD: Final = 16
"""So many messages wait for the thread at most; who is farther behind asks."""
_CLOSING: Final = 1.0
"""How long `close` waits for the thread, s: it may be waiting for an answer."""
_UNAVAILABLE: Final = 503
_NO_VERSION: Final = 400
"""What a mapper answers who names a version that none can have: somebody else has told it."""


class MapFollower:
    """A map that follows its mapper's, cell for cell, as a context manager.

        with mapper.follow() as follower:
            change = follower.wait()
            while change is not None:
                print(change.region, follower.grid().revision)
                change = follower.wait(after=change.version)

    A thread of its own takes what the mapper tells, and asks for what it has missed; it goes on with a mapper
    that is started anew. Any thread may call the methods.
    """

    def __init__(self, transport: Transport, max_bytes: int, interval: float) -> None:
        """Take the map, which takes `max_bytes` at most; where nothing is told, ask every `interval` s.

        Raises:
            ClientError: as every request.
        """
        self._transport = transport
        self._interval = interval
        self._copy = MapCopy(max_bytes)
        self._listeners: list[Callable[[], None]] = []
        self._news = threading.Condition()
        self._heard: deque[bytes] = deque(maxlen=_MAX_HEARD)
        self._arrived = threading.Event()
        """Whether there is something to do for the thread; Zenoh's own waits for nobody to set it."""
        self._asked = 0.0
        """When it was last asked, by `time.monotonic()`."""
        self._told = False
        """Whether the mapper tells what changes: it has since it was last asked for being silent."""
        self._trouble: OgmError | None = None
        self._away_since = 0.0
        self._ended: OgmError | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="ogm-follower", daemon=True)
        # First: what changes between the answer and the subscription would be missed.
        self._stop_hearing = transport.hear_updates(self._hear)
        try:
            self._ask()
        except BaseException:
            self._stop_hearing()
            raise
        # Zenoh's thread would call into a Python that has ended.
        atexit.register(self.close)
        self._thread.start()

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

    def close(self) -> None:
        """Follow no longer; closing twice does nothing. The end of the program closes it, too."""
        with self._news:
            self._closed = True
            self._notify()
        self._arrived.set()
        self._hear_no_more()
        if threading.current_thread() is not self._thread:
            self._thread.join(_CLOSING)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _hear(self, payload: bytes) -> None:
        self._heard.append(payload)  # the oldest one goes, if there is no room: a gap
        self._arrived.set()

    def _hear_no_more(self) -> None:
        with self._news:  # once: Zenoh undeclares nothing twice at a time
            stop_hearing, self._stop_hearing = self._stop_hearing, _nothing
        stop_hearing()
        atexit.unregister(self.close)

    def _run(self) -> None:
        try:
            self._follow()
        finally:
            if not self._closed and self._ended is None:  # a bug: nobody is to wait for ever
                self._end(ClientError("follow: the thread that follows the map has failed"))
            self._hear_no_more()

    def _follow(self) -> None:
        while True:
            payload = self._next_heard()
            if self._closed:
                return
            try:
                if payload is None:
                    self._told = False
                    self._ask()
                else:
                    self._told = True
                    self._take(payload)
            except (CannotConnect, NobodyAnswered, MapperError) as error:
                if isinstance(error, MapperError) and error.status != _UNAVAILABLE:
                    self._end(error)
                    return
                self._note_trouble(error)
            except OgmError as error:
                self._end(error)
                return
            else:
                self._note_trouble(None)

    def _next_heard(self) -> bytes | None:
        """The next message; None when it is time to ask."""
        patience = SILENCE if self._told and self._trouble is None else self._interval
        if not self._heard and not self._closed:
            self._arrived.wait(patience)
        self._arrived.clear()
        return self._heard.popleft() if self._heard else None

    def _take(self, payload: bytes) -> None:
        """Apply what was told, or ask for what has been missed.

        Whoever may put messages may tell lies: the mapper, which is asked, has the last word.
        """
        try:
            follows = self._follows(next(decode_updates(payload)))
        except (BadMessage, BadReply, StopIteration):
            follows = False
        if not follows:
            self._ask()

    def _follows(self, update: MapUpdate) -> bool:
        """Apply what was told; whether nothing is missing now."""
        with self._news:
            taken = self._copy.take(update)
            self._notify()
            same = self._copy.version == (update.epoch, update.run, update.revision)
        if taken is Taken.KNOWN and not same:  # it comes late, or what is here is no map of the mapper's
            return time.monotonic() - self._asked < SILENCE
        return taken in (Taken.APPLIED, Taken.KNOWN)

    def _ask(self) -> None:
        """Bring the copy up to date by what has changed since it was."""
        mine = self._copy.version
        since = {} if mine is None else {"since": "-".join(map(str, mine))}
        self._asked = time.monotonic()
        try:
            payload = self._transport.fetch("map.tiles", since)
        except MapperError as error:
            if not since or error.status != _NO_VERSION:
                raise
            payload = self._transport.fetch("map.tiles", {})
        taken = None
        try:
            for update in decode_updates(payload):
                with self._news:
                    taken = self._copy.take(update, asked=True)
                    self._notify()
                if taken is Taken.GAP:
                    break
        except BadMessage as error:
            raise BadReply(f"map.tiles: {error}") from error
        if taken not in (Taken.APPLIED, Taken.KNOWN):
            raise BadReply("map.tiles: what was answered is not what was asked for")

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


def _nothing() -> None:
    """Stop what has been stopped."""
