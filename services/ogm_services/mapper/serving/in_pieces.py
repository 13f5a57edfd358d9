"""Long bodies over HTTP in pieces, so that it is known when they are gone."""

from collections.abc import Iterator
from itertools import chain

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ogm_services.mapper.serving.refusals import refusal
from ogm_services.replies.answer import Busy
from ogm_services.replies.in_flight import BUFFERED, SMALL, InFlight

PIECE = BUFFERED // 2
"""A server holds one piece, and what it has handed to the network."""


class InPieces:
    """ASGI middleware: counts every long body until the last piece has gone or the connection is closed.

    A server takes a whole body at once, and holds it for as long as its reader likes; a piece it takes only
    when the one before has gone. What has no room is answered with 503 in its place.
    """

    def __init__(self, app: ASGIApp, in_flight: InFlight) -> None:
        self._app = app
        self._in_flight = in_flight

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand a request on, and send what is answered."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        held: list[Message] = []
        refused = False

        async def send_counted(message: Message) -> None:
            nonlocal refused
            if message["type"] == "http.response.start":
                held.append(message)  # until it is known whether its body has room
                return
            if refused:
                return
            if len(message.get("body", b"")) <= SMALL or scope["method"] == "HEAD":
                for start in (*held, message):
                    await send(start)
                held.clear()
                return
            try:
                with self._in_flight.sending(message["body"]):
                    for piece in chain(held, _pieces(message)):
                        await send(piece)
                    held.clear()
            except Busy as error:
                if not held:  # it has begun already, and can only be cut off
                    raise
                refused = True
                await refusal(error)(scope, receive, send)

        await self._app(scope, receive, send_counted)


def _pieces(message: Message) -> Iterator[Message]:
    """A body's message in pieces; the server takes the empty one at the end when all others have gone."""
    body = message["body"]
    for first in range(0, len(body), PIECE):
        piece = body if len(body) <= PIECE else bytes(memoryview(body)[first : first + PIECE])
        yield {"type": "http.response.body", "body": piece, "more_body": True}
    yield {**message, "body": b""}
