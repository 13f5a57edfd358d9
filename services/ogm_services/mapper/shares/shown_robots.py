"""Shown robots: where robots are and what they see, for viewers of a gateway, which integrates nothing."""

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial

import zenoh

from ogm_core.errors import BadMessage
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.rules import PlacingRules
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.placing.sensor_rules import SensorRules
from ogm_core.placing.waiting import WaitingLimits
from ogm_core.types import Pose, Scan, Sweep
from ogm_core.units import MEBIBYTE
from ogm_core.wire.keys import MapKeys, Source
from ogm_core.wire.messages import MAX_POSE_BYTES, decode_pose, decode_scan, max_scan_bytes
from ogm_services.mapper.live.newest_scans import NewestScans
from ogm_services.runtime.limited_log import LimitedLog

PERIOD = 0.02
"""How often what has come is taken, s."""
MAX_MESSAGES = 4096
"""So many messages wait at most; of more the newest: viewers miss a scan, and no map does."""
LIMITS = WaitingLimits(16 * MEBIBYTE, math.inf, lambda *_: 0)
"""What scans may hold that wait for poses."""

log = logging.getLogger(__name__)


class _NoMap:
    """A sink that takes every scan, and makes nothing of it."""

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None) -> int:
        """Take it."""
        del scan, pose, sweep
        return 0


class ShownRobots:
    """Hears robots, and notes where they are and their newest scans. Started once, stopped once.

    Who owns what: Zenoh's threads put down what comes, under `_lock`; a thread of its own places it. While
    nobody watches, scans are left out: only poses are read.
    """

    def __init__(
        self,
        receipts: Receipts,
        scans: NewestScans,
        rules: PlacingRules,
        sensors: SensorRules,
        max_beams: int,
        watched: Callable[[], bool],
    ) -> None:
        """It notes places in `receipts` and `scans`; `watched`: whether anybody looks at scans."""
        self._receipts = receipts
        self._sensors = sensors
        self._max_beams = max_beams
        self._watched = watched
        self._placer = ScanPlacer(
            _NoMap(), receipts, lambda *_: None, rules, limits=LIMITS, placed=scans.note
        )
        self._lock = threading.Lock()
        self._heard: deque[Callable[[], None]] = deque(maxlen=MAX_MESSAGES)
        self._complaints = LimitedLog(log)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ogm-robots")
        self._declared = ExitStack()

    def start(self, session: zenoh.Session, keys: MapKeys) -> None:
        """Begin to hear robots."""
        self._thread.start()
        tokens = zenoh.handlers.Callback(partial(self._token, keys), indirect=False)
        alive = keys.alive("robot", "*", "*")
        self._declared.push(session.liveliness().declare_subscriber(alive, tokens, history=True))
        messages = zenoh.handlers.Callback(partial(self._message, keys), indirect=False)
        self._declared.push(session.declare_subscriber(keys.robots, messages))

    def stop(self) -> None:
        """Hear no more, and end."""
        self._declared.close()
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _token(self, keys: MapKeys, sample: zenoh.Sample) -> None:
        found = keys.robot_of(str(sample.key_expr))
        if found is not None:
            here = sample.kind == zenoh.SampleKind.PUT
            note = self._placer.robot_here if here else self._placer.robot_gone
            self._put(partial(note, found.robot, found.run, time.monotonic()))

    def _message(self, keys: MapKeys, sample: zenoh.Sample) -> None:
        source = keys.source_of(str(sample.key_expr))
        if source is None or sample.kind != zenoh.SampleKind.PUT:
            return
        if source.sensor is not None and not self._watched():
            return
        longest = MAX_POSE_BYTES if source.sensor is None else max_scan_bytes(self._max_beams)
        if len(sample.payload) <= longest:
            self._put(partial(self._take, source, sample.payload.to_bytes(), time.monotonic()))

    def _put(self, work: Callable[[], None]) -> None:
        with self._lock:
            self._heard.append(work)

    def _run(self) -> None:
        looked = time.monotonic()
        while not self._stopping.wait(PERIOD):
            with self._lock:
                heard, self._heard = self._heard, deque(maxlen=MAX_MESSAGES)
            if time.monotonic() - looked >= 1.0:
                looked = time.monotonic()
                heard.append(partial(self._placer.expire, looked))
            for work in heard:
                try:
                    work()
                except Exception:  # noqa: BLE001 (logged with its traceback)
                    self._complaints.failure("a robot's message")

    def _take(self, source: Source, payload: bytes, now: float) -> None:
        robot, sensor = source
        try:
            if sensor is None:
                if self._receipts.pose_received(robot, now):
                    self._placer.add_pose(robot, decode_pose(payload), now)
            elif self._receipts.scan_received(robot, sensor, now):
                scan = decode_scan(payload, max_beams=self._max_beams)
                self._placer.add_scan(robot, sensor, self._sensors.read(f"{robot}/{sensor}", scan), now)
        except BadMessage:
            pass  # its mappers say so
