"""A link to a router that is cut in the middle of what is sent over it."""

import socket
import threading
from contextlib import suppress


class CutLink:
    """A TCP relay of one connection to `endpoint`; once it is `armed`, few bytes more go there, then none.

    Threads: one for each direction; whichever ends first ends the other.
    """

    def __init__(self, endpoint: str, few: int) -> None:
        host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
        self._there = (host, int(port))
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = "tcp/{}:{}".format(*self._listener.getsockname())
        self._left = few
        self.armed = threading.Event()
        self.cut = threading.Event()
        """Set once bytes were held back: a message has gone in part."""
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        """End, whatever is under way; closing twice does nothing."""
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._end()
        self._thread.join()

    def _run(self) -> None:
        with suppress(OSError):
            self._here, _ = self._listener.accept()
            self._to = socket.create_connection(self._there)
            back = threading.Thread(target=self._copy, args=(self._to, self._here))
            back.start()
            self._copy(self._here, self._to, counted=True)
            back.join()

    def _copy(self, source: socket.socket, to: socket.socket, *, counted: bool = False) -> None:
        with suppress(OSError):
            while data := source.recv(4096):
                if counted and self.armed.is_set():
                    to.sendall(data[: self._left])
                    if len(data) > self._left:
                        self.cut.set()
                        break
                    self._left -= len(data)
                else:
                    to.sendall(data)
        self._end()

    def _end(self) -> None:
        for end in (getattr(self, "_here", None), getattr(self, "_to", None)):
            if end is not None:
                with suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
                end.close()
