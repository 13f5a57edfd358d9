"""Queryables on Zenoh that are never silent: a query gets an answer on a concrete key, or is told why not."""

import logging
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack
from functools import partial

import msgpack
import zenoh

from ogm_core.errors import BadParameter, OgmError
from ogm_services.replies.answer import Answer, Parameters
from ogm_services.replies.in_flight import InFlight
from ogm_services.replies.problems import MEDIA_TYPE, problem, problem_of
from ogm_services.replies.turns import Turns

log = logging.getLogger(__name__)


class Queryables:
    """The queryables of a service on a session, until `close`.

    Zenoh's threads call the callbacks, which only hand their query to the threads of a share, so that no link
    ever waits for an answer to be made.
    """

    def __init__(self, session: zenoh.Session, in_flight: InFlight | None = None) -> None:
        """`in_flight` counts what is being sent, also elsewhere."""
        self._session = session
        self._in_flight = in_flight or InFlight()
        self._declared = ExitStack()

    def declare(
        self, key: str, answer: Callable[[Parameters], Answer], turns: Turns, *, exact: bool = False
    ) -> None:
        """Answer queries of `key` as their turn comes; an OgmError that `answer` raises is told.

        With `exact`, a query of any other key expression that matches is refused.
        """

        def checked(query: zenoh.Query) -> Answer:
            if exact and str(query.key_expr) != key:
                name = key.rpartition("/")[2]
                raise BadParameter(f"{query.key_expr}: {name} is a write, ask for exactly {key}")
            return answer(_parameters(query))

        def callback(query: zenoh.Query) -> None:
            outcome = turns.take(partial(checked, query))
            outcome.add_done_callback(partial(_reply, query, key, self._in_flight))

        handler = zenoh.handlers.Callback(callback, indirect=False)
        self._declared.push(self._session.declare_queryable(key, handler, complete=False))

    def close(self) -> None:
        """Undeclare them; queries in hand are answered by who closes their turns."""
        self._declared.close()


def _reply(query: zenoh.Query, key: str, in_flight: InFlight, outcome: "Future[Answer]") -> None:
    """Answer a query on its concrete key; every failure is told."""
    with query:
        try:
            reply = outcome.result()
            attachment = None if reply.meta is None else msgpack.packb(reply.meta)
            with in_flight.sending(reply.body):
                query.reply(key, reply.body, encoding=reply.media_type, attachment=attachment)
        except OgmError as error:
            query.reply_err(problem_of(error), encoding=MEDIA_TYPE)
        except Exception:
            log.exception("a query of %s failed", key)
            query.reply_err(problem("internal", 500, "the service failed; see its log"), encoding=MEDIA_TYPE)


def _parameters(query: zenoh.Query) -> dict[str, str]:
    """The selector's parameters; names that begin with "_" are Zenoh's, and `t` is not heard, as over HTTP.

    Raises:
        BadParameter: one is given twice (Zenoh's own reading would silently take the last).
    """
    given: dict[str, str] = {}
    for part in filter(None, str(query.parameters).split(";")):
        name, _, value = part.partition("=")
        if name == "t":
            continue
        if name in given:
            raise BadParameter(f"{name}: given twice")
        given[name] = value
    return {name: value for name, value in given.items() if not name.startswith("_")}
