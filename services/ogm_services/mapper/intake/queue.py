"""Bounded queue of messages between Zenoh's callback and the worker."""

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from ogm_core.wire.keys import Source

MAX_BYTES = 256 * 1024**2
"""Payload that may wait, whatever the number of scans."""
MAX_POSES = 100_000
"""Poses are never dropped: past this many waiting, or MAX_BYTES of them, their sender is made to wait."""


@dataclass(slots=True, eq=False)
class Message:
    """A message's payload and where it came from, or a command for the worker."""

    source: Source | None
    payload: bytes
    arrival: float
    """When it came, s of the monotonic clock."""
    command: Callable[[], None] | None = None
    dropped: bool = False


@dataclass(slots=True)
class _Load:
    scans: dict[Source, deque[Message]] = field(default_factory=dict)
    """Waiting scans by source, oldest first."""
    count: int = 0
    size: int = 0
    poses: int = 0
    pose_size: int = 0

    def add_scan(self, source: Source, item: Message) -> None:
        queue = self.scans.get(source)
        if queue is None:
            queue = self.scans[source] = deque()
        queue.append(item)
        self.count += 1
        self.size += len(item.payload)

    def takes_poses(self) -> bool:
        return self.poses < MAX_POSES and self.pose_size < MAX_BYTES


class ScanQueue:
    """Messages in order of arrival. Callbacks put, one worker takes.

    When it is full, the oldest scan of the source with the most waiting scans goes.
    """

    def __init__(self, max_scans: int) -> None:
        self._max_scans = max_scans
        self._changed = threading.Condition()
        self._items: deque[Message] = deque()
        self._load = _Load()
        self._closed = False

    def put(self, item: Message) -> list[Source]:
        """Append a message; return the source of every scan that had to go for it."""
        with self._changed:
            load = self._load
            if item.source is not None and item.source.sensor is None:
                self._changed.wait_for(lambda: load.takes_poses() or self._closed)
                load.poses += 1
                load.pose_size += len(item.payload)
            elif item.source is not None:
                load.add_scan(item.source, item)
            self._items.append(item)
            gone = []
            while load.count > self._max_scans or (load.size > MAX_BYTES and load.count > 1):
                gone.append(self._drop_oldest())
            self._changed.notify_all()
            return gone

    def take(self, timeout: float | None) -> Message | None:
        """The oldest message; None if none came within `timeout` seconds, or the queue is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._skip_dropped() or self._closed, timeout)
            if self._closed or not self._items:
                return None
            item = self._items.popleft()
            self._forget(item)
            self._changed.notify_all()
            return item

    def close(self) -> None:
        """Let everyone who waits go on; nothing is taken any more."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._closed

    def _skip_dropped(self) -> bool:
        while self._items and self._items[0].dropped:
            self._items.popleft()
        return bool(self._items)

    def _forget(self, item: Message) -> None:
        load = self._load
        if item.source is None:
            return
        if item.source.sensor is None:
            load.poses -= 1
            load.pose_size -= len(item.payload)
            return
        queue = load.scans[item.source]
        queue.popleft()
        if not queue:
            del load.scans[item.source]
        load.count -= 1
        load.size -= len(item.payload)

    def _drop_oldest(self) -> Source:
        source, queue = max(self._load.scans.items(), key=lambda entry: len(entry[1]))
        item = queue[0]
        self._forget(item)
        item.dropped, item.payload = True, b""
        return source
