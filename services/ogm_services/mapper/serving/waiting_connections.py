"""HTTP connections that wait for a request: those that have waited for too long are closed."""

import asyncio
from collections.abc import Callable
from typing import Protocol

from ogm_services.mapper.serving.http_limits import FULL, HttpLimits

_ROOM = "for each new one the one is closed that waits longest for a request"


class Connection(Protocol):
    """A connection that may wait."""

    transport: asyncio.Transport

    def close_late(self) -> None:
        """End it: its request has not come in time."""


class WaitingConnections:
    """The connections that wait for a request, whole or the rest of one; who waits longest is the first.

    `closed` is told for which of `CLOSED_FOR` one is closed.
    """

    def __init__(
        self,
        limits: HttpLimits,
        complain: Callable[[str, str, str], None],
        closed: Callable[[str], None],
    ) -> None:
        self.limits = limits
        self.complain = complain
        self.closed = closed
        self._since: dict[Connection, float] = {}

    def add(self, connection: Connection, now: float) -> None:
        """It waits from now on."""
        self._since[connection] = now

    def discard(self, connection: Connection) -> None:
        """It waits no longer."""
        self._since.pop(connection, None)

    def make_room(self, newcomer: Connection) -> None:
        """Close the one that has waited longest; where all others are being answered, the newcomer."""
        self.complain("HTTP", FULL, f"{self.limits.connections} connections are open: {_ROOM}")
        self.closed(FULL)
        longest = next(iter(self._since), newcomer)
        self.discard(longest)
        longest.transport.abort()

    def close_late(self, now: float) -> None:
        """Close those that have waited for too long."""
        late = now - self.limits.request_time
        while self._since:
            connection, since = next(iter(self._since.items()))
            if since > late:
                return
            self.discard(connection)
            connection.close_late()
