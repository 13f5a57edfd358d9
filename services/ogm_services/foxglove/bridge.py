"""Foxglove bridge: what a mapper and its robots say, told to viewers."""

import time
from contextlib import ExitStack
from types import TracebackType
from typing import Self

from ogm_client import MapClient
from ogm_services.foxglove.heard_robots import Heard, HeardRobots
from ogm_services.foxglove.map_channel import MapChannel
from ogm_services.foxglove.robot_channels import RobotChannels
from ogm_services.foxglove.server import FoxgloveServer
from ogm_services.foxglove.status_poll import StatusPoll

PERIOD = 0.1
"""Between two messages of robots, s."""
STATUS_PERIOD = 1.0
"""Between two looks at the status, s."""
STATUS_PERIOD_ALONE = 0.5
"""Where nothing else tells where robots are."""


class FoxgloveBridge:
    """Shows a mapper's map and robots on a server, for as long as `step` is called; a context manager."""

    def __init__(
        self, server: FoxgloveServer, client: MapClient, heard: HeardRobots | None, where: str
    ) -> None:
        """`heard`: what robots publish; None: the mapper is asked where they are, and scans are not shown.

        `where` the mapper is, in words.
        """
        self._heard = heard
        self._robots = RobotChannels(server.context)
        server.add_listener(self._robots.subscribed)
        with ExitStack() as opening:
            map_channel = MapChannel(server.context, client)
            opening.callback(map_channel.close)
            server.add_listener(map_channel.subscribed)
            period = STATUS_PERIOD_ALONE if heard is None else STATUS_PERIOD
            self._poll = StatusPoll(client, where, period, server.say_trouble)
            opening.callback(self._poll.close)
            self._open = opening.pop_all()

    def step(self) -> None:
        """Tell what has come since this was called last; every PERIOD, by one thread."""
        heard = Heard() if self._heard is None else self._heard.take()
        self._robots.step(heard, self._poll.take(), time.monotonic())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()
