"""Heard robots: what robots publish for a mapper, put down as it comes until it is taken."""

import threading
from collections import deque
from dataclasses import dataclass, field

import zenoh

from ogm_core.placing.rules import MAX_ROBOTS, MAX_SENSORS
from ogm_core.units import MEBIBYTE
from ogm_core.wire.keys import MapKeys, Source
from ogm_core.wire.messages import DEFAULT_MAX_BEAMS, MAX_POSE_BYTES, max_scan_bytes

MAX_POSES = 64
"""So many poses of a robot are kept until they are taken, the newest ones."""
MAX_BYTES = 64 * MEBIBYTE
"""What scans hold at most until they are taken; further ones are left out."""
_MAX_SOURCES = MAX_ROBOTS * (MAX_SENSORS + 1)
_LONGEST = max_scan_bytes(DEFAULT_MAX_BEAMS)


@dataclass(slots=True)
class Heard:
    """What has come since it was taken last: all poses of each robot, the newest scan of each sensor."""

    poses: dict[str, deque[bytes]] = field(default_factory=dict)
    scans: dict[Source, bytes] = field(default_factory=dict)
    nbytes: int = 0

    def add(self, source: Source, payload: bytes) -> None:
        """Put down a message, if there is room."""
        robot, sensor = source
        if sensor is None:
            if robot in self.poses or len(self.poses) < _MAX_SOURCES:
                self.poses.setdefault(robot, deque(maxlen=MAX_POSES)).append(payload)
            return
        more = len(payload) - len(self.scans.get(source, b""))
        if self.nbytes + more <= MAX_BYTES and (source in self.scans or len(self.scans) < _MAX_SOURCES):
            self.scans[source] = payload
            self.nbytes += more


class HeardRobots:
    """A subscriber to all robots of a map; Zenoh's thread puts messages down, and reads none."""

    def __init__(self, session: zenoh.Session, map_name: str) -> None:
        self._keys = MapKeys(map_name)
        self._lock = threading.Lock()
        self._heard = Heard()
        callback = zenoh.handlers.Callback(self._received, indirect=False)
        self._subscriber = session.declare_subscriber(self._keys.robots, callback)

    def take(self) -> Heard:
        """What has come since this was called last."""
        with self._lock:
            heard, self._heard = self._heard, Heard()
        return heard

    def close(self) -> None:
        """Hear no more."""
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]

    def _received(self, sample: zenoh.Sample) -> None:
        source = self._keys.source_of(str(sample.key_expr))
        if source is None or sample.kind != zenoh.SampleKind.PUT:
            return
        if len(sample.payload) <= (MAX_POSE_BYTES if source.sensor is None else _LONGEST):
            payload = sample.payload.to_bytes()
            with self._lock:
                self._heard.add(source, payload)
