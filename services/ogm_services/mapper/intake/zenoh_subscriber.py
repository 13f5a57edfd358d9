"""Zenoh subscriber of the mapper, its only one for messages: it counts them and puts them into the queue."""

import logging
import time
from contextlib import ExitStack
from functools import lru_cache, partial

import zenoh

from ogm_core.errors import BadMessage
from ogm_core.placing.reasons import too_many_robots, too_many_sensors
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.scan_placer import ROBOTS, ScanPlacer
from ogm_core.wire.keys import MapKeys, Source
from ogm_core.wire.messages import MAX_POSE_BYTES, check_length, max_scan_bytes
from ogm_services.mapper.intake.overload import Overload
from ogm_services.mapper.intake.queue import Message, ScanQueue
from ogm_services.runtime.limited_log import LimitedLog

REMEMBERED_KEYS = 1000
"""Keys of messages whose sources are remembered; reading one anew does no harm."""
MAX_KEY = 256
"""Longer than any key of a message, characters: such a one is not even remembered."""

log = logging.getLogger(__name__)


class ZenohSubscriber:
    """Takes poses and scans alike, so that their order is kept, until `close`.

    Zenoh's thread calls the callbacks, which count and enqueue, and decode nothing: they would hold up the
    link. They do so where a pose has to wait for room in the queue: that slows down who sends too many. What
    is longer than any message of its kind, a scan of `max_beams` or a pose, is not even copied. The robots'
    liveliness tokens take the same way, so that the worker hears of a robot's end after what came before it.
    """

    def __init__(
        self,
        session: zenoh.Session,
        keys: MapKeys,
        queue: ScanQueue,
        receipts: Receipts,
        placer: ScanPlacer,
        *,
        max_beams: int,
        overload: Overload | None = None,
    ) -> None:
        self._session = session
        self._placer = placer
        self._keys = keys
        self._source_of = lru_cache(REMEMBERED_KEYS)(keys.source_of)
        self._queue = queue
        self._receipts = receipts
        self._max_scan_bytes = max_scan_bytes(max_beams)
        self._overload = overload or Overload(queue, receipts)
        self._complaints = LimitedLog(log)
        self._declared = ExitStack()

    def declare(self) -> None:
        """Declare the subscriber: from here on nothing that is put is missed."""
        tokens = zenoh.handlers.Callback(self._token_changed, indirect=False)
        alive = self._keys.alive("robot", "*", "*")
        self._declared.push(self._session.liveliness().declare_subscriber(alive, tokens, history=True))
        callback = zenoh.handlers.Callback(self._received, indirect=False)
        self._declared.push(self._session.declare_subscriber(self._keys.robots, callback))

    def close(self) -> None:
        """Undeclare it: nothing more comes in."""
        self._declared.close()

    def _received(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        source = self._source_of(key) if len(key) <= MAX_KEY else None
        if source is None or sample.kind != zenoh.SampleKind.PUT:
            self._receipts.ignored()
            return
        now = time.monotonic()
        if self._refused(source, now) or self._too_long(source, len(sample.payload)):
            return
        dropped = self._queue.put(Message(source, sample.payload.to_bytes(), now))
        if dropped:
            self._overload.note(dropped)

    def _token_changed(self, sample: zenoh.Sample) -> None:
        """Have the worker told, after the messages that have come, that a robot's run is there or gone."""
        found = self._keys.robot_of(str(sample.key_expr))
        if found is None:
            return
        now = time.monotonic()
        here = sample.kind == zenoh.SampleKind.PUT
        if here and not self._receipts.admits(found.robot, now):
            self._complaints.warning(ROBOTS, too_many_robots(found.robot).text)
            return
        note = self._placer.robot_here if here else self._placer.robot_gone
        told = partial(note, found.robot, found.run, now)
        self._queue.put(Message(None, b"", now, told, robot=found.robot))

    def _refused(self, source: Source, now: float) -> bool:
        """Count a message; whether it is of one robot, or sensor, too many, so that nothing is kept of it."""
        robot, sensor = source
        if sensor is None:
            taken = self._receipts.pose_received(robot, now)
        else:
            taken = self._receipts.scan_received(robot, sensor, now)
        if taken:
            return False
        if sensor is None or not self._receipts.admits(robot, now):
            self._complaints.warning(ROBOTS, too_many_robots(robot).text)
        else:
            self._complaints.warning(robot, too_many_sensors(sensor).text)
        return True

    def _too_long(self, source: Source, length: int) -> bool:
        """Whether a message cannot be one of its kind, because of its length in bytes; it is counted."""
        robot, sensor = source
        try:
            check_length(length, MAX_POSE_BYTES if sensor is None else self._max_scan_bytes)
        except BadMessage as error:
            if sensor is None:
                self._receipts.pose_noted("malformed")
            else:
                self._receipts.scan_dropped(robot, sensor, "malformed")
            self._complaints.warning(f"{robot}/{sensor or 'pose'}", str(error))
            return True
        return False
