"""Limits of HTTP connections: what one client may cost, and why a connection is closed."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from ogm_services.replies.problems import slug_of

FULL: Final = "full"
STALLED: Final = "stalled"
CLOSED_FOR: Final = (*map(slug_of, (400, 408, 413, 414, 431)), FULL, STALLED)
"""Why connections are closed here: a request that is refused, no room, an answer that nobody takes."""


@dataclass(frozen=True)
class HttpLimits:
    """What one client may cost.

    `head`: bytes of a request's target and headers; `body`: bytes of its body, unless the path, without a
    query, ends with one of `bodies`, which have their own: what is before that may be a proxy's.
    `request_time`: s from the begin of a connection, or its last answer, to the last byte of its next
    request. `stall_time`: s without progress in sending an answer. `connections`: how many are open at once.
    `websockets`: what the paths of WebSockets end with.
    """

    head: int = 64 * 1024
    body: int = 1024
    request_time: float = 60.0
    stall_time: float = 20.0
    connections: int = 1000
    bodies: Mapping[bytes, int] = field(default_factory=dict)
    websockets: tuple[bytes, ...] = ()

    def body_of(self, target: bytes) -> int:
        """Bytes that the body of a request may have."""
        path = target.partition(b"?")[0]
        return next((most for end, most in self.bodies.items() if path.endswith(end)), self.body)
