"""ROS 2's laser scans as this mapper takes them: where the sensor sits, and which way its beams go round."""

import math

from ogm_core.errors import Tilted
from ogm_core.placing.sensor_rules import Deskew
from ogm_core.ros2.cdr import LaserScan
from ogm_core.ros2.transform import Transform
from ogm_core.types import Scan
from ogm_core.wire.messages import DEFAULT_MAX_BEAMS, scan_from_fields

MAX_TILT = math.radians(10.0)


def first_beam(message: LaserScan, *, deskew: Deskew = "off", delay: float = 0.0) -> int:
    """When the first beam was taken, ns: the time at which to ask for the sensor's mount.

    `delay`, s, is added to the stamp. `deskew`: "off" takes all beams at the stamp; "auto" takes them by
    time_increment, one after the other; "reversed" likewise, but the last beam first, as drivers of lidars
    that turn clockwise may send them.
    """
    stamp = message.stamp + round(delay * 1e9)
    if deskew == "reversed":
        swept = (message.ranges.size - 1) * message.time_increment
        stamp += round(swept * 1e9) if math.isfinite(swept) else 0
    return stamp


def mounted_scan(
    message: LaserScan,
    mount: Transform,
    *,
    deskew: Deskew = "off",
    delay: float = 0.0,
    seq: int = 0,
    run: str = "",
    max_beams: int = DEFAULT_MAX_BEAMS,
) -> Scan:
    """A laser scan as a scan for the mapper; `mount` is the sensor in the base frame at the first beam.

    Of a sensor that hangs upside down the bearings go the other way round: where its x axis points, seen
    from above, counts, not the yaw of its rotation. Every range is left as it is. `deskew`, `delay`: see
    `first_beam`.

    Raises:
        Tilted: the sensor's plane is more than MAX_TILT from level.
        BadMessage: a value is out of range, as a mapper would say of a received scan.
    """
    side = facing(mount)
    time_increment = {"off": 0.0, "auto": 1.0, "reversed": -1.0}[deskew] * message.time_increment
    fields = {
        "stamp": first_beam(message, deskew=deskew, delay=delay),
        "seq": seq,
        "run": run,
        "angle_min": side * message.angle_min,
        "angle_increment": side * message.angle_increment,
        "time_increment": 0.0 if deskew == "off" else time_increment,
        "range_min": message.range_min,
        "range_max": message.range_max,
        "mount": list(mount.planar()),
    }
    return scan_from_fields(fields, message.ranges, max_beams=max_beams)


def facing(mount: Transform) -> float:
    """1 if a sensor stands upright in its base frame, -1 if it hangs upside down.

    Raises:
        Tilted: neither.
    """
    upright = mount.upright
    if abs(upright) < math.cos(MAX_TILT):
        tilt = math.degrees(math.acos(min(abs(upright), 1.0)))
        raise Tilted(
            f"its sensor is tilted by {tilt:.0f} degrees against the floor, at most "
            f"{math.degrees(MAX_TILT):.0f} are taken: is its frame in tf right?"
        )
    return math.copysign(1.0, upright)
