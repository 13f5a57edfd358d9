"""The mapper on Zenoh: one subscriber that only fills the inbox, and the queryables."""

import logging
import socket
import time
import uuid
from collections.abc import Callable
from contextlib import ExitStack
from functools import lru_cache

import zenoh

from ogm_core.errors import OgmError
from ogm_core.wire.keys import NAME, MapKeys
from ogm_services.mapper.intake.queue import Inbox, Item
from ogm_services.mapper.ledger import Ledger
from ogm_services.mapper.serving.answers import Answers
from ogm_services.replies.answer import Answer, Parameters, refuse_parameters
from ogm_services.replies.queryables import Queryables
from ogm_services.runtime.limited_log import LimitedLog

MAX_SOURCES = 1000
"""Keys of messages whose sources are remembered; reading one anew does no harm."""
QUERY_THREADS = 4
TRUTH_TIMEOUT = 0.5
"""How long simulators may take to tell their world, s."""

log = logging.getLogger(__name__)


class AlreadyMapped(OgmError):
    """Another mapper answers for this map."""

    slug = "already-mapped"


class ZenohSide:
    """A mapper's declarations on a session, until `close`.

    Zenoh's threads call the callbacks: that of the subscriber only counts and enqueues, those of the
    queryables hand their query to a small pool.
    """

    def __init__(self, session: zenoh.Session, keys: MapKeys, inbox: Inbox, ledger: Ledger) -> None:
        self._session = session
        self._keys = keys
        self._source_of = lru_cache(MAX_SOURCES)(keys.source_of)
        self._inbox = inbox
        self._ledger = ledger
        self._complaints = LimitedLog(log)
        self._declared = ExitStack()
        self._queryables = Queryables(session, QUERY_THREADS)

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
            refuse_parameters(given, "reset")
            reset()
            return answers.status({})

        self._declared.callback(self._queryables.close)
        declare, key = self._queryables.declare, self._keys.service
        declare(key("map"), map_answer)
        declare(key("cell"), answers.cell)
        declare(key("quality"), answers.quality)
        declare(key("status"), answers.status)
        declare(key("reset"), reset_answer, exact=True)
        self._declared.push(
            self._session.declare_subscriber(
                self._keys.robots, zenoh.handlers.Callback(self._received, indirect=False)
            )
        )

    def ask_truth(self) -> list[bytes]:
        """What simulators of this map say their world is; [] at once if there is none.

        Waits for the network, up to TRUTH_TIMEOUT: never call it from a callback.
        """
        # All of them are asked and heard: with one reply a key, which one it is would be chance.
        replies = self._session.get(
            self._keys.truth,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=TRUTH_TIMEOUT,
        )
        return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]

    def close(self) -> None:
        """Undeclare everything; queries in hand are answered first."""
        self._declared.close()

    def _received(self, sample: zenoh.Sample) -> None:
        source = self._source_of(str(sample.key_expr))
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


def _host_name() -> str:
    """This machine's name, fit for a key: it stays the same when the mapper restarts."""
    name = "".join(c if NAME.fullmatch(c) else "-" for c in socket.gethostname())
    return name[:64] or "host"
