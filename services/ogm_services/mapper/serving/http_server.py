"""The HTTP server below the application: its socket, and uvicorn in a thread of its own."""

import asyncio
import logging
import socket
import threading

import uvicorn
from starlette.types import ASGIApp

from ogm_core.errors import OgmError

GRACE = 2
"""How long open HTTP connections may take to finish when the mapper stops, s."""


class CannotServe(OgmError):
    """The HTTP address cannot be used."""

    slug = "cannot-serve"


class HttpThread:
    """uvicorn beside the main thread, which keeps the signals to itself."""

    def __init__(self, app: ASGIApp, listener: socket.socket) -> None:
        logging.getLogger("uvicorn.error").addFilter(_not_cut_off)
        config = uvicorn.Config(
            app, log_config=None, access_log=False, lifespan="off", timeout_graceful_shutdown=GRACE
        )
        self._server = uvicorn.Server(config)
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
