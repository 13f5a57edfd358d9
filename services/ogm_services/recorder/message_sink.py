"""Message sink: takes what a mapper would take, in that order, and writes it into a recording."""

import logging
import math
import time
from collections.abc import Callable

from ogm_core.placing.receipts import Receipts
from ogm_core.placing.robot import Skip
from ogm_core.ros2.mcap_recording import McapWriter, NoChannelLeft
from ogm_core.types import PoseStamped, Scan
from ogm_services.mapper.intake.handing_on import Placing
from ogm_services.runtime.limited_log import LimitedLog

FLUSH_PERIOD = 0.5
"""How often what was written is made safe from a kill, s."""
RECORDING = "recording"
"""Source of complaints about robots that have no place in it, be they ever so many."""

log = logging.getLogger(__name__)


class NothingDecided:
    """A recorder's past, as a hold asks for it: it has none, so all that robots' caches keep is recorded."""

    def is_decided(self, robot: str, sensor: str | None, run: str, seq: int) -> bool:
        """No: what was handed on in this life the hold knows itself."""
        return False

    def last(self, robot: str, sensor: str | None, run: str) -> int | None:
        """None."""
        return None

    def skip(
        self,
        robot: str,
        sensor: str | None,
        run: str,
        first: int,
        last: int,
        outcome: Skip = "lost",
        count: int | None = None,
    ) -> None:
        """Nothing waits for what will not come."""

    def drop_unnumbered(self, robot: str, sensor: str, outcome: Skip) -> None:
        """Nothing is stored of what is dropped."""

    def wait_on(self, robot: str, until: float) -> None:
        """No scan waits for its poses here."""


class MessageSink(Placing):
    """Stands where a mapper has its scan placer: the worker's thread calls it; any thread reads it."""

    decided = NothingDecided()

    def __init__(
        self, writer: McapWriter, receipts: Receipts, clock: Callable[[], int] = time.time_ns
    ) -> None:
        """`clock` tells when a message came, ns since the Unix epoch."""
        self._writer, self._receipts, self._clock = writer, receipts, clock
        self.poses = self.scans = 0
        """How many were written."""
        self.safe = (0, 0)
        """How many of either are in the file for certain, whatever becomes of what comes next."""
        self.robots: set[str] = set()
        """Whose they are."""
        self.failure: OSError | None = None
        """What has kept one from being written; after that none is."""
        self._flushed = -math.inf
        self._complaints = LimitedLog(log)

    def add_pose(self, name: str, message: PoseStamped, now: float = 0.0) -> None:
        """Write a robot's pose."""
        try:
            written = self._written(lambda: self._writer.pose(name, message, self._clock()))
        except NoChannelLeft as error:
            self._receipts.pose_noted("refused")
            self._complaints.of_kind(RECORDING, "full", str(error))
            return
        if written:
            self.poses += 1
            self.robots.add(name)

    def add_scan(self, name: str, sensor: str, scan: Scan, now: float = 0.0) -> None:
        """Write a scan."""
        try:
            written = self._written(lambda: self._writer.scan(name, sensor, scan, self._clock()))
        except NoChannelLeft as error:
            self._receipts.scan_dropped(name, sensor, "refused")
            self._complaints.of_kind(RECORDING, "full", str(error))
            return
        if written:
            self.scans += 1
            self.robots.add(name)
            self._receipts.scan_integrated(name, sensor)

    def robot_here(self, name: str, run: str, now: float = 0.0) -> None:
        """Note that a robot is there."""
        self._receipts.robot_alive(name, run, True, now)

    def robot_gone(self, name: str, run: str, now: float = 0.0) -> None:
        """Note that it is there no more."""
        self._receipts.robot_alive(name, run, False, now)

    def expire(self, now: float) -> None:
        """Forget robots that are gone for long, so that others can come."""
        for name in self._receipts.gone(now):
            self._receipts.forget(name, now)

    def flush(self, now: float | None = None) -> None:
        """Make safe what was written; with `now`, s, only if that is due."""
        if now is None or now - self._flushed >= FLUSH_PERIOD:
            if self._written(self._writer.flush):
                self.safe = self.scans, self.poses
            self._flushed = time.monotonic() if now is None else now

    def _written(self, write: Callable[[], None]) -> bool:
        if self.failure is not None:
            return False
        try:
            write()
        except OSError as error:
            self.failure = error
            return False
        return True
