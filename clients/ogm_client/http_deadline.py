"""HTTP connections whose every step ends by a request's deadline.

The timeouts of HTTP libraries are those of one step: who sends a byte now and then is waited for for ever.
"""

import socket
import ssl
import threading
import time
from collections.abc import Iterable, Iterator
from typing import Any

import httpcore
import httpx

DEADLINE = "deadline"
"""The extension of a request that says when its answer has to be there, by `time.monotonic()`."""


class DeadlineTransport(httpx.BaseTransport):
    """Connections that are kept and shared; a request needs the extension DEADLINE.

    It raises httpcore's errors; what comes too late is one of its timeouts, whichever step was on.
    """

    def __init__(self) -> None:
        deadlines = _Deadlines()
        self._deadlines = deadlines
        self._pool = httpcore.ConnectionPool(
            ssl_context=httpx.create_ssl_context(trust_env=False), network_backend=_Network(deadlines)
        )

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        """Send a request; the body of its answer is read by whoever iterates over it, in the same thread."""
        self._deadlines.end = request.extensions[DEADLINE]
        timeouts = {"pool": self._deadlines.left()}
        url = request.url
        answer = self._pool.handle_request(
            httpcore.Request(
                request.method,
                httpcore.URL(scheme=url.raw_scheme, host=url.raw_host, port=url.port, target=url.raw_path),
                headers=request.headers.raw,
                content=request.stream,
                extensions=request.extensions | {"timeout": timeouts},
            )
        )
        return httpx.Response(
            answer.status, headers=answer.headers, stream=_Body(answer), extensions=answer.extensions
        )

    def close(self) -> None:
        """Close all connections."""
        self._pool.close()


class _Deadlines(threading.local):
    """When the answer that this thread waits for has to be there."""

    end = 0.0

    def left(self, late: type[Exception] = httpcore.PoolTimeout) -> float:
        """How long it may still take, s; raises `late` once it is over."""
        left = self.end - time.monotonic()
        if left <= 0.0:
            raise late("the deadline is over")
        return left


class _Body(httpx.SyncByteStream):
    def __init__(self, answer: httpcore.Response) -> None:
        self._answer = answer

    def __iter__(self) -> Iterator[bytes]:
        return self._answer.iter_stream()

    def close(self) -> None:
        self._answer.close()


class _Network(httpcore.NetworkBackend):
    def __init__(self, deadlines: _Deadlines) -> None:
        self._deadlines = deadlines
        self._network = httpcore.SyncBackend()

    def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[Any] | None = None,
    ) -> httpcore.NetworkStream:
        try:
            addresses = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        except OSError as error:
            raise httpcore.ConnectError(str(error)) from error
        # They are tried one after the other: each has its share of the time.
        timeout = self._deadlines.left(httpcore.ConnectTimeout) / len(addresses)
        stream = self._network.connect_tcp(host, port, timeout, local_address, socket_options)
        return _Stream(stream, self._deadlines)


class _Stream(httpcore.NetworkStream):
    def __init__(self, stream: httpcore.NetworkStream, deadlines: _Deadlines) -> None:
        self._stream = stream
        self._deadlines = deadlines

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        return self._stream.read(max_bytes, self._deadlines.left(httpcore.ReadTimeout))

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        self._stream.write(buffer, self._deadlines.left(httpcore.WriteTimeout))

    def start_tls(
        self, ssl_context: ssl.SSLContext, server_hostname: str | None = None, timeout: float | None = None
    ) -> httpcore.NetworkStream:
        left = self._deadlines.left(httpcore.ConnectTimeout)
        return _Stream(self._stream.start_tls(ssl_context, server_hostname, left), self._deadlines)

    def close(self) -> None:
        self._stream.close()

    def get_extra_info(self, info: str) -> Any:  # noqa: ANN401 - whatever is asked
        return self._stream.get_extra_info(info)
