"""The mapper on Zenoh: one subscriber that only fills the inbox, and the queryables."""

import logging
import socket
import time
import uuid
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import msgpack
import zenoh

from ogm_core.errors import BadParameter, OgmError
from ogm_core.keys import NAME, MapKeys, Service
from ogm_services.limited_log import LimitedLog
from ogm_services.mapper.answers import Answer, Answers, Parameters
from ogm_services.mapper.inbox import Inbox, Item
from ogm_services.mapper.ledger import Ledger
from ogm_services.mapper.problems import MEDIA_TYPE, problem, problem_of

QUERY_THREADS = 4

log = logging.getLogger(__name__)


class AlreadyMapped(OgmError):
    """Another mapper answers for this map."""

    slug = "already-mapped"


class ZenohSide:
    """A mapper's declarations on a session, until `close`.

    Zenoh's threads call the callbacks: that of the subscriber only counts and enqueues, those of the
    queryables hand their query to a small pool, so that no link ever waits for an answer to be encoded.
    """

    def __init__(self, session: zenoh.Session, keys: MapKeys, inbox: Inbox, ledger: Ledger) -> None:
        self._session = session
        self._keys = keys
        self._inbox = inbox
        self._ledger = ledger
        self._complaints = LimitedLog(log)
        self._declared = ExitStack()
        self._pool = ThreadPoolExecutor(QUERY_THREADS, "ogm-query")

    def claim(self) -> None:
        """Declare this mapper alive, and look for another one.

        Raises:
            AlreadyMapped: another mapper of this map is alive.
        """
        mine = self._keys.alive("mapper", _host_name(), uuid.uuid4().hex)
        self._declared.push(self._session.liveliness().declare_token(mine))
        alive = self._session.liveliness().get(self._keys.alive("mapper", "*", "*"), timeout=2.0)
        others = {str(reply.ok.key_expr) for reply in alive if reply.ok is not None} - {mine}
        if others:
            raise AlreadyMapped(
                f"another mapper of map {self._keys.map_name!r} is alive ({others.pop()}): "
                "stop it, or choose another name with --map"
            )

    def declare(self, answers: Answers, reset: Callable[[], None]) -> None:
        """Declare the queryables, then the subscriber: from here on nothing that is put is missed."""

        def map_answer(given: Parameters) -> Answer:
            return answers.map(given.get("format", "json"), {k: v for k, v in given.items() if k != "format"})

        def reset_answer(given: Parameters) -> Answer:
            if given:
                raise BadParameter(f"{next(iter(given))}: reset has no parameters")
            reset()
            return answers.status({})

        self._answer("map", map_answer)
        self._answer("cell", answers.cell)
        self._answer("quality", answers.quality)
        self._answer("status", answers.status)
        self._answer("reset", reset_answer, exact=True)
        self._declared.push(
            self._session.declare_subscriber(
                self._keys.robots, zenoh.handlers.Callback(self._received, indirect=False)
            )
        )

    def close(self) -> None:
        """Undeclare everything; queries in hand are answered first."""
        self._declared.close()
        self._pool.shutdown()

    def _received(self, sample: zenoh.Sample) -> None:
        source = self._keys.source_of(str(sample.key_expr))
        if source is None or sample.kind != zenoh.SampleKind.PUT:
            self._ledger.ignored()
            return
        if source.sensor is None:
            self._ledger.pose_received(source.robot)
        else:
            self._ledger.scan_received(source.robot, source.sensor)
        item = Item(source, sample.payload.to_bytes(), time.monotonic())
        for robot, sensor in self._inbox.put(item):
            if sensor is not None:
                self._ledger.scan_dropped(robot, sensor, "overload")
                self._complaints.warning(f"{robot}/{sensor}", "the queue is full, its oldest scan is dropped")

    def _answer(self, name: Service, answer: Callable[[Parameters], Answer], *, exact: bool = False) -> None:
        key = self._keys.service(name)

        def checked(query: zenoh.Query) -> Answer:
            if exact and str(query.key_expr) != key:
                raise BadParameter(f"{query.key_expr}: {name} is a write, ask for exactly {key}")
            return answer(_parameters(query))

        def callback(query: zenoh.Query) -> None:
            self._pool.submit(_reply, query, key, checked)

        handler = zenoh.handlers.Callback(callback, indirect=False)
        self._declared.push(self._session.declare_queryable(key, handler, complete=False))


def _reply(query: zenoh.Query, key: str, answer: Callable[[zenoh.Query], Answer]) -> None:
    """Answer a query on its concrete key; every failure is told."""
    with query:
        try:
            reply = answer(query)
        except OgmError as error:
            query.reply_err(problem_of(error), encoding=MEDIA_TYPE)
        except Exception:
            log.exception("a query of %s failed", key)
            query.reply_err(problem("internal", 500, "the mapper failed; see its log"), encoding=MEDIA_TYPE)
        else:
            attachment = None if reply.meta is None else msgpack.packb(reply.meta)
            query.reply(key, reply.body, encoding=reply.media_type, attachment=attachment)


def _parameters(query: zenoh.Query) -> dict[str, str]:
    """The selector's parameters; names that begin with "_" are Zenoh's own.

    Raises:
        BadParameter: one is given twice (Zenoh's own reading would silently take the last).
    """
    given: dict[str, str] = {}
    for part in filter(None, str(query.parameters).split(";")):
        name, _, value = part.partition("=")
        if name in given:
            raise BadParameter(f"{name}: given twice")
        given[name] = value
    return {name: value for name, value in given.items() if not name.startswith("_")}


def _host_name() -> str:
    """This machine's name, fit for a key: it stays the same when the mapper restarts."""
    name = "".join(c if NAME.fullmatch(c) else "-" for c in socket.gethostname())
    return name[:64] or "host"
