"""Other mappers of the same map: at most one of them serves, and two that meet later say so.

Every mapper declares a liveliness token and answers a get of that token's key, for as long as it runs: only
who answers is a mapper. A bare token, of a stranger or of a mapper that is frozen, stops nobody.
"""

import json
import logging
import socket
import threading
import uuid
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from itertools import islice
from typing import Literal, NamedTuple

import zenoh

from ogm_core.errors import OgmError
from ogm_core.wire.keys import NAME, MapKeys

ANSWERED = 5.0
"""How long another mapper may take to say what it does, s; one that is frozen is gone sooner."""
MAX_DOUBTS = 10
"""Askers that are not there, or yield themselves: at one more, a mapper that starts gives up."""
LOOK_PERIOD = 1.0
"""How often a mapper that serves looks for others, s."""

MAX_HEARD = 64
"""So many answers, or tokens, are looked at, whoever gives them."""
MAX_OTHERS = 16
"""So many other mappers are kept of them."""
MAX_ANSWER = 256
"""The longest answer of a mapper, bytes."""
MAX_NAMED = 3
"""So many others are named where all would be too many."""

State = Literal["starting", "serving", "yielding"]

log = logging.getLogger(__name__)


class AlreadyMapped(OgmError):
    """Another mapper answers for this map."""

    slug = "already-mapped"


class Other(NamedTuple):
    """What another mapper says of itself: the key of its token, its run, and how far it is."""

    key: str
    run: str
    state: str


