"""The HTTP server below the application: its socket, and uvicorn in a thread of its own."""

import asyncio
import dataclasses
import logging
import math
import resource
import socket
import threading
from collections.abc import Callable

import uvicorn
from starlette.types import ASGIApp

from ogm_core.errors import OgmError
from ogm_services.mapper.serving.http_connection import connection_type
from ogm_services.mapper.serving.http_limits import HttpLimits
from ogm_services.mapper.serving.waiting_connections import WaitingConnections
from ogm_services.mapper.serving.websocket_connection import MAX_MESSAGE, PING_PERIOD
from ogm_services.runtime.limited_log import LimitedLog

GRACE = 2
"""How long open HTTP connections may take to finish when the mapper stops, s."""

SPARE_FILES = 4
"""Descriptors that are asked of the system, for each HTTP connection; half of them are left to all else."""

log = logging.getLogger(__name__)


class CannotServe(OgmError):
    """The HTTP address cannot be used."""

    slug = "cannot-serve"


class HttpThread:
    """uvicorn beside the main thread, which keeps the signals to itself."""

    def __init__(
        self,
        app: ASGIApp,
        listener: socket.socket,
        limits: HttpLimits | None = None,
        closed: Callable[[str], None] = lambda _: None,
    ) -> None:
        """`closed` is told for which of `CLOSED_FOR` a connection is closed, by this thread."""
        limits = _affordable(limits or HttpLimits())
        waiting = WaitingConnections(limits, LimitedLog(log).of_kind, closed)
        # Connections inherit it. It ends those, too, whose clients are well and do not read.
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            stall = round(1000 * limits.stall_time)
            listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, stall)
        logging.getLogger("uvicorn.error").addFilter(_not_cut_off)
        config = uvicorn.Config(
            app,
            http=connection_type(waiting),
            ws="none",  # see HttpConnection, which alone knows what becomes a WebSocket
            ws_max_size=MAX_MESSAGE,
            ws_ping_interval=PING_PERIOD,
            ws_ping_timeout=PING_PERIOD,
            ws_per_message_deflate=False,  # tiles are compressed already
            log_config=None,
            access_log=False,
            proxy_headers=False,  # whoever asks from this machine, or through a proxy on it, could write them
            lifespan="off",
            timeout_keep_alive=math.ceil(limits.request_time),
            timeout_graceful_shutdown=GRACE,
        )
        self._server = _Server(config, waiting)
        self._thread = threading.Thread(target=self._server.run, args=([listener],), name="ogm-http")

    @property
    def alive(self) -> bool:
        """Whether anybody is answered."""
        return self._thread.is_alive()

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._server.should_exit = True
        self._thread.join()


class _Server(uvicorn.Server):
    """uvicorn that looks, ten times a second, for connections that have waited for too long."""

    def __init__(self, config: uvicorn.Config, waiting: WaitingConnections) -> None:
        super().__init__(config)
        self._waiting = waiting

    async def on_tick(self, counter: int) -> bool:
        self._waiting.close_late(asyncio.get_running_loop().time())
        return await super().on_tick(counter)


def _affordable(limits: HttpLimits) -> HttpLimits:
    """Limits with at most half of the file descriptors for HTTP, after asking the system for more."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = SPARE_FILES * limits.connections
    if hard != resource.RLIM_INFINITY:
        wanted = min(wanted, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    connections = min(limits.connections, max(1, wanted // 2))
    if connections < limits.connections:
        log.warning(
            "at most %d HTTP connections: this process may open %d files (ulimit -n); %d would do",
            *(connections, wanted, SPARE_FILES * limits.connections),
        )
    return dataclasses.replace(limits, connections=connections)


def _not_cut_off(record: logging.LogRecord) -> bool:
    """Whether a log record is no traceback of a request that was cut off when the mapper stopped."""
    return not (record.exc_info and isinstance(record.exc_info[1], asyncio.CancelledError))


def bound_socket(host: str, port: int) -> socket.socket:
    """A listening TCP socket; port 0 picks a free one.

    Raises:
        CannotServe: the address is taken, or is not this machine's.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind, protocol)
    except OSError as error:
        raise CannotServe(f"--http-host {host}: {error.strerror}") from error
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(128)
    except OSError as error:
        listener.close()
        raise CannotServe(
            f"--http-host {host} --http-port {port}: cannot serve: {error.strerror}; port 0 picks a free one"
        ) from error
    return listener
