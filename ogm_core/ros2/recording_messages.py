"""Messages of MCAP recordings, as CDR: ogm_msgs, which keep every value, and what displays of ROS 2 read.

A LaserScan alone does not do: its angles are float32, and a heading that goes through a quaternion comes back
as another number. So each pose and scan stands in a message of our own, to the last bit, and beside it in one
that every viewer knows. `rosbags` (the extra `ros2`) writes and reads both.
"""

import math
from functools import lru_cache
from typing import Any

import numpy as np

from ogm_core.errors import BadCdr
from ogm_core.ros2.cdr import LASER_SCAN, LAST_STAMP, TF_MESSAGE
from ogm_core.ros2.typestore import check_installed
from ogm_core.types import Pose, PoseStamped, Ranges, Scan
from ogm_core.wire.messages import DEFAULT_MAX_BEAMS, pose_from_fields, scan_fields, scan_from_fields

POSE = "ogm_msgs/msg/Pose"
SCAN = "ogm_msgs/msg/Scan"
DEFINITIONS = {
    POSE: """# Where a robot's base is in the map frame; x and y in m, theta in rad, counter-clockwise.
int64 stamp  # ns since the Unix epoch
int64 seq  # one more with each message of a run
string run  # which run of the publisher
float64 x
float64 y
float64 theta
""",
    SCAN: """# One sweep of a 2D lidar: beam k looks along angle_min + k * angle_increment in its frame.
int64 stamp  # of the first beam, ns since the Unix epoch
int64 seq  # one more with each message of a run
string run  # which run of the publisher
float64 angle_min  # rad
float64 angle_increment  # rad, may be negative
float64 time_increment  # s between beams
float64 range_min  # m
float64 range_max  # m
float64[3] mount  # the sensor in the base frame: x, y (m), theta (rad)
float64[] pose  # the base in the map frame at the stamp, likewise; empty if the scan does not carry it
float32[] ranges  # m; inf is no return
""",
}
"""What ogm_msgs are made of, as ROS 2 defines messages."""
TYPE_HASHES = {
    POSE: "RIHS01_6cb29eb98d9274d506a197822926ed33fcd96ee9ab03b27d1f5e1f23bd94f9bc",
    SCAN: "RIHS01_2992c36bb05717798809c644e54ddc01ecec523a185b5546346144f49de9f686",
}
"""Their hashes (RIHS01, REP-2016)."""
_SECOND = 1_000_000_000
_NUMBERING = ("stamp", "seq", "run")
_SCAN_FIELDS = (
    *_NUMBERING,
    *("angle_min", "angle_increment", "time_increment", "range_min", "range_max"),
)


def encode_pose(message: PoseStamped) -> bytes:
    """CDR of a pose message as ogm_msgs/Pose."""
    types = _typestore().types
    return _encoded(types[POSE](message.stamp, message.seq, message.run, *message.pose), POSE)


def encode_scan(scan: Scan) -> bytes:
    """CDR of a scan message as ogm_msgs/Scan; settings that are no part of a message are left out."""
    fields = scan_fields(scan)
    pose = np.array(fields.pop("pose", ()), np.float64)
    fields |= {"mount": np.array(scan.mount, np.float64), "pose": pose, "ranges": scan.ranges}
    return _encoded(_typestore().types[SCAN](**fields), SCAN)


def decode_pose(payload: bytes) -> PoseStamped:
    """Read an ogm_msgs/Pose.

    Raises:
        BadCdr: it is none.
        BadMessage: a field is out of range.
    """
    said = _decoded(payload, POSE)
    return pose_from_fields({name: getattr(said, name) for name in (*_NUMBERING, "x", "y", "theta")})


def decode_scan(payload: bytes, *, max_beams: int = DEFAULT_MAX_BEAMS) -> Scan:
    """Read an ogm_msgs/Scan.

    Raises:
        BadCdr: it is none.
        BadMessage: a field is out of range.
    """
    said = _decoded(payload, SCAN)
    fields = {name: getattr(said, name) for name in _SCAN_FIELDS}
    fields["mount"] = said.mount.tolist()
    if said.pose.size:
        fields["pose"] = said.pose.tolist()
    ranges: Ranges = said.ranges
    ranges.flags.writeable = False
    return scan_from_fields(fields, ranges, max_beams=max_beams)


def encode_laser_scan(scan: Scan, frame: str) -> bytes:
    """CDR of a scan as sensor_msgs/LaserScan, without intensities, as near as float32 holds its numbers."""
    types = _typestore().types
    last = scan.angle_min + (scan.ranges.size - 1) * scan.angle_increment
    swept = scan.ranges.size * scan.time_increment
    numbers = (scan.angle_min, last, scan.angle_increment, scan.time_increment, swept)
    message = types[LASER_SCAN](
        _header(types, scan.stamp, frame),
        *map(_single, (*numbers, scan.range_min, scan.range_max)),
        scan.ranges,
        np.empty(0, np.float32),
    )
    return _encoded(message, LASER_SCAN)


def encode_transforms(stamp: int, edges: tuple[tuple[str, str, Pose], ...]) -> bytes:
    """CDR of a tf2_msgs/TFMessage of one time, ns: parent, child, and where the child is in the parent."""
    types = _typestore().types
    transforms = [
        types["geometry_msgs/msg/TransformStamped"](
            _header(types, stamp, parent),
            child,
            types["geometry_msgs/msg/Transform"](
                types["geometry_msgs/msg/Vector3"](pose.x, pose.y, 0.0),
                types["geometry_msgs/msg/Quaternion"](
                    0.0, 0.0, math.sin(pose.theta / 2.0), math.cos(pose.theta / 2.0)
                ),
            ),
        )
        for parent, child, pose in edges
    ]
    return _encoded(types[TF_MESSAGE](transforms), TF_MESSAGE)


def definition(name: str) -> str:
    """The definition of a message type with those that it is made of, as ros2msg has it."""
    if name in DEFINITIONS:
        return DEFINITIONS[name]
    text: str = _typestore().generate_msgdef(name, ros_version=2)[0]
    return text


@lru_cache(maxsize=1)
def _typestore() -> Any:  # noqa: ANN401 - rosbags' store of types
    check_installed()
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def _encoded(message: object, name: str) -> bytes:
    return bytes(_typestore().serialize_cdr(message, name))


def _decoded(payload: bytes, name: str) -> Any:  # noqa: ANN401 - a class that rosbags generates
    from rosbags.serde import SerdeError

    try:
        return _typestore().deserialize_cdr(payload, name)
    except SerdeError as error:
        cause = str(error.__cause__ or error)
        raise BadCdr(f"payload: {len(payload)} bytes are not a {name}: {cause}") from error


def _header(types: Any, stamp: int, frame: str) -> Any:  # noqa: ANN401 - of std_msgs
    time = types["builtin_interfaces/msg/Time"](*divmod(min(stamp, LAST_STAMP), _SECOND))
    return types["std_msgs/msg/Header"](time, frame)


def _single(value: float) -> float:
    """The nearest number that float32 holds, which may be infinite."""
    with np.errstate(over="ignore"):
        return float(np.float32(value))
