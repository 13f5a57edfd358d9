"""Overload of the mapper: scans that its queue had to drop, counted, and told with their rate."""

import logging
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ogm_core.placing.receipts import Receipts
from ogm_core.placing.rules import MAX_ROBOTS
from ogm_core.wire.keys import Source
from ogm_services.mapper.intake.queue import ScanQueue

PERIOD = 10.0
"""Each robot is told of at most this often, s."""
CURE = (
    "send fewer scans or beams, or let the map take less time for them "
    "(reach, clear_range, a larger resolution, sensor_model)"
)

log = logging.getLogger(__name__)


@dataclass(slots=True)
class _Told:
    at: float
    """When the last line was logged, s."""
    last: float
    """When its last scan was dropped, s."""
    dropped: int = 0
    """Scans since the line."""


class Overload:
    """Counts scans that the queue dropped, and logs how many of which robot. Any thread."""

    def __init__(
        self,
        queue: ScanQueue,
        receipts: Receipts,
        clock: Callable[[], float] = time.monotonic,
        *,
        cure: str = CURE,
    ) -> None:
        """`cure`: what the log says that helps."""
        self._cure = cure
        self._queue = queue
        self._receipts = receipts
        self._clock = clock
        self._lock = threading.Lock()
        self._told: dict[str, _Told] = {}

    def note(self, dropped: Sequence[Source]) -> None:
        """Count the scans that were dropped; log it if their robots were not told of for a while."""
        for source in dropped:
            assert source.sensor is not None
            self._receipts.scan_dropped(source.robot, source.sensor, "overload")
            line = self._line(source)
            if line is not None:
                log.warning("%s", line)

    def _line(self, source: Source) -> str | None:
        with self._lock:
            now, robot = self._clock(), source.robot
            told = self._told.pop(robot, None)
            if told is None or now - told.last >= PERIOD:
                if len(self._told) >= MAX_ROBOTS:
                    del self._told[next(iter(self._told))]
                self._told[robot] = _Told(now, now)
                return self._text(source, "its oldest scans are dropped")
            self._told[robot] = told
            told.dropped += 1
            told.last = now
            if now - told.at < PERIOD:
                return None
            rate = told.dropped / (now - told.at)
            told.at, told.dropped = now, 0
        return self._text(source, f"{rate:.3g} of its scans are dropped each second")

    def _text(self, source: Source, what: str) -> str:
        queue = self._queue
        return (
            f"{source.robot}/{source.sensor}: {what} (overload): {queue.scans} scans, "
            f"{queue.bytes / 1e6:.0f} MB, {queue.work:.1f} s of work wait, and no robot's share is larger: "
            f"{self._cure}"
        )