class OtherMappers:
    """A mapper's claim to its map, and whoever else claims it, until `close`.

    Of two that start at the same time the lower run stays. Who asks says its own run and state, and who is
    asked decides at once, under a lock: so both come to the same end, whoever asks first. Who has yielded
    asks back before it gives up, and goes on if the asker does not answer: it was no mapper, or has ended.
    One that serves never yields; when it finds another one that does, `rivals` names it, and the log says so,
    once.
    """

    def __init__(
        self, session: zenoh.Session, keys: MapKeys, run: str | None = None, period: float = LOOK_PERIOD
    ) -> None:
        self._session = session
        self._keys = keys
        self._run = uuid.uuid4().hex if run is None else run
        self._mine = keys.alive("mapper", _host_name(), self._run)
        self._period = period
        self._state: State = "starting"
        self._deciding = threading.Lock()
        self._yields_to = ""
        self._doubts = 0
        self._nobody: set[str] = set()
        """Keys of askers that did not answer."""
        self._declared = ExitStack()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self.rivals: frozenset[str] = frozenset()
        """Keys of the other mappers that serve this map, too."""

    def claim(self) -> None:
        """Declare this mapper alive, and look for another one: the first thing that a mapper does.

        Raises:
            AlreadyMapped: another mapper of this map serves, or starts as well and goes first.
        """
        asked = zenoh.handlers.Callback(self._asked, indirect=False)
        self._declared.push(self._session.declare_queryable(self._mine, asked, complete=False))
        self._declared.push(self._session.liveliness().declare_token(self._mine))
        answering = self._look_before_serving()
        tokens = self._session.liveliness().get(self._keys.alive("mapper", "*", "*"), timeout=ANSWERED)
        here = {key for key in map(self._key_of, islice(tokens, MAX_HEARD)) if key is not None}
        if bare := _named(here - answering):
            log.warning("%s: the token of a mapper that does not answer: this one starts all the same", bare)

    def serve(self) -> None:
        """Take the map: from here on newcomers yield. Then go on looking for others.

        Raises:
            AlreadyMapped: another one has come first since `claim`.
        """
        while self._state != "serving":
            self._look_before_serving()  # when they claimed it, neither may have been known to the other yet
            with self._deciding:
                if self._state == "starting":
                    self._state = "serving"
        self._thread = threading.Thread(target=self._watch, name="ogm-other-mappers")
        self._thread.start()

    def reasons(self) -> list[str]:
        """Why this mapper is not ready though it serves: the other mappers that do, too."""
        rivals = _named(self.rivals)
        return [f"another mapper of the map serves, too: {rivals}"] if rivals else []

    def close(self) -> None:
        """Withdraw the claim, and look no more."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
        self._declared.close()

    def _look_before_serving(self) -> set[str]:
        """Ask who else is there, and yield if it goes first; the keys of those who answer."""
        while True:
            others = list(self._others())
            for other in others:
                if other.state in ("serving", "starting"):  # it has been asked, and does not yield
                    raise self._already(other.key)
            if not self._yields_to:
                return {other.key for other in others}
            self._ask_back()

    def _ask_back(self) -> None:
        """Start anew if the asker that this one yields to is not there, or yields itself; else give up."""
        asker = self._yields_to
        states = {other.state for other in self._others(asker)}
        if "serving" in states or "starting" in states or self._doubts >= MAX_DOUBTS:
            raise self._already(asker)
        self._doubts += 1
        with self._deciding:
            if not states:
                self._nobody.add(asker)
            self._state, self._yields_to = "starting", ""

    def _already(self, key: str) -> AlreadyMapped:
        return AlreadyMapped(
            f"another mapper of map {self._keys.map_name!r} is alive ({key}): "
            "stop it, or choose another name with --map"
        )

    def _others(self, key: str | None = None) -> Iterator[Other]:
        """The other mappers that answer, or those of a key, MAX_OTHERS at most; others are passed over."""
        return islice(self._answering(key), MAX_OTHERS)

    def _answering(self, key: str | None) -> Iterator[Other]:
        replies = self._session.get(
            f"{key or self._keys.alive('mapper', '*', '*')}?run={self._run};state={self._state}",
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=ANSWERED,
        )
        for reply in islice(replies, MAX_HEARD):
            key = self._key_of(reply)
            if key is None or reply.ok is None or len(reply.ok.payload) > MAX_ANSWER:
                continue
            try:
                state = str(json.loads(reply.ok.payload.to_bytes())["state"])
            except (ValueError, TypeError, KeyError, RecursionError):
                continue
            yield Other(key, key.rpartition("/")[2], state)

    def _key_of(self, reply: zenoh.Reply) -> str | None:
        """The key of another mapper that a reply comes from; None if it is this one, or no mapper's."""
        key = "" if reply.ok is None else str(reply.ok.key_expr)
        host, _, run = key.removeprefix(self._keys.alive("mapper", "", "")[:-1]).partition("/")
        named = NAME.fullmatch(host) and NAME.fullmatch(run)
        return key if named and key != self._mine else None

    def _asked(self, query: zenoh.Query) -> None:
        """Say what this mapper does; one that starts yields to who serves, and to a lower run."""
        with query:
            asker, theirs = (str(query.parameters.get(name, "")) for name in ("run", "state"))
            with self._deciding:
                first = theirs == "serving" or (theirs == "starting" and asker < self._run)
                if self._state == "starting" and first and asker != self._run and NAME.fullmatch(asker):
                    key = self._keys.alive("mapper", "*", asker)
                    if key not in self._nobody:
                        self._state, self._yields_to = "yielding", key
                state = self._state
            reply = json.dumps({"run": self._run, "state": state})
            query.reply(self._mine, reply, encoding=zenoh.Encoding.APPLICATION_JSON)

    def _watch(self) -> None:
        while not self._stopping.wait(self._period):
            try:
                self._found(frozenset(other.key for other in self._others() if other.state == "serving"))
            except Exception:
                # A bug of ours: its traceback is kept, and the next look may do better.
                log.exception("a look for other mappers failed")

    def _found(self, serving: frozenset[str]) -> None:
        came, went = serving - self.rivals, self.rivals - serving
        self.rivals = serving
        name = self._keys.map_name
        if came:
            log.error(
                "another mapper of map %r serves, too (%s): both take scans and answer, and neither is ready "
                "until one is stopped",
                *(name, _named(came)),
            )
        if went:
            log.warning("the other mapper of map %r is gone (%s)", name, _named(went))


def _named(keys: Collection[str]) -> str:
    """The first of some keys, in order, and how many more there are; "" of none."""
    first, more = sorted(keys)[:MAX_NAMED], len(keys) - MAX_NAMED
    return ", ".join(first) + (f" and {more} more" if more > 0 else "")


def _host_name() -> str:
    """This machine's name, fit for a key: it stays the same when the mapper restarts."""
    name = "".join(c if NAME.fullmatch(c) else "-" for c in socket.gethostname())
    return name[:64] or "host"
