"""An HTTP server with a small application and limits of one's own, and raw sockets to talk to it."""

import json
import socket
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field

from starlette.requests import Request
from starlette.responses import Response
from starlette.websockets import WebSocket, WebSocketDisconnect

from ogm_services.mapper.serving.http_limits import HttpLimits
from ogm_services.mapper.serving.http_server import HttpThread, bound_socket

PATIENCE = 30.0
"""How long an answer may take on a busy machine, s."""
BIG = 32 << 20
"""Bytes of /big: more than the buffers of two sockets take."""


@dataclass
class Desk:
    """A running server: where it is, and which requests its application has seen, as (method, path, body).

    `closed` holds for what it has closed connections, and `sent` how long the messages were of which a
    WebSocket's application believes that they are gone.
    """

    address: tuple[str, int]
    http: HttpThread
    seen: list[tuple[str, str, bytes]] = field(default_factory=list)
    closed: list[str] = field(default_factory=list)
    sent: list[int] = field(default_factory=list)

    def connections(self):
        """How many are open."""
        return len(self.http._server.server_state.connections)

    @contextmanager
    def call(self):
        """A fresh connection."""
        with socket.create_connection(self.address, PATIENCE) as sock:
            yield sock

    def say(self, *parts):
        """Every answer to these bytes on a connection of their own, till the server closes it."""
        with self.call() as sock:
            try:
                for part in parts:
                    sock.sendall(part)
            except (ConnectionResetError, BrokenPipeError):
                pass  # it has read enough
            return answers(sock)


@dataclass
class Spoken:
    """An answer as it came."""

    status: int
    headers: dict[str, str]
    body: bytes

    def problem(self):
        """Its status and type, after a look at its form."""
        assert self.headers["content-type"] == "application/problem+json"
        assert self.headers["connection"] == "close"
        told = json.loads(self.body)
        assert told["status"] == self.status
        return self.status, told["type"]


@contextmanager
def http_desk(**limits):
    """Serve / (says the body and header X back), and /big, which is BIG bytes, under HttpLimits(**limits).

    /ws is a WebSocket that says everything back, and to nothing BIG bytes.
    """
    much = bytes(BIG)
    with ExitStack() as stack:
        listener = stack.enter_context(bound_socket("127.0.0.1", 0))

        async def talk(websocket):
            await websocket.accept()
            while (message := await websocket.receive())["type"] == "websocket.receive":
                said = message["text"] if "text" in message else message["bytes"]
                desk.seen.append(("WebSocket", websocket.url.path, said))
                reply = much if said == b"" else said or b"a text"
                await websocket.send_bytes(reply)
                desk.sent.append(len(reply))
            with suppress(WebSocketDisconnect):
                await websocket.send_bytes(b"said too late")

        async def app(scope, receive, send):
            if scope["type"] == "websocket":
                await talk(WebSocket(scope, receive, send))
                return
            request = Request(scope, receive)
            body = await request.body()
            desk.seen.append((request.method, request.url.path, body))
            content = much if request.url.path == "/big" else b"said " + body
            heard = {"Heard": request.headers.get("X", "")}
            await Response(content, headers=heard, media_type="text/plain")(scope, receive, send)

        limits = HttpLimits(websockets=(b"/ws",), **limits)
        http = HttpThread(app, listener, limits, lambda reason: desk.closed.append(reason))
        desk = Desk(listener.getsockname(), http)
        stack.enter_context(http)
        yield desk


def answers(sock):
    """Every answer on a socket, until it is closed."""
    got = []
    with sock.makefile("rb") as file:
        while True:
            answer = answer_from(file)
            if answer is None:
                return got
            got.append(answer)


def answer_from(file):
    """The next answer; None at the end."""
    line = file.readline()
    if not line:
        return None
    headers = {}
    while header := file.readline().strip():
        name, _, value = header.decode("latin-1").partition(":")
        headers[name.lower()] = value.strip()
    return Spoken(int(line.split()[1]), headers, file.read(int(headers.get("content-length", 0))))


def get(path=b"/", *headers, method=b"GET"):
    """A request without a body."""
    return b"\r\n".join([method + b" " + path + b" HTTP/1.1", b"Host: a", *headers, b"", b""])


HANDSHAKE = (
    b"Connection: keep-alive, Upgrade",
    b"Upgrade: websocket",
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
    b"Sec-WebSocket-Version: 13",
)
"""Headers of a request that becomes a WebSocket."""
