"""Messages that are held: what came of a robot while its caches are asked, in order of arrival."""

import threading
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from ogm_core.units import MEBIBYTE
from ogm_core.wire.heads import Head
from ogm_core.wire.keys import Source

MAX_BYTES = 64 * MEBIBYTE
"""What may be held of all robots, and the quarter of it of one; past that the oldest is let go of."""
_MESSAGE_BYTES = 400
"""What a held message takes beside its payload, about."""


class Held(NamedTuple):
    """A message that waits until its robot's caches were asked, or a command in its place."""

    source: Source
    payload: bytes
    head: Head | None
    came: float
    """When it came, s."""
    command: Callable[[], object] | None = None


class HeldBytes:
    """Bytes that are held of all robots."""

    def __init__(self) -> None:
        self.all = 0
        self._lock = threading.Lock()

    def count(self, size: int) -> None:
        """Count so many more, or less."""
        with self._lock:
            self.all += size


class HeldMessages:
    """Those of one robot. Who holds its lock changes it."""

    def __init__(self, all_bytes: HeldBytes) -> None:
        self._items: deque[Held] = deque()
        self._seqs: dict[tuple[str | None, str], dict[int, int]] = {}
        """How many of each seq there are, in order of arrival, by sensor and run."""
        self._bytes = 0
        self._all_bytes = all_bytes

    def __bool__(self) -> bool:
        return bool(self._items)

    @property
    def oldest(self) -> Held:
        """The one that came first; there is one."""
        return self._items[0]

    @property
    def too_many(self) -> bool:
        """Whether they are more than may be held, and more than one."""
        too_many = self._bytes > MAX_BYTES / 4 or self._all_bytes.all > MAX_BYTES
        return too_many and len(self._items) > 1

    def append(self, item: Held) -> None:
        """Hold a message."""
        self._items.append(item)
        self._count(item, 1)
        if item.head is not None:
            seqs = self._seqs.setdefault((item.source.sensor, item.head[2]), {})
            seqs[item.head[1]] = seqs.get(item.head[1], 0) + 1

    def pop(self) -> Held:
        """Hold the oldest one no longer."""
        item = self._items.popleft()
        self._count(item, -1)
        if item.head is not None:
            seqs = self._seqs[item.source.sensor, item.head[2]]
            seqs[item.head[1]] -= 1
            if not seqs[item.head[1]]:
                del seqs[item.head[1]]
            if not seqs:
                del self._seqs[item.source.sensor, item.head[2]]
        return item

    def has(self, sensor: str | None, run: str, seq: int) -> bool:
        """Whether a message of that number is among them."""
        return seq in self._seqs.get((sensor, run), ())

    def first(self, sensor: str | None, run: str) -> int | None:
        """The seq of the oldest one of a run; None without any."""
        return next(iter(self._seqs.get((sensor, run), ())), None)

    def _count(self, item: Held, sign: int) -> None:
        size = sign * (len(item.payload) + _MESSAGE_BYTES)
        self._bytes += size
        self._all_bytes.count(size)
