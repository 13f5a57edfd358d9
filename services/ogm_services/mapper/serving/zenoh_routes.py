"""The mapper's routes on Zenoh: queryables over `Answers`, and the liveliness token of a running mapper."""

import socket
import uuid
from collections.abc import Callable
from contextlib import ExitStack

import zenoh

from ogm_core.errors import OgmError
from ogm_core.wire.keys import NAME, MapKeys
from ogm_services.mapper.serving.answers import Answers
from ogm_services.replies.answer import Answer, Parameters, refuse_parameters
from ogm_services.replies.queryables import Queryables

QUERY_THREADS = 4
TRUTH_TIMEOUT = 0.5
"""How long simulators may take to tell their world, s."""


class AlreadyMapped(OgmError):
    """Another mapper answers for this map."""

    slug = "already-mapped"


class ZenohRoutes:
    """What a mapper declares on a session to be found and asked, until `close`.

    Zenoh's threads call the callbacks, which hand their query to a small pool.
    """

    def __init__(self, session: zenoh.Session, keys: MapKeys) -> None:
        self._session = session
        self._keys = keys
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
        """Declare the queryables: from here on every question gets an answer."""

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


def _host_name() -> str:
    """This machine's name, fit for a key: it stays the same when the mapper restarts."""
    name = "".join(c if NAME.fullmatch(c) else "-" for c in socket.gethostname())
    return name[:64] or "host"
