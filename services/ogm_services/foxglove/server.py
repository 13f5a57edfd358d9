"""Foxglove server: a WebSocket server of the SDK, whose channels viewers subscribe to."""

import logging
import threading
from collections.abc import Callable

import foxglove
from foxglove import Context
from foxglove.websocket import ChannelView, Client, ServerListener, StatusLevel

from ogm_client.errors import CannotListen

BACKLOG = 8
"""So many messages wait for a viewer at most: of a slow one the oldest go first."""
_OTHER_PORT = ". Is another one running? Choose another port (--port); port 0 takes a free one"

log = logging.getLogger(__name__)


class FoxgloveServer:
    """Serves the channels of `context` from `__init__` to `close`."""

    def __init__(self, name: str, host: str, port: int) -> None:
        """Serve under a name that viewers show; port 0 takes a free one.

        Raises:
            CannotListen: the port is taken, or the address is not this machine's.
        """
        self.context = Context()
        self._listeners: list[Callable[[str], None]] = []
        try:
            self._server = foxglove.start_server(
                name=name,
                host=host,
                port=port,
                context=self.context,
                server_listener=_Listener(self._subscribed),
                message_backlog_size=BACKLOG,
            )
        except RuntimeError as error:
            why = str(error).rpartition("port: ")[2].partition(" (os error")[0]
            hint = _OTHER_PORT if "in use" in why else ""
            raise CannotListen(f"cannot listen on {host}:{port}: {why}{hint}") from error
        self._host = host
        self._told = threading.Lock()
        self._trouble = ""

    @property
    def url(self) -> str:
        """Where viewers connect to."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"ws://{host}:{self._server.port}"

    def add_listener(self, listener: Callable[[str], None]) -> None:
        """Have `listener` told, by a thread of the server, each topic that a viewer subscribes to."""
        self._listeners.append(listener)

    def say_trouble(self, trouble: str) -> None:
        """Have viewers, and the log, say what is wrong; "" when nothing is any more."""
        with self._told:
            if trouble == self._trouble:
                return
            if trouble:
                log.warning("%s", trouble)
                self._server.publish_status(trouble, StatusLevel.Warning, "mapper")
            else:
                log.info("the mapper answers again")
                self._server.remove_status(["mapper"])
            self._trouble = trouble

    def close(self) -> None:
        """Disconnect all viewers."""
        self._server.stop()

    def _subscribed(self, topic: str) -> None:
        for listener in self._listeners:
            listener(topic)


class _Listener(ServerListener):
    def __init__(self, subscribed: Callable[[str], None]) -> None:
        self._subscribed = subscribed

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self._subscribed(channel.topic)
