"""Channel of a robot's publisher: one key, and the order of what is sent on it."""

import threading
import time
from typing import Any

import zenoh

from ogm_client.errors import ClientError
from ogm_client.heard import Sent
from ogm_client.zenoh_errors import reason


class Channel:
    """One key: its publisher, the next `seq`, and the lock under which that is taken and sent."""

    def __init__(self, publisher: zenoh.Publisher) -> None:
        self.publisher = publisher
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
            self.publisher.put(payload)
        except zenoh.ZError as error:
            raise ClientError(f"{self.publisher.key_expr}: not sent: {reason(error)}") from error
        self.sent.note(run, seq, time.monotonic())
