"""Queryables on Zenoh that are never silent: a query gets an answer on a concrete key, or is told why not."""

import logging
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import msgpack
import zenoh

from ogm_core.errors import BadParameter, OgmError
from ogm_services.replies.answer import Answer, Busy, Parameters, Unavailable
from ogm_services.replies.problems import MEDIA_TYPE, problem, problem_of

MAX_WAITING = 64
"""Queries that may wait for a thread; past it they are refused at once."""

log = logging.getLogger(__name__)


class Queryables:
    """The queryables of a service on a session, until `close`.

    Zenoh's threads call the callbacks, which only hand their query to a pool of `threads`, so that no link
    ever waits for an answer to be made. MAX_WAITING of them may wait for the pool; more are refused as busy.
    """

    def __init__(self, session: zenoh.Session, threads: int) -> None:
        self._session = session
        self._declared = ExitStack()
        self._pool = ThreadPoolExecutor(threads, "ogm-query")
        self._room = threading.BoundedSemaphore(threads + MAX_WAITING)

    def declare(self, key: str, answer: Callable[[Parameters], Answer], *, exact: bool = False) -> None:
        """Answer queries of `key`; an OgmError that `answer` raises is told.

        With `exact`, a query of any other key expression that matches is refused.
        """

        def checked(query: zenoh.Query) -> Answer:
            if exact and str(query.key_expr) != key:
                name = key.rpartition("/")[2]
                raise BadParameter(f"{query.key_expr}: {name} is a write, ask for exactly {key}")
            return answer(_parameters(query))

        def callback(query: zenoh.Query) -> None:
            if not self._room.acquire(blocking=False):
                _refuse(
                    query, Busy(f"{key}: {MAX_WAITING} queries wait for an answer already: try again later")
                )
                return
            try:
                answered = self._pool.submit(_reply, query, key, checked)
            except RuntimeError:  # the pool takes no more
                self._room.release()
                _refuse(query, Unavailable(f"{key}: the service is stopping"))
            else:
                answered.add_done_callback(lambda _: self._room.release())

        handler = zenoh.handlers.Callback(callback, indirect=False)
        self._declared.push(self._session.declare_queryable(key, handler, complete=False))

    def close(self) -> None:
        """Undeclare them; queries in hand are answered first."""
        self._declared.close()
        self._pool.shutdown()


def _refuse(query: zenoh.Query, error: OgmError) -> None:
    with query:
        query.reply_err(problem_of(error), encoding=MEDIA_TYPE)


def _reply(query: zenoh.Query, key: str, answer: Callable[[zenoh.Query], Answer]) -> None:
    """Answer a query on its concrete key; every failure is told."""
    with query:
        try:
            reply = answer(query)
        except OgmError as error:
            query.reply_err(problem_of(error), encoding=MEDIA_TYPE)
        except Exception:
            log.exception("a query of %s failed", key)
            query.reply_err(problem("internal", 500, "the service failed; see its log"), encoding=MEDIA_TYPE)
        else:
            attachment = None if reply.meta is None else msgpack.packb(reply.meta)
            query.reply(key, reply.body, encoding=reply.media_type, attachment=attachment)


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
