"""WebSocket connections below the application: what of them it ever sees, and how long who is waited for.

uvicorn's connection over websockets, whose grammar is strict, with what that lacks: bounds and deadlines of
what is sent, and an end in time.
"""

import asyncio
import re
from collections.abc import Sequence
from typing import Any, Final

import uvicorn
from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import ServerState
from websockets.frames import Frame

from ogm_core.units import MEBIBYTE
from ogm_services.mapper.serving.http_limits import STALLED
from ogm_services.mapper.serving.waiting_connections import WaitingConnections

MAX_MESSAGE: Final = 64 * 1024
"""A client's messages have so many bytes at most."""
_MAX_FRAMES = 256
"""A message comes in so many frames at most: frames without a byte count for nothing in its length."""
MOST_AT_ONCE = 1024
"""So many frames of a client are read at once, at most, while all others wait: those of a minute of views."""
_PORTION = 4096
"""Bytes that are read of them before it is looked how many they are."""
PING_PERIOD: Final = 20.0
"""Between two pings, and how long the answer to one may take, s."""
STOPPING: Final = 1001
"""The code of RFC 6455, section 7.4.1, of a server that goes away."""
_TOO_MANY = 1008
"""And of one whose rules are broken."""
_TOO_BIG = 1009
"""And of one that takes no message as large."""
_MAX_UNSENT = 8 * MEBIBYTE
"""More waits for no client that reads: a message is half as long. What remains are answers to its pings."""
_TIME_TO_CLOSE = 1.0
"""How long a client may take to hear that the mapper stops, s."""
_KEY = re.compile(rb"[A-Za-z0-9+/]{22}==")
_PROTOCOLS = re.compile(rb"[!#$%&'*+\-.^_`|~0-9A-Za-z]+([ \t]*,[ \t]*[!#$%&'*+\-.^_`|~0-9A-Za-z]+)*")


def is_handshake(headers: Sequence[tuple[bytes, bytes]]) -> bool:
    """Whether the headers of a request, their names in small letters, are those of RFC 6455, section 4.1."""
    wanted = (
        b"sec-websocket-key",
        b"sec-websocket-version",
        b"upgrade",
        b"origin",
        b"sec-websocket-protocol",
        b"content-length",
        b"transfer-encoding",
    )
    keys, versions, upgrades, origins, protocols, *bodies = (
        [value for name, value in headers if name == one] for one in wanted
    )
    return (
        not any(bodies)
        and len(keys) == 1
        and _KEY.fullmatch(keys[0]) is not None
        and versions == [b"13"]
        and [value.lower() for value in upgrades] == [b"websocket"]
        and len(origins) <= 1
        and all(map(_PROTOCOLS.fullmatch, protocols))
    )


class WebSocketConnection(WebSocketsSansIOProtocol):
    """A connection that is cut off when its client does not take what it is sent.

    What is sent has gone to the network, but for a little, when `send` returns: so who waits for it knows how
    much is held for a slow client.
    """

    def __init__(
        self,
        config: uvicorn.Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
        *,
        waiting: WaitingConnections,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._waiting = waiting
        self._at_once = 0
        self._early = b""
        """What has come before the handshake is answered: until then uvicorn cannot say what is wrong."""

    def data_received(self, data: bytes) -> None:
        """Take what has come; who sends so many frames that nobody else is served meanwhile is cut off."""
        if self.handshake_initiated and not self.handshake_complete:
            self._early += data
            self.transport.pause_reading()
            return
        self._at_once = 0
        for first in range(0, len(data), _PORTION):
            super().data_received(data[first : first + _PORTION])
            if self.transport.is_closing():
                break

    def handle_events(self) -> None:
        """Take the frames of a portion."""
        self._at_once += len(self.conn.events)
        if self._at_once > MOST_AT_ONCE:
            self._fail(_TOO_MANY, f"more than {MOST_AT_ONCE} frames at once")
        else:
            super().handle_events()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        if isinstance(exc, TimeoutError):  # the kernel's: see TCP_USER_TIMEOUT
            self._waiting.closed(STALLED)
        super().connection_lost(exc)

    def handle_text(self, event: Frame) -> None:
        """Take a text frame, of which nobody wants to know more than that it is one."""
        event.data = b""
        super().handle_text(event)

    def handle_cont(self, event: Frame) -> None:
        """Take the rest of a message, or the next part of it."""
        if self.close_sent:
            return
        if len(self.frames) >= _MAX_FRAMES:
            self._fail(_TOO_BIG, f"a message of more than {_MAX_FRAMES} frames")
            return
        if self.curr_msg_data_type == "text":
            event.data = b""
        super().handle_cont(event)

    def handle_ping(self) -> None:
        """Answer, unless the client takes no answers."""
        super().handle_ping()
        if self.transport.get_write_buffer_size() > _MAX_UNSENT:
            self._cut_off()

    async def send(self, message: Any) -> None:  # noqa: ANN401 - any of ASGI's messages
        """Send a message, and wait until it has gone.

        Raises:
            ClientDisconnected: the client is gone, or does not take it in time.
        """
        try:
            async with asyncio.timeout(self._waiting.limits.stall_time):
                await self.writable.wait()
                if self.close_sent and message["type"] == "websocket.send":
                    raise ClientDisconnected  # closed below the application, which need not know yet
                await super().send(message)
                if message["type"] == "websocket.http.response.body" and self.close_sent:
                    self.handshake_complete = True  # it is refused: uvicorn takes that for a bug
                self._take_early()
                await self.writable.wait()
        except TimeoutError:
            self._cut_off()
            raise ClientDisconnected from None

    def shutdown(self) -> None:
        """Tell the client that the mapper stops, and end."""
        if self.handshake_complete and not self.close_sent and not self.disconnected:
            self.stop_keepalive()
            self.queue.put_nowait({"type": "websocket.disconnect", "code": STOPPING, "reason": ""})
            self.conn.send_close(STOPPING, "the mapper stops")
            self.transport.write(b"".join(self.conn.data_to_send()))
            self.close_sent = True
        super().shutdown()
        self.loop.call_later(_TIME_TO_CLOSE, self.transport.abort)

    def _take_early(self) -> None:
        early, self._early = self._early, b""
        if early and self.handshake_complete and not self.transport.is_closing():
            self.transport.resume_reading()
            self.data_received(early)

    def _fail(self, code: int, reason: str) -> None:
        self._waiting.complain("HTTP", str(code), f"a WebSocket client is cut off: {reason}")
        self.conn.fail(code, reason)
        self.handle_parser_exception()

    def _cut_off(self) -> None:
        if not self.transport.is_closing():
            self._waiting.closed(STALLED)
        self.transport.abort()
