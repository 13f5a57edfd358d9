"""HTTP connections below the application: which requests it ever sees, and how long who is waited for.

uvicorn's connection over httptools, whose grammar is strict, with what that lacks: sizes, deadlines, Host.
"""

import asyncio
import http
from typing import Any, cast

import httptools
import uvicorn
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.server import ServerState

from ogm_core.units import MEBIBYTE
from ogm_services.mapper.serving.http_limits import STALLED
from ogm_services.mapper.serving.waiting_connections import WaitingConnections
from ogm_services.mapper.serving.websocket_connection import WebSocketConnection, is_handshake
from ogm_services.replies.problems import MEDIA_TYPE, problem, slug_of

LINGER = 2.0
"""How long a refused client may take to read why, s: closing a socket with unread bytes loses the answer."""
MAX_DISCARDED = MEBIBYTE
"""Bytes that a refused client may go on to send until it is cut off."""
MAX_PIPELINED = 16
"""Requests of one connection that may wait for the answers to those before them."""
FRAMING = 16
"""Bytes of a chunked body's frames, for each byte that a body may have."""


class _Refused(Exception):
    """A request that the application does not see: its status code, and what is wrong."""

    def __init__(self, status: int, detail: str) -> None:
        super().__init__(detail)
        self.status = status


class HttpConnection(HttpToolsProtocol):
    """A connection whose requests reach the application when they are whole, small and well-formed.

    Any other request is answered here with a problem, read no further, and its connection closed.
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
        self._limits = waiting.limits
        self._waiting = waiting
        self._begun = False
        self._received = 0  # bytes since the last request that was whole
        self._refused = False
        self._discarded = 0
        self._head = 0
        self._head_is_whole = False
        self._body = b""
        self._most = waiting.limits.body  # bytes of the body of this request

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Make room for it if there is none."""
        super().connection_made(transport)
        self._waiting.add(self, self.loop.time())
        if len(self.connections) > self._limits.connections:
            self._waiting.make_room(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        self._waiting.discard(self)
        if isinstance(exc, TimeoutError):  # the kernel's: see TCP_USER_TIMEOUT
            self._waiting.closed(STALLED)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Parse what has come; see the callbacks below."""
        self._unset_keepalive_if_required()
        if self._refused:
            self._discarded += len(data)
            if self._discarded > MAX_DISCARDED:
                self.transport.abort()
            return
        self._received += len(data)
        try:
            self.parser.feed_data(data)
            self._check_received()
        except httptools.HttpParserUpgrade as upgrade:
            # What follows is of another protocol.
            if self._should_upgrade():
                self._upgrade(data[upgrade.args[0] :])
            else:
                self._hang_up_after_answer()
        except httptools.HttpParserCallbackError as error:
            refused = error.__context__
            if not isinstance(refused, _Refused):
                raise
            self._refuse(refused)
        except httptools.HttpParserError as error:
            self._refuse(_Refused(400, f"this is not HTTP/1.1: {error}"))
        except _Refused as refused:
            self._refuse(refused)

    def close_late(self) -> None:
        """End a connection whose request has not come in time."""
        if self._refused:
            self.transport.abort()
        elif self._begun:
            seconds = self._limits.request_time
            self._refuse(_Refused(408, f"the request was not whole within {seconds:g} s"))
        else:
            self.transport.close()

    # The parser's callbacks, in the order in which they come. uvicorn's own on_headers_complete, which hands
    # the request to the application, waits for the end of the body.

    def on_message_begin(self) -> None:
        """Begin a request."""
        super().on_message_begin()
        self._begun, self._head, self._head_is_whole, self._body = True, 0, False, b""
        self._most = self._limits.body

    def on_url(self, url: bytes) -> None:
        """Take a part of the target."""
        super().on_url(url)
        self._count(len(url), 414)

    def on_header(self, name: bytes, value: bytes) -> None:
        """Take a header. Trailers are none: they must not pass for headers that were looked at."""
        if not self._head_is_whole:
            super().on_header(name, value)
            self._count(len(name) + len(value) + len(": \r\n"), 431)

    def on_headers_complete(self) -> None:
        """Look at the headers, and whether they announce too much."""
        self._head_is_whole = True
        length = self._checked_length()
        self._most = self._limits.body_of(self.url)
        if length > self._most:
            raise self._body_too_large()
        if self.expect_100_continue and not self._answering:
            self.transport.write(b"HTTP/1.1 100 Continue\r\n\r\n")
        self.expect_100_continue = False

    def on_body(self, body: bytes) -> None:
        """Take a part of the body."""
        self._body += body
        if len(self._body) > self._most:
            raise self._body_too_large()

    def on_message_complete(self) -> None:
        """Hand the request to the application."""
        if len(self.pipeline) >= MAX_PIPELINED:
            raise _Refused(400, f"more than {MAX_PIPELINED} requests wait on one connection")
        self._begun, self._received = False, 0
        super().on_headers_complete()
        if self._body:
            super().on_body(self._body)
        super().on_message_complete()
        self._waiting.discard(self)

    def on_response_complete(self) -> None:
        """Wait for the next request, if none has come yet."""
        super().on_response_complete()
        if not self._answering and not self.transport.is_closing():
            self._waiting.add(self, self.loop.time())

    def _should_upgrade(self) -> bool:
        """Whether the request becomes a WebSocket; any other is answered as if it asked for no upgrade."""
        path = self.url.partition(b"?")[0]
        return (
            path.endswith(self._limits.websockets)
            and self.parser.get_method() == b"GET"
            and self.parser.get_http_version() == "1.1"
            and not self._answering
            and is_handshake(self.headers)
        )

    def _upgrade(self, rest: bytes) -> None:
        """Go on as a WebSocket, with what has come already."""
        made = WebSocketConnection(self.config, self.server_state, self.app_state, waiting=self._waiting)
        lines = [b": ".join(header) for header in self.headers]
        made.connection_made(self.transport)
        made.data_received(b"\r\n".join((b"GET " + self.url + b" HTTP/1.1", *lines, b"", b"")))
        if not made.handshake_initiated:
            self.connections.discard(made)
            self._refuse(_Refused(431, "a WebSocket's handshake has at most 128 headers, of 8 KiB each"))
            return
        self.connections.discard(self)
        self.transport.set_protocol(made)
        if rest:
            made.data_received(rest)

    @property
    def _answering(self) -> bool:
        """Whether a request has come whose answer is not yet given."""
        return self.cycle is not None and not self.cycle.response_complete

    def _count(self, more: int, status: int) -> None:
        self._head += more
        if self._head > self._limits.head:
            raise self._head_too_large(status)

    def _check_received(self) -> None:
        """Whether parts of which the parser tells only when they have ended, if ever, are too long."""
        if self._received > self._limits.head + FRAMING * self._most:
            raise self._body_too_large() if self._head_is_whole else self._head_too_large(431)

    def _checked_length(self) -> int:
        """Content-Length, 0 if there is none.

        httptools has seen to the rest: folded lines, bytes that no header may have, lengths that contradict
        each other or a Transfer-Encoding.
        """
        version = self.parser.get_http_version()
        if version not in ("1.1", "1.0"):
            raise _Refused(400, f"HTTP/{version} is not spoken here: use HTTP/1.1")
        if not self.url.startswith(b"/") or b"#" in self.url:
            raise _Refused(400, "the target must be a path, with a query or without: /map.png?max_size=500")
        hosts, length = 0, 0
        for name, value in self.headers:
            if name == b"host":
                hosts += 1
            elif name == b"content-length":
                length = int(value)
            elif name == b"transfer-encoding" and (version == "1.0" or value.strip().lower() != b"chunked"):
                raise _Refused(400, "Transfer-Encoding may be chunked, in HTTP/1.1, and nothing else")
        if hosts > 1 or (not hosts and version == "1.1"):
            raise _Refused(400, f"a request has one Host header, this one has {hosts}")
        return length

    def _head_too_large(self, status: int) -> _Refused:
        return _Refused(status, f"target and headers are longer than {self._limits.head} bytes")

    def _body_too_large(self) -> _Refused:
        return _Refused(413, f"the body is longer than {self._most} bytes")

    def _hang_up_after_answer(self) -> None:
        self._refused = True
        self.cycle.keep_alive = False

    def _refuse(self, refused: _Refused) -> None:
        self._waiting.complain("HTTP", str(refused.status), f"a request is refused: {refused}")
        self._waiting.closed(slug_of(refused.status))
        if self._answering:  # an answer that is under way is not torn
            self._hang_up_after_answer()
            return
        self._refused = True
        body = problem(slug_of(refused.status), refused.status, str(refused))
        head = (
            f"HTTP/1.1 {refused.status} {http.HTTPStatus(refused.status).phrase}\r\n"
            f"Content-Type: {MEDIA_TYPE}\r\nContent-Length: {len(body)}\r\n"
            "Cache-Control: no-store\r\nConnection: close\r\n\r\n"
        )
        self.transport.write(head.encode() + body)
        self.transport.write_eof()
        self.loop.call_later(LINGER, self.transport.abort)


def connection_type(waiting: WaitingConnections) -> type[asyncio.Protocol]:
    """What uvicorn makes its connections of."""

    def connection(**arguments: Any) -> HttpConnection:  # noqa: ANN401 (uvicorn's own)
        return HttpConnection(**arguments, waiting=waiting)

    return cast("type[asyncio.Protocol]", connection)
