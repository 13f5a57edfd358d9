"""Map follower: the thread that keeps a copy of a mapper's map up to date."""

import atexit
import threading
import time
from collections import deque
from types import TracebackType
from typing import Final, Self

from ogm_client.errors import BadReply, CannotConnect, ClientError, MapperError, NobodyAnswered
from ogm_client.followed_map import FollowedMap
from ogm_client.map_copy import MapCopy, Taken
from ogm_client.transport import Transport
from ogm_core.errors import BadMessage, OgmError
from ogm_core.wire.map_update import MapUpdate, decode_updates

SILENCE: Final = 3.0
"""A mapper that tells what changes is asked when it has said nothing for so long, s."""
ALIVE: Final = 2.0
"""A gateway that has told something so lately, s, is the one to hear: others tell the same in their words."""
_MAX_HEARD: Final = 16
"""So many messages wait for the thread at most; who is farther behind asks."""
_CLOSING: Final = 1.0
"""How long `close` waits for the thread, s: it may be waiting for an answer."""
_UNAVAILABLE: Final = 503
_NO_VERSION: Final = 400
"""What a mapper answers who names a version that none can have: somebody else has told it."""


class MapFollower(FollowedMap):
    """A map that follows its mapper's, cell for cell, as a context manager.

        with mapper.follow() as follower:
            change = follower.wait()
            while change is not None:
                print(change.region, follower.grid().revision)
                change = follower.wait(after=change.version)

    A thread of its own takes what the mapper tells, and asks for what it has missed; it goes on with a mapper
    that is started anew. Any thread may call the methods.
    """

    def __init__(
        self, transport: Transport, max_bytes: int, interval: float, *, coarse: bool = False
    ) -> None:
        """Take the map, which takes `max_bytes` at most; where nothing is told, ask every `interval` s.

        `coarse`: of a map that counts, the cells that it counts in, not their halves.

        Raises:
            ClientError: as every request.
        """
        super().__init__(MapCopy(max_bytes, coarse=coarse))
        self._transport = transport
        self._interval = interval
        self._heard: deque[bytes] = deque(maxlen=_MAX_HEARD)
        self._arrived = threading.Event()
        """Whether there is something to do for the thread; Zenoh's own waits for nobody to set it."""
        self._asked = 0.0
        """When it was last asked, by `time.monotonic()`."""
        self._heard_own = 0.0
        """When the mapper, or gateway, that the copy is of was last heard."""
        self._told = False
        """Whether the mapper tells what changes: it has since it was last asked for being silent."""
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
            mine, now = self._copy.version, time.monotonic()
            if mine is not None and update.run == mine.run:
                self._heard_own = now
            elif now - self._heard_own < ALIVE:
                return now - self._asked < SILENCE
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


def _nothing() -> None:
    """Stop what has been stopped."""
