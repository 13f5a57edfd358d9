"""Backlog of a robot: what its publishers' caches keep that was not handed on yet, in the order of stamps."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field

from ogm_core.units import MEBIBYTE
from ogm_core.wire.keys import Source
from ogm_services.mapper.intake.caches import Account, Cached, Caches

NEWEST = 16
"""So many of the newest messages of each cache are asked for at first: mostly no more are missing."""
PART = 256
"""Then so many at a time, or fewer, so that they are no more than PART_BYTES."""
PART_BYTES = MEBIBYTE

Wanted = Callable[[Source, str], int | None]
"""The first seq of a source and run that was not handed on; None if nothing is known of the run."""


class Unanswered(Exception):
    """A cache has not answered, or not wholly: what it keeps has to be asked for again."""


@dataclass(slots=True, eq=False)
class _Feed:
    """One cache, oldest message first; what was not asked for yet comes before `newest`."""

    source: Source
    cache: str
    newest: deque[Cached]
    wanted: int
    """The number of the first message that is to be handed on."""
    part: int
    start: int = 0
    """The same, before anything was asked for."""
    buffer: deque[Cached] = field(default_factory=deque)
    number: int | None = None
    """That of the last message that was taken off."""


class Backlog:
    """The messages of one robot in the caches of its publishers.

    Messages of all keys are merged by their stamps, a pose before a scan of the same stamp; those of each
    cache stay in their order. A cache that numbers its samples is asked in parts: only two of them are held
    at a time, however much it keeps.
    """

    def __init__(self, caches: Caches, robot: str, wanted: Wanted) -> None:
        """Ask every cache of the robot for its newest messages.

        Raises:
            Unanswered: some did not answer in time. What the others said is dropped.
        """
        self._caches = caches
        self._robot = robot
        self._account = Account()
        found: dict[tuple[Source, str], list[Cached]] = {}
        with ExitStack() as failing:
            failing.callback(self.close)
            for message in self._ask(caches.keys_of(robot), f"_max={NEWEST}"):
                found.setdefault((message.source, message.cache), []).append(message)
            self._feeds = [self._feed(*cache, newest, wanted) for cache, newest in found.items()]
            failing.pop_all()
        self.sources = {source for source, _ in found}
        """Those that have a cache with something in it."""
        self.runs = {message.head[2] for newest in found.values() for message in newest if message.head}
        """Those of the newest messages."""

    def close(self) -> None:
        """Let go of what was not taken."""
        self._feeds = []
        self._caches.release(self._account)

    def messages(self) -> Iterator[tuple[Cached, bool]]:
        """Every message that is wanted; and whether it follows the one before, or is its cache's very first.

        Raises:
            Unanswered: a cache did not answer. What comes after is dropped.
        """
        while True:
            for feed in list(self._feeds):
                if not feed.buffer and not self._fill(feed):
                    self._feeds.remove(feed)
            if not self._feeds:
                return
            feed = min(self._feeds, key=_turn)
            message, before = feed.buffer.popleft(), feed.number
            feed.number = message.number
            self._release(message)
            if before is None:
                follows = not message.cache or self._is_oldest(feed, message.number)
            else:
                follows = not message.cache or message.number == before + 1
            yield message, follows

    def _feed(self, source: Source, cache: str, newest: list[Cached], wanted: Wanted) -> _Feed:
        size = max(len(message.payload) for message in newest)
        feed = _Feed(source, cache, deque(newest), 0, min(PART, 1 + PART_BYTES // (size + 1)))
        if not cache:
            if len(newest) >= NEWEST:
                self._ask_for_all(feed)
            return feed
        first, last = newest[0].number, newest[-1].number
        head = next((message.head for message in reversed(newest) if message.head is not None), None)
        if head is not None and head[2] == "":
            return _Feed(source, cache, deque(), last + 1, 1)  # nobody can tell what was handed on
        seq = None if head is None else wanted(source, head[2])
        if head is not None and seq is not None:
            # Seqs rise by one or more with each message: no wanted one lies before this number.
            feed.wanted = max(0, last - (head[1] - seq))
        feed.start = feed.wanted
        if feed.wanted < first:
            feed.wanted = max(feed.wanted, self._oldest(feed, first))
        while feed.newest and feed.newest[0].number < feed.wanted:
            self._release(feed.newest.popleft())
        return feed

    def _oldest(self, feed: _Feed, first: int) -> int:
        """A number before which the cache keeps nothing, found in steps back that double."""
        back = PART
        while first - back > feed.wanted:
            key = self._caches.key_of(feed.source, feed.cache)
            newest = self._ask([key], f"_sn=..{first - back};_max=1")
            if not newest:
                return first - back + 1
            self._release(newest[0])
            back *= 2
        return feed.wanted

    def _is_oldest(self, feed: _Feed, number: int) -> bool:
        """Whether the cache, which has just answered, keeps nothing before the first that is wanted."""
        if number <= feed.start:
            return number == 0
        key = self._caches.key_of(feed.source, feed.cache)
        older = self._ask([key], f"_sn=..{number - 1};_max=1")
        for message in older:
            self._release(message)
        return not older

    def _fill(self, feed: _Feed) -> bool:
        """Ask for the next part; False if there is none."""
        end = feed.newest[0].number if feed.newest else feed.wanted
        key = self._caches.key_of(feed.source, feed.cache)
        while not feed.buffer and feed.cache and feed.wanted < end:
            last = min(feed.wanted + feed.part, end)  # the first one after the last part is known to be there
            answer = self._caches.ask(self._robot, [key], f"_sn={feed.wanted}..{last}", self._account)
            found = answer.messages
            if not found and (last == end or not answer.whole):
                raise Unanswered
            feed.wanted = last + 1 if answer.whole or not found else found[-1].number + 1
            if found and found[-1].number == end:
                self._release(found.pop())
            feed.buffer.extend(found)
        if not feed.buffer:
            feed.buffer, feed.newest = feed.newest, deque()
        return bool(feed.buffer)

    def _ask_for_all(self, feed: _Feed) -> None:
        """Take everything at once from a cache that cannot be asked for a part."""
        for message in feed.newest:
            self._release(message)
        everything = self._ask([self._caches.key_of(feed.source, "")], "")
        feed.newest = deque(message for message in everything if not message.cache)

    def _ask(self, keys: Sequence[str], parameters: str) -> list[Cached]:
        answer = self._caches.ask(self._robot, keys, parameters, self._account)
        if not answer.whole:
            raise Unanswered
        return answer.messages

    def _release(self, message: Cached) -> None:
        self._caches.release(self._account, len(message.payload))


def _turn(feed: _Feed) -> tuple[int, bool]:
    head = feed.buffer[0].head
    return (head[0] if head else 0), feed.source.sensor is not None
