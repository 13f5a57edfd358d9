"""Channels of a robot's publisher: one for each key, and what says that its runs are alive."""

import threading
from contextlib import ExitStack

import zenoh

from ogm_client.channel import Channel
from ogm_client.errors import ClientError
from ogm_client.zenoh_errors import reason
from ogm_core.wire.keys import NAME, MapKeys, Source
from ogm_core.wire.messages import POSE_SCHEMA, SCAN_SCHEMA

POSES_A_SCAN = 5
"""So many times as many poses are kept as scans: scans that are older than all poses would be of no use."""
_MAX_RUNS = 64
"""So many runs of a publisher are said to be alive: its own, and those of messages that it is given."""


class Channels:
    """The channels of one robot, each declared when something is first sent on it. Any thread."""

    def __init__(
        self,
        session: zenoh.Session,
        keys: MapKeys,
        robot: str,
        run: str,
        where: str,
        *,
        reliable: bool,
        cache_samples: int,
    ) -> None:
        """Declare that the robot's `run` is alive. `where` the session is connected to, in words.

        Raises:
            ClientError: the session is closed.
        """
        self._session = session
        self._keys = keys
        self._robot = robot
        self._where = where
        self._congestion = zenoh.CongestionControl.BLOCK if reliable else zenoh.CongestionControl.DROP
        self._cache_samples = cache_samples
        self._lock = threading.Lock()
        self._channels: dict[Source, Channel] = {}
        self._runs = {run}
        self._open = ExitStack()
        self._open.callback(self._declare_alive(run).undeclare)
        self.closed = False

    def pose(self) -> Channel:
        """That of the robot's poses.

        Raises:
            ClientError: all are closed, or the session is.
        """
        key = self._keys.pose(self._robot)
        return self._channel(None, key, POSE_SCHEMA, POSES_A_SCAN * self._cache_samples)

    def scan(self, sensor: str) -> Channel:
        """That of a sensor's scans.

        Raises:
            BadSetting: `sensor` cannot stand in a key.
            ClientError: all are closed, or the session is.
        """
        return self._channel(sensor, self._keys.scan(self._robot, sensor), SCAN_SCHEMA, self._cache_samples)

    def declared(self) -> list[tuple[Source, Channel]]:
        """Those that there are, by what is sent on them."""
        with self._lock:
            return list(self._channels.items())

    def declare_run(self, run: str) -> None:
        """Say that a run other than the publisher's own is alive, too, until all are closed."""
        with self._lock:
            if run in self._runs or self.closed or len(self._runs) >= _MAX_RUNS or not NAME.fullmatch(run):
                return
            self._runs.add(run)
            self._open.callback(self._declare_alive(run).undeclare)

    def close(self) -> None:
        """Withdraw all keys; nothing is declared any more."""
        with self._lock:
            self.closed = True
        self._open.close()

    def _declare_alive(self, run: str) -> zenoh.LivelinessToken:
        alive = self._keys.alive("robot", self._robot, run)
        try:
            return self._session.liveliness().declare_token(alive)
        except zenoh.ZError as error:
            raise ClientError(f"{alive}: not declared {self._where}: {reason(error)}") from error

    def _channel(self, sensor: str | None, key: str, schema: str, cached: int) -> Channel:
        source = Source(self._robot, sensor)
        with self._lock:
            if self.closed:
                raise ClientError(f"{key}: the publisher is closed")
            channel = self._channels.get(source)
            if channel is None:
                try:
                    channel = Channel(self._session, key, schema, self._congestion, cached)
                except zenoh.ZError as error:
                    raise ClientError(f"{key}: cannot publish: {reason(error)}") from error
                self._open.callback(channel.close)
                self._channels[source] = channel
        return channel
