"""Channel of a robot's publisher: one key, and the order of what is sent on it."""

import threading
import time
from contextlib import ExitStack
from typing import Any

import zenoh
from zenoh import ext

from ogm_client.errors import ClientError
from ogm_client.heard import Sent
from ogm_client.zenoh_errors import reason
from ogm_core.wire.messages import MEDIA_TYPE

_NUMBERED = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=None)
"""What is sent is numbered, so that a part of a cache can be asked for; nothing is sent besides."""


class Channel:
    """One key: its publisher, the next `seq`, and the lock under which that is taken and sent.

    With `cache_samples` the last so many messages are kept, for a mapper that asks for what it has missed.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        schema: str,
        congestion: zenoh.CongestionControl,
        cache_samples: int,
    ) -> None:
        encoding = zenoh.Encoding(MEDIA_TYPE).with_schema(schema)
        with ExitStack() as declaring:
            # One with a cache does not tell who listens: a plain one beside it does.
            self.publisher = session.declare_publisher(key, encoding=encoding, congestion_control=congestion)
            declaring.callback(self.publisher.undeclare)
            self._sender: zenoh.Publisher | ext.AdvancedPublisher = self.publisher
            if cache_samples:
                self._sender = ext.declare_advanced_publisher(
                    session,
                    key,
                    encoding=encoding,
                    congestion_control=congestion,
                    cache=ext.CacheConfig(max_samples=cache_samples),
                    sample_miss_detection=_NUMBERED,
                    publisher_detection=True,
                )
                declaring.callback(self._sender.undeclare)
            self._declared = declaring.pop_all()
        self.seq = 0
        self.lock = threading.Lock()
        self.sent = Sent()

    @property
    def matched(self) -> bool:
        """Whether anybody subscribes to the key."""
        status: Any = self.publisher.matching_status  # a MatchingStatus; Zenoh's stub says bool
        return bool(status.matching)

    def put(self, payload: bytes, run: str, seq: int) -> None:
        """Send a message, and remember that it was."""
        try:
            self._sender.put(payload)
        except zenoh.ZError as error:
            raise ClientError(f"{self.publisher.key_expr}: not sent: {reason(error)}") from error
        self.sent.note(run, seq, time.monotonic())

    def close(self) -> None:
        """Withdraw the key; what was kept of it is gone."""
        self._declared.close()
