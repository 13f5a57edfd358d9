"""Bounded queue of messages between Zenoh's callback and the worker, fair to robots."""

import threading
import time
from collections import deque
from collections.abc import Callable

from ogm_core.units import MEBIBYTE
from ogm_core.wire.keys import Source
from ogm_services.mapper.intake.largest import Largest
from ogm_services.mapper.intake.load import QueueLoad
from ogm_services.mapper.intake.message import Message

MAX_BYTES = 256 * MEBIBYTE
"""Payload that may wait, whatever the number of scans, unless there is less memory."""
MAX_POSES = 100_000
"""Poses are never dropped: past this many waiting, or their part of the bytes, their sender waits."""
MAX_POSES_OF_ROBOT = 10_000
"""The same for those of one robot: whoever floods waits for room of its own."""
BEHIND = 1.0
"""Once a message has waited for so long, s, it is looked at how large the scans are that wait."""
LOOKS = 64
"""So many scans, or LOOKS_BYTES of them, are looked at in one go."""
LOOKS_BYTES = 4 * MEBIBYTE


class ScanQueue:
    """Messages in order of arrival. Callbacks put, one worker takes, and says how long each has taken.

    One lock, held while a message is put or taken, and while it is looked how large some of the scans are
    that wait: LOOKS or LOOKS_BYTES of them. Who puts a pose waits for room, without the lock.

    Past a bound the robot with the largest share of the queue loses its oldest scan, however many sensors it
    names. Its share is that of the work, the bytes or the scans that may wait, whichever is largest (dominant
    resource fairness, Ghodsi et al. 2011): a robot of few large scans loses none to many small ones.

    `cells_of` tells how large a scan is. A queue that is worked off as it comes does not ask.
    """

    def __init__(
        self,
        max_scans: int,
        cells_of: Callable[[Source, bytes], float] | None = None,
        max_bytes: int = MAX_BYTES,
        dropping: Callable[[Source, bytes], None] = lambda *_: None,
    ) -> None:
        """`dropping` is told, under the lock, of every scan that has to go: its source and payload."""
        self.max_bytes = max_bytes
        """Payload that may wait: a fifth of it is room for poses, the rest for scans."""
        self._max_pose_bytes = max_bytes // 5
        self.max_scans = max_scans
        """Scans that may wait."""
        self._dropping = dropping
        self._cells_of = cells_of or (lambda *_: 1.0)
        self._unseen: deque[Message] = deque()
        """Waiting scans whose size nobody has looked at, and maybe dropped ones; oldest first."""
        self._behind = False
        self._lock = threading.Lock()
        self._came = threading.Condition(self._lock)
        self._room = threading.Condition(self._lock)
        self._waiting_for_room = 0
        self._items: deque[Message] = deque()
        self._load = QueueLoad(max_scans, max_bytes - self._max_pose_bytes)
        self._largest: Largest | None = None
        """By share, while the queue is full or was a moment ago."""
        self._closed = False

    @property
    def bytes(self) -> int:
        """Payload of the scans and poses that wait."""
        return self._load.all.size + self._load.all.pose_size

    @property
    def work(self) -> float:
        """How long the scans that wait will take, about, s."""
        return self._load.all.work

    @property
    def behind(self) -> bool:
        """Whether messages wait for so long that it matters whose they are, and how long they take."""
        return self._behind

    @property
    def scans(self) -> int:
        """How many scans wait."""
        return self._load.all.scans

    def put(self, item: Message) -> list[Source]:
        """Append a message; return the source of every scan that had to go for it."""
        source = item.source
        with self._lock:
            gone: list[Source] = []
            if source is not None and source.sensor is not None:
                self._items.append(item)
                self._load.add_scan(source.robot, item)
                if item.cells is None:
                    self._unseen.append(item)
                gone = self._make_room(source.robot)
            else:
                name = item.sender
                if name is not None:
                    self._wait_for_room(name, len(item.payload))
                    self._load.add_pose(name, item)
                self._items.append(item)
            self._came.notify()
            return gone

    def take(self, timeout: float | None) -> Message | None:
        """The oldest message; None if none came within `timeout` seconds, or the queue is closed."""
        with self._lock:
            if not self._skip_dropped():
                self._came.wait_for(lambda: self._skip_dropped() or self._closed, timeout)
            if self._closed or not self._items:
                return None
            item = self._items.popleft()
            self._behind = time.monotonic() - item.arrival > BEHIND
            source = item.source
            if source is not None and source.sensor is not None:
                self._load.remove_first_scan(source.robot)
                while item.cells is None and self._unseen.popleft() is not item:
                    pass  # one that was dropped
                if self._largest is not None and self._load.part(self._load.all) <= 0.5:
                    self._largest = None
            elif item.sender is not None:
                self._load.remove_pose(item.sender, item)
                if self._waiting_for_room:
                    self._room.notify_all()
            return item

    def worked(self, item: Message, seconds: float) -> list[Source]:
        """Learn how long a message took, s; return the source of every scan that has to go for it.

        It need not be told while the queue is not `behind`.
        """
        name = item.sender
        if name is None:
            return []
        with self._lock:
            if item.source is None or item.source.sensor is None:
                self._load.robot(name).posing += seconds
                return []
            cells = self._cells_of(item.source, item.payload) if item.cells is None else item.cells
            self._load.measured(name, cells, seconds)
            return self._make_room(name)

    def has_room(self, name: str, part: float) -> bool:
        """Whether a message of a robot may be resumed: none of it waits, or less than a part of each bound.

        Less than that part, too, of all that is resumed. It is looked how large scans are, a few at a time:
        who fills the queue in one go asks before each.
        """
        with self._lock:
            mine, resumed = self._load.robots.get(name), self._load.resumed
            if self._closed or mine is None or not (mine.scans or mine.poses):
                return True
            self._look()
            return (
                mine.poses < part * MAX_POSES_OF_ROBOT
                and resumed.poses < part * MAX_POSES
                and self._load.share(name) < part
                and self._load.part(resumed) < part
            )

    def close(self) -> None:
        """Let everyone who waits go on; nothing is taken any more."""
        with self._lock:
            self._closed = True
            self._came.notify_all()
            self._room.notify_all()

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._closed

    def _skip_dropped(self) -> bool:
        while self._items and self._items[0].dropped:
            self._items.popleft()
        return bool(self._items)

    def _wait_for_room(self, name: str, length: int) -> None:
        if not self._has_room(name, length):
            self._waiting_for_room += 1
            self._room.wait_for(lambda: self._has_room(name, length))
            self._waiting_for_room -= 1

    def _has_room(self, name: str, length: int) -> bool:
        """Whether a pose of this length may be put."""
        waits = self._load.all
        full = waits.poses >= MAX_POSES or self._load.robot(name).poses >= MAX_POSES_OF_ROBOT
        too_large = waits.poses > 0 and waits.pose_size + length > self._max_pose_bytes
        return self._closed or not (full or too_large)

    def _look(self) -> None:
        """Look how large some of the scans are that wait."""
        size = 0
        for _ in range(min(LOOKS, len(self._unseen))):
            item = self._unseen.popleft()
            if item.dropped or item.source is None:
                continue
            item.cells = self._cells_of(item.source, item.payload)
            name = item.source.robot
            self._load.looked(name, item)
            if self._largest is not None:
                self._largest.grew(name)
            size += len(item.payload)
            if size > LOOKS_BYTES:
                break

    def _make_room(self, name: str) -> list[Source]:
        """Drop scans until no bound is passed; one at least stays. `name`: whose share may have grown."""
        gone: list[Source] = []
        if self._unseen and self._items:
            waited = self._unseen[-1].arrival - self._items[0].arrival
            if self._behind or waited > BEHIND:
                self._look()
        if self._largest is not None:
            self._largest.grew(name)
        while self._load.all.scans > 1 and self._load.part(self._load.all) > 1.0:
            if self._largest is None:
                self._largest = Largest(self._load.share, self._load.robots)
            item = self._load.remove_first_scan(self._largest.name())
            assert item.source is not None
            self._dropping(item.source, item.payload)
            item.dropped, item.payload = True, b""
            gone.append(item.source)
        return gone
