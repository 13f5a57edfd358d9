"""Caches of robots' publishers, as Zenoh's advanced publishers keep them: who has one, and what is in it."""

import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import NamedTuple

import zenoh

from ogm_core.units import MEBIBYTE
from ogm_core.wire.heads import Head, read_head
from ogm_core.wire.keys import MapKeys, Source

TIMEOUT = 2.0
"""How long a cache may take to answer, s."""
MAX_BYTES = 64 * MEBIBYTE
"""Answers that may be held at a time, of all caches."""
MAX_KEYS = 1000
"""Keys whose sources are remembered."""
_ADV = "/@adv/"


class Cached(NamedTuple):
    """A message out of a cache."""

    source: Source
    cache: str
    """Which of the source's caches: "<session>/<publisher>", or "" of one that numbers no samples."""
    number: int
    """The sample's number in its cache: one more with each; 0 if it does not number them."""
    head: Head | None
    """None where nobody can read it: such a message is not handed on, but it is no missing one."""
    payload: bytes


@dataclass(slots=True)
class Answer:
    """What caches have answered, each in its order.

    `whole`: all of them have, and all of it was taken. `over`: what comes now comes too late.
    """

    messages: list[Cached] = field(default_factory=list)
    whole: bool = True
    over: bool = False


@dataclass(slots=True)
class Account:
    """What one asker holds of answers, bytes."""

    held: int = 0


class Caches:
    """Asks the caches of a map's robots, and hears of those that come and go. Any thread.

    A cache is a queryable below its key, and has a token there; `**` does not match a chunk that begins with
    @, so that both are written out.
    """

    def __init__(self, session: zenoh.Session, keys: MapKeys, longest: Callable[[Source], int]) -> None:
        """`longest`: how long a source's messages may be, in bytes; longer ones are left where they are."""
        self._session = session
        self._keys = keys
        self._source_of = lru_cache(MAX_KEYS)(keys.source_of)
        self._longest = longest
        self._lock = threading.Lock()
        self._held = 0
        self._declared = ExitStack()

    @property
    def held(self) -> int:
        """Bytes of answers that are not released yet."""
        return self._held

    def declare(self, changed: Callable[[Source, str, bool], None]) -> None:
        """Have `changed` told, by Zenoh's thread, of every cache: source, cache, whether it is there."""

        def heard(sample: zenoh.Sample) -> None:
            key, _, cache = str(sample.key_expr).partition(_ADV)
            source = self._keys.source_of(key)
            if source is not None:
                changed(source, cache, sample.kind == zenoh.SampleKind.PUT)

        for key in self.keys_of("*"):
            handler = zenoh.handlers.Callback(heard, indirect=False)
            token = self._session.liveliness().declare_subscriber(key, handler, history=True)
            self._declared.callback(token.undeclare)

    def close(self) -> None:
        """Hear of nothing any more."""
        self._declared.close()

    def keys_of(self, robot: str) -> tuple[str, str]:
        """The keys of all caches of a robot."""
        start = f"{self._keys.root}/robots/{robot}"
        return f"{start}/pose{_ADV}**", f"{start}/scan/*{_ADV}**"

    def key_of(self, source: Source, cache: str) -> str:
        """The key of one cache; without a name of all of the source's."""
        robot, sensor = source
        key = self._keys.pose(robot) if sensor is None else self._keys.scan(robot, sensor)
        return f"{key}{_ADV}pub/{cache}/**" if cache else f"{key}{_ADV}**"

    def ask(self, robot: str, keys: Sequence[str], parameters: str, account: Account) -> Answer:
        """Ask the robot's caches at these keys, all at once; wait for the answers, up to TIMEOUT.

        Past MAX_BYTES of what all askers hold, one message is taken, and no more.
        """
        answer, done = Answer(), threading.Semaphore(0)
        for key in keys:
            try:
                self._session.get(
                    f"{key}{'?' if parameters else ''}{parameters}",
                    zenoh.handlers.Callback(
                        partial(self._replied, robot, answer, account), done.release, indirect=False
                    ),
                    target=zenoh.QueryTarget.ALL,
                    consolidation=zenoh.ConsolidationMode.NONE,
                    accept_replies=zenoh.ReplyKeyExpr.ANY,
                    timeout=TIMEOUT,
                )
            except zenoh.ZError:  # the session is closed
                return Answer(whole=False)
        for _ in keys:
            if not done.acquire(timeout=2.0 * TIMEOUT):
                answer.whole, answer.over = False, True
        return answer

    def release(self, account: Account, size: int | None = None) -> None:
        """Let go of so many bytes of answers, or of all that the asker holds."""
        with self._lock:
            size = account.held if size is None else size
            account.held -= size
            self._held -= size

    def _replied(self, robot: str, answer: Answer, account: Account, reply: zenoh.Reply) -> None:
        sample = reply.ok
        if sample is None:  # it took too long, or the link broke
            answer.whole = False
            return
        source = self._source_of(str(sample.key_expr))
        if source is None or source.robot != robot or answer.over:
            return
        payload = b""
        if (length := len(sample.payload)) <= self._longest(source):
            with self._lock:
                if self._held + length > MAX_BYTES and answer.messages:
                    answer.whole = False
                    return
                self._held += length
                account.held += length
            payload = sample.payload.to_bytes()
        cache, number, info = "", 0, sample.source_info
        if info is not None:
            cache, number = f"{info.source_id.zid}/{info.source_id.eid}", info.source_sn
        answer.messages.append(Cached(source, cache, number, read_head(payload), payload))
