"""WebSocket clients that watch the map live: each is told what has changed of its view, as often as it likes.

Here is who is let in, how many there are, and why one is served no longer; `live_client.py` serves it.
"""

import logging
from collections.abc import Callable, Container
from contextlib import suppress
from typing import Final

from starlette.datastructures import Headers
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from ogm_core.errors import BadMessage, OgmError
from ogm_services.mapper.serving.handlers import in_turn
from ogm_services.mapper.serving.live_changes import LiveChanges
from ogm_services.mapper.serving.live_client import LiveClient
from ogm_services.mapper.serving.live_updates import LiveUpdates
from ogm_services.mapper.serving.refusals import refusal
from ogm_services.mapper.serving.same_origin import foreign_origin
from ogm_services.replies.answer import Busy, CrossOrigin, Unavailable
from ogm_services.replies.in_flight import InFlight
from ogm_services.replies.turns import Turns
from ogm_services.runtime.limited_log import LimitedLog

_MAX_REASON = 120
"""A reason to close may have 123 bytes (RFC 6455, section 5.5)."""

_LEFT, _MALFORMED, _FULL, _ORIGIN, _FAILED = "left", "malformed", "full", "origin", "failed"
ENDED_FOR: Final = (_LEFT, _MALFORMED, _FULL, _ORIGIN, _FAILED)
"""Why clients are served no longer, or not at all: see docs/operate.md."""

log = logging.getLogger(__name__)


class LiveClients:
    """The clients of a mapper, as an ASGI endpoint. All of it belongs to the event loop."""

    def __init__(
        self,
        updates: LiveUpdates,
        turns: Turns,
        in_flight: InFlight,
        check_ready: Callable[[], None],
        *,
        most: int,
        origins: Container[str] = (),
        counted: Callable[[int], None] = lambda _: None,
        ended: Callable[[str], None] = lambda _: None,
    ) -> None:
        """`turns` are of one thread, on which messages are made; `in_flight` counts them while they are sent.

        `most`: clients at a time. `origins` whose pages may, besides the mapper's own. `counted` is told how
        many clients there are, `ended` for which of ENDED_FOR one is served no longer.
        """
        self._updates = updates
        self._turns = turns
        self._in_flight = in_flight
        self._check_ready = check_ready
        self._most = most
        self._origins = origins
        self._counted = counted
        self._ended = ended
        self._changes = LiveChanges(updates.now)
        self._open = 0
        self._complaints = LimitedLog(log)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a client until it leaves, or refuse it."""
        try:
            self._check_welcome(scope)
        except OgmError as refused:
            await refusal(refused)(scope, receive, send)
            return
        self._count(1)
        ended = _FAILED
        try:
            ended = await self._served(WebSocket(scope, receive, send))
        finally:
            self._count(-1)
            self._ended(ended)

    def _check_welcome(self, scope: Scope) -> None:
        """Whether a client may be served.

        Raises:
            CrossOrigin: a page of another origin asks for it.
            Busy: there are as many as there may be.
            Starting: the mapper has not started.
        """
        foreign = foreign_origin(Headers(scope=scope), self._origins)
        if foreign is not None:
            self._ended(_ORIGIN)
            raise CrossOrigin(f"{scope['path']}: refused: a page of another origin asks for it ({foreign})")
        if self._open >= self._most:
            self._ended(_FULL)
            raise Busy(f"{self._open} clients watch the map live already (http.max_live): try again later")
        self._check_ready()

    def _count(self, more: int) -> None:
        self._open += more
        self._counted(self._open)

    async def _served(self, websocket: WebSocket) -> str:
        """Serve a client that is welcome; returns why it is served no longer."""
        try:
            await websocket.accept()
            hello, life = await in_turn(self._turns, self._updates.hello)
            await websocket.send_bytes(hello)
            client = LiveClient(websocket, life, self._updates, self._changes, self._turns, self._in_flight)
            await client.serve()
        except WebSocketDisconnect:
            pass
        except BadMessage as error:
            self._complaints.of_kind("/ws", _MALFORMED, f"a client is cut off: {error}")
            await _close(websocket, 1008, str(error))
            return _MALFORMED
        except (Busy, Unavailable) as error:  # there is no turn for its first message
            await _close(websocket, 1013, str(error))
            return _FULL
        except Exception:  # noqa: BLE001 - it is logged, with its traceback
            self._complaints.failure("serving a WebSocket client")
            await _close(websocket, 1011, "the mapper failed; see its log")
            return _FAILED
        return _LEFT


async def _close(websocket: WebSocket, code: int, reason: str) -> None:
    """Close it, unless it is closed already."""
    with suppress(WebSocketDisconnect, RuntimeError):
        await websocket.close(code, reason.encode()[:_MAX_REASON].decode(errors="ignore"))
