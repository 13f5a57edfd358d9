"""Reception of messages: they are counted, and put into the queue, or refused."""

import logging
import time
from collections.abc import Mapping

from ogm_core.errors import BadMessage
from ogm_core.placing.reasons import too_many_robots, too_many_sensors
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.scan_placer import ROBOTS
from ogm_core.wire.keys import Source
from ogm_core.wire.messages import MAX_POSE_BYTES, check_length, max_scan_bytes
from ogm_services.mapper.intake.handing_on import WhyLost
from ogm_services.mapper.intake.message import Message
from ogm_services.mapper.intake.overload import Overload
from ogm_services.mapper.intake.queue import ScanQueue
from ogm_services.runtime.limited_log import LimitedLog

_WHY_LOST: Mapping[WhyLost, str] = {
    "not kept": "they did not arrive, and no publisher of the robot keeps them",
    "no answer": "they did not arrive, and publishers of the robot that may keep them did not answer",
    "not held": "more came than is held while the robot's publishers are asked, and without a number",
}

log = logging.getLogger(__name__)


class Reception:
    """Takes messages for the queue. Any thread; a pose waits until the queue has room for it."""

    def __init__(
        self,
        queue: ScanQueue,
        receipts: Receipts,
        *,
        max_beams: int,
        overload: Overload | None = None,
    ) -> None:
        self._queue = queue
        self._receipts = receipts
        self._max_scan_bytes = max_scan_bytes(max_beams)
        self._overload = overload or Overload(queue, receipts)
        self._complaints = LimitedLog(log)

    def hand_on(self, source: Source, payload: bytes, *, resumed: bool = False) -> None:
        """Count a message, and put it into the queue, unless it is of one robot or sensor too many.

        `resumed`: it was missed before, or held back.
        """
        now = time.monotonic()
        if self._refused(source, now):
            return
        dropped = self._queue.put(Message(source, payload, now, resumed=resumed))
        if dropped:
            self._overload.note(dropped)

    def longest(self, source: Source) -> int:
        """How long a source's messages may be, bytes."""
        return MAX_POSE_BYTES if source.sensor is None else self._max_scan_bytes

    def refuse_long(self, source: Source, length: int) -> None:
        """Count a message that cannot be one of its kind, because of its length in bytes."""
        if self._refused(source, time.monotonic()):
            return
        robot, sensor = source
        if sensor is None:
            self._receipts.pose_noted("malformed")
        else:
            self._receipts.scan_dropped(robot, sensor, "malformed")
        try:
            check_length(length, self.longest(source))
        except BadMessage as error:
            self._complaints.warning(f"{robot}/{sensor or 'pose'}", str(error))

    def admits(self, robot: str) -> bool:
        """Whether messages of a robot are taken, or it is one too many."""
        return self._receipts.admits(robot, time.monotonic())

    def has_room(self, robot: str, part: float) -> bool:
        """Whether nothing waits of a robot, or what is resumed takes less than a part of the queue."""
        return self._queue.has_room(robot, part)

    def lost(self, source: Source, count: int, run: str, seqs: range, why: WhyLost) -> None:
        """Count messages that cannot be had any more, and say which, and why."""
        robot, sensor = source
        what = "scans" if sensor is not None else "poses"
        which = f", of seq {seqs[0]} to {seqs[-1]} of run {run!r}" if seqs else ""
        self._complaints.warning(
            f"{robot}/{sensor or 'pose'}", f"{count} {what} are lost{which}: {_WHY_LOST[why]}"
        )
        if sensor is None:
            self._receipts.pose_lost(count)
        else:
            self._receipts.scan_lost(robot, sensor, count)

    def replayed(self, source: Source) -> None:
        """Count a message that came again."""
        if source.sensor is None:
            self._receipts.pose_replayed()
        else:
            self._receipts.scan_replayed()

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
