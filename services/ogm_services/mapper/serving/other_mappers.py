"""Other mappers of the same map: at most one of them serves, and two that meet later say so.

Every mapper declares a liveliness token and answers a get of that token's key, for as long as it runs: only
who answers so, with its own run, is a mapper. A bare token, of a stranger or of a mapper that is frozen,
stops nobody; nor does a question, whoever asks.
"""

import json
import logging
import socket
import threading
import time
import uuid
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from itertools import islice
from typing import Literal, NamedTuple, get_args

import zenoh

from ogm_core.errors import OgmError
from ogm_core.wire.keys import NAME, MapKeys

ANSWERED = 5.0
"""How long another mapper may take to say what it does, s; one that is frozen is gone sooner."""
SETTLED = 2 * ANSWERED
"""How long a mapper that goes first waits for one that has looked before it was there to be seen, s."""
SETTLING_PERIOD = 0.1
"""How often it looks meanwhile, s."""
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

    Of two that start at the same time the lower run stays. Each can be asked before it looks, so at least one
    of them sees the other. The higher run gives up if it sees the lower; the lower goes on looking until the
    other has given up or serves, for that one may have looked too early to see it. What a mapper does follows
    from what it is answered alone: questions change nothing, so that no stranger's can.
    One that serves never yields; when it finds another one that does, `rivals` names it, and the log says so,
    once.
    """

    def __init__(
        self,
        session: zenoh.Session,
        keys: MapKeys,
        run: str | None = None,
        period: float = LOOK_PERIOD,
        *,
        share: int | None = None,
    ) -> None:
        """`share`: which one it claims of a map that is cut; who claims others is not looked for."""
        self._session = session
        self._run = uuid.uuid4().hex if run is None else run
        self._mine = keys.alive("mapper", host_name() if share is None else str(share), self._run)
        self._all = keys.alive("mapper", "*" if share is None else str(share), "*")
        self._before = keys.alive("mapper", "", "")[:-1]
        self._what = f"map {keys.map_name!r}" if share is None else f"share {share} of map {keys.map_name!r}"
        self._cure = "choose another name with --map" if share is None else "take another share"
        self._period = period
        self._state: State = "starting"
        self._declared = ExitStack()
        self._stopping = threading.Event()
        self._asking = zenoh.CancellationToken()
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
        before = self._tokens()
        answering = {other.key for other in self._look_before_serving()}
        # One that came or went meanwhile is no bare token: these stand before and after the look.
        if (bare := before - answering) and (bare := bare & self._tokens()):
            log.warning(
                "%s: the token of a mapper that does not answer: this one starts all the same", _named(bare)
            )

    def serve(self) -> None:
        """Take the map: from here on newcomers give up. Then go on looking for others.

        Raises:
            AlreadyMapped: another one has come first since `claim`.
        """
        until = time.monotonic() + SETTLED
        # When they claimed it, neither may have been known to the other yet.
        while any(other.state == "starting" for other in self._look_before_serving()):
            if time.monotonic() >= until:  # whenever it looks now, it sees this one
                break
            self._stopping.wait(SETTLING_PERIOD)
        self._state = "serving"
        self._thread = threading.Thread(target=self._watch, name="ogm-other-mappers")
        self._thread.start()

    def reasons(self) -> list[str]:
        """Why this mapper is not ready though it serves: the other mappers that do, too."""
        rivals = _named(self.rivals)
        return [f"another mapper of the map serves, too: {rivals}"] if rivals else []

    def close(self) -> None:
        """Withdraw the claim, and look no more: a look in hand is given up."""
        self._stopping.set()
        self._asking.cancel()  # type: ignore[no-untyped-call]
        if self._thread is not None:
            self._thread.join()
        self._declared.close()

    def _tokens(self) -> set[str]:
        """The keys of the tokens of other mappers, MAX_HEARD at most."""
        tokens = self._session.liveliness().get(self._all, timeout=ANSWERED)
        return {key for key in map(self._key_of, islice(tokens, MAX_HEARD)) if key is not None}

    def _look_before_serving(self) -> list[Other]:
        """The others that answer; give up if one of them goes first."""
        others = list(self._others())
        for other in others:
            if other.state == "serving" or (other.state == "starting" and other.run < self._run):
                self._state = "yielding"
                raise AlreadyMapped(
                    f"another mapper of {self._what} is alive ({other.key}): stop it, or {self._cure}"
                )
        return others

    def _others(self) -> Iterator[Other]:
        """The other mappers that answer, MAX_OTHERS at most; others are passed over."""
        return islice(self._answering(), MAX_OTHERS)

    def _answering(self) -> Iterator[Other]:
        replies = self._session.get(
            self._all,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=ANSWERED,
            # Its own answer would be put in by this thread, within `get`: it waits where the channel is full.
            allowed_destination=zenoh.Locality.REMOTE,
            cancellation_token=self._asking,
        )
        for reply in islice(replies, MAX_HEARD):
            key = self._key_of(reply)
            if key is None or reply.ok is None or len(reply.ok.payload) > MAX_ANSWER:
                continue
            try:
                told = json.loads(reply.ok.payload.to_bytes())
                run, state = told["run"], told["state"]
            except (ValueError, TypeError, KeyError, RecursionError):
                continue
            if run == key.rpartition("/")[2] and state in get_args(State):
                yield Other(key, run, state)

    def _key_of(self, reply: zenoh.Reply) -> str | None:
        """The key of another mapper that a reply comes from; None if it is this one, or no mapper's."""
        key = "" if reply.ok is None else str(reply.ok.key_expr)
        host, _, run = key.removeprefix(self._before).partition("/")
        named = NAME.fullmatch(host) and NAME.fullmatch(run)
        return key if named and key != self._mine else None

    def _asked(self, query: zenoh.Query) -> None:
        """Say what this mapper does."""
        with query:
            reply = json.dumps({"run": self._run, "state": self._state})
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
        if came:
            log.error(
                "another mapper of %s serves, too (%s): both take scans and answer, and neither is ready "
                "until one is stopped",
                *(self._what, _named(came)),
            )
        if went:
            log.warning("the other mapper of %s is gone (%s)", self._what, _named(went))


def _named(keys: Collection[str]) -> str:
    """The first of some keys, in order, and how many more there are; "" of none."""
    first, more = sorted(keys)[:MAX_NAMED], len(keys) - MAX_NAMED
    return ", ".join(first) + (f" and {more} more" if more > 0 else "")


def host_name() -> str:
    """This machine's name, fit for a key: it stays the same when the mapper restarts."""
    name = "".join(c if NAME.fullmatch(c) else "-" for c in socket.gethostname())
    return name[:64] or "host"
