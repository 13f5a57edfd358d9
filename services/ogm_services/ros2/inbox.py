"""Inbox of messages from all sources, which come in threads of their own; one worker takes them in order."""

import threading
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

MAX_WAITING = 4096
"""Messages that may wait."""
MAX_WAITING_BYTES = 2**28
"""Bytes that may wait: clouds of points are large."""


class Message(NamedTuple):
    """A payload, who handles it, and where it comes from."""

    payload: bytes
    handle: Callable[[bytes], None]
    topic: str


class Inbox:
    """Messages that wait for the worker. When it is full, new scans are refused; transforms never are."""

    def __init__(self) -> None:
        self._waiting: deque[Message] = deque()
        self._bytes = 0
        self._refused: dict[str, int] = {}
        self._changed = threading.Condition()

    def put(self, message: Message, *, always: bool) -> None:
        """Add a message; any thread. `always`: even when it is full."""
        with self._changed:
            full = len(self._waiting) >= MAX_WAITING or self._bytes >= MAX_WAITING_BYTES
            if full and not always:
                self._refused[message.topic] = self._refused.get(message.topic, 0) + 1
                return
            self._waiting.append(message)
            self._bytes += len(message.payload)
            self._changed.notify()

    def get(self, timeout: float) -> Message | None:
        """The next message; None if none comes within `timeout`, s."""
        with self._changed:
            if not self._waiting:
                self._changed.wait(timeout)
            if not self._waiting:
                return None
            message = self._waiting.popleft()
            self._bytes -= len(message.payload)
            return message

    def refused(self) -> dict[str, int]:
        """How many were refused since it was asked last, by topic."""
        with self._changed:
            found, self._refused = self._refused, {}
            return found
