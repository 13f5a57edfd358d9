"""Sensor feed: the messages of one topic on their way to becoming a sensor's scans."""

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from ogm_core.placing.sensor_rules import Deskew, SensorRule
from ogm_core.ros2.cdr import LaserScan, PointCloud2
from ogm_core.ros2.laser_scan import first_beam, mounted_scan
from ogm_core.ros2.point_cloud import Flattening, flattened_scan
from ogm_core.ros2.topics import Topic
from ogm_core.ros2.transform import Transform
from ogm_core.types import Scan
from ogm_core.wire.messages import DEFAULT_MAX_BEAMS

MAX_WAITING = 100
"""Messages of a sensor that may wait for transforms."""
_HINT = (
    "its scans say when each beam was taken (time_increment), which many drivers get wrong: they are taken "
    "as a whole at their stamps; --sensor '{}:deskew=auto', or deskew=reversed, takes beam by beam"
)


class Waiting(NamedTuple):
    """A message, and when it came, s."""

    message: LaserScan | PointCloud2
    since: float


@dataclass(slots=True, eq=False)
class SensorFeed:
    """What waits of a topic, and how it becomes scans, as Ros2Options say; `delay` is their `scan_delay`."""

    topic: Topic
    delay: float
    flattening: Flattening | None = None
    max_beams: int = DEFAULT_MAX_BEAMS
    waiting: deque[Waiting] = field(default_factory=deque)
    hinted: bool = False

    def taken_at(self, message: LaserScan | PointCloud2, rule: SensorRule | None) -> int:
        """When the first beam was taken, ns."""
        if isinstance(message, LaserScan):
            return first_beam(message, deskew=_deskew(rule), delay=self.delay)
        return message.stamp + round(self.delay * 1e9)

    def scan(
        self,
        message: LaserScan | PointCloud2,
        mount: Transform,
        rule: SensorRule | None,
        seq: int,
        run: str,
    ) -> Scan:
        """The message as a scan.

        Raises:
            BadMessage, Tilted: it cannot be one.
        """
        if isinstance(message, LaserScan):
            return mounted_scan(
                message,
                mount,
                deskew=_deskew(rule),
                delay=self.delay,
                seq=seq,
                run=run,
                max_beams=self.max_beams,
            )
        assert self.flattening is not None
        return flattened_scan(message, mount, self.flattening, delay=self.delay, seq=seq, run=run)

    def hint(self, source: str, message: LaserScan | PointCloud2, rule: SensorRule | None) -> str | None:
        """What to say, once, of scans that could be deskewed and are not; None if there is nothing."""
        if self.hinted or not isinstance(message, LaserScan) or message.time_increment == 0.0:
            return None
        self.hinted = True
        return None if rule is not None and rule.deskew is not None else _HINT.format(source)


def _deskew(rule: SensorRule | None) -> Deskew:
    return "off" if rule is None or rule.deskew is None else rule.deskew
