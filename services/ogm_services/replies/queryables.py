"""Queryables on Zenoh that are never silent: a query gets an answer on a concrete key, or is told why not."""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from functools import partial

import msgpack
import zenoh

from ogm_core.errors import BadParameter, cut
from ogm_services.replies.answer import Answer, Busy, Parameters
from ogm_services.replies.error_replies import ErrorReplies
from ogm_services.replies.in_flight import SMALL, InFlight
from ogm_services.replies.turns import Turns

MAX_PARAMETERS = 4096
"""The longest parameters of a query, characters."""
MAX_BESIDES = 1024
"""The longest payload or attachment of a query, bytes, of which none is read."""
MAX_LARGE = 4
"""So many answers above SMALL are sent at once: a link that stands still holds up whoever sends on it."""
LARGE_PATIENCE = 1.0
"""So long a large answer waits until it may be sent, s."""


class Queryables:
    """The queryables of a service on a session, until `close`.

    Zenoh's threads call the callbacks, which only hand their query to answering threads, or to the one
    that sends errors, so that no link ever waits for an answer to be made, or for another link.
    """

    def __init__(self, session: zenoh.Session, in_flight: InFlight | None = None) -> None:
        """`in_flight` counts what is being sent, also elsewhere."""
        self._session = session
        self._in_flight = in_flight or InFlight()
        self._large = threading.BoundedSemaphore(MAX_LARGE)
        self._errors = ErrorReplies()
        self._declared = ExitStack()
        self._declared.callback(self._errors.close)

    def declare(
        self, key: str, answer: Callable[[Parameters], Answer], turns: Turns, *, exact: bool = False
    ) -> None:
        """Answer queries of `key` as their turn comes; an OgmError that `answer` raises is told.

        With `exact`, a query of any other key expression that matches is refused.
        """

        def reply(query: zenoh.Query, text: str) -> None:
            if exact and str(query.key_expr) != key:
                name = key.rpartition("/")[2]
                raise BadParameter(f"{cut(str(query.key_expr))}: {name} is a write, ask for exactly {key}")
            self._reply(query, key, answer(_parameters(text)))

        self._declare(key, reply, turns, MAX_BESIDES)

    def declare_with_body(
        self, key: str, answer: Callable[[Parameters, bytes], Answer], turns: Turns, most: int
    ) -> None:
        """The same for queries whose payload, of at most so many bytes, says what is asked."""

        def reply(query: zenoh.Query, text: str) -> None:
            body = b"" if query.payload is None else query.payload.to_bytes()
            self._reply(query, key, answer(_parameters(text), body))

        self._declare(key, reply, turns, most)

    def _declare(
        self, key: str, reply: Callable[[zenoh.Query, str], None], turns: Turns, longest_payload: int
    ) -> None:
        def callback(query: zenoh.Query) -> None:
            try:
                text = _checked(query, longest_payload)
            except BadParameter as error:
                self._errors.tell(query, error, large=True)
            else:
                turns.take(partial(reply, query, text)).add_done_callback(partial(self._tell, query))

        handler = zenoh.handlers.Callback(callback, indirect=False)
        self._declared.push(self._session.declare_queryable(key, handler, complete=False))

    def close(self) -> None:
        """Undeclare them; queries in hand are answered by who closes their turns."""
        self._declared.close()

    def _reply(self, query: zenoh.Query, key: str, answer: Answer) -> None:
        attachment = None if answer.meta is None else msgpack.packb(answer.meta)
        with self._in_flight.sending(answer.body), self._one_of_few(answer.body):
            query.reply(key, answer.body, encoding=answer.media_type, attachment=attachment)
        with query:  # nothing more follows
            pass

    def _tell(self, query: zenoh.Query, outcome: "Future[None]") -> None:
        error = outcome.exception()
        if error is not None:
            self._errors.tell(query, error)

    @contextmanager
    def _one_of_few(self, body: bytes) -> Iterator[None]:
        """Be one of MAX_LARGE inside, with a large body.

        Raises:
            Busy: those that are being sent do not end.
        """
        if len(body) <= SMALL:
            yield
            return
        if not self._large.acquire(timeout=LARGE_PATIENCE):
            raise Busy(f"{MAX_LARGE} large answers are being sent already: try again later")
        try:
            yield
        finally:
            self._large.release()


def _checked(query: zenoh.Query, longest_payload: int) -> str:
    """The parameters of a query, as text.

    Raises:
        BadParameter: they, or what comes with them, are longer than any that is of use.
    """
    text = str(query.parameters)
    if len(text) > MAX_PARAMETERS:
        raise BadParameter(f"parameters: at most {MAX_PARAMETERS} characters are read, got {len(text)}")
    sizes = ("payload", query.payload, longest_payload), ("attachment", query.attachment, MAX_BESIDES)
    for name, part, most in sizes:
        if part is not None and len(part) > most:
            raise BadParameter(f"{name}: at most {most} bytes may come with this query, got {len(part)}")
    return text


def _parameters(text: str) -> dict[str, str]:
    """The selector's parameters; names that begin with "_" are Zenoh's, and `t` is not heard, as over HTTP.

    Raises:
        BadParameter: one is given twice (Zenoh's own reading would silently take the last).
    """
    given: dict[str, str] = {}
    for part in filter(None, text.split(";")):
        name, _, value = part.partition("=")
        if name == "t":
            continue
        if name in given:
            raise BadParameter(f"{cut(name)}: given twice")
        given[name] = value
    return {name: value for name, value in given.items() if not name.startswith("_")}
