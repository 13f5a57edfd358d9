"""ROS 2 messages as CDR bytes: what a robot's topics carry, read; what map displays read, written.

`rosbags` (the extra `ros2`) knows the layouts, which are the same in all distributions from Humble on. It
reads both byte orders, and up to three bytes of padding at the end.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import BadCdr
from ogm_core.ros2.transform import Transform
from ogm_core.ros2.typestore import rosbags_types, typestore
from ogm_core.types import Ranges

LASER_SCAN = "sensor_msgs/msg/LaserScan"
POINT_CLOUD2 = "sensor_msgs/msg/PointCloud2"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE_STAMPED = "geometry_msgs/msg/PoseWithCovarianceStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
OCCUPANCY_GRID_UPDATE = "map_msgs/msg/OccupancyGridUpdate"

_SECOND = 1_000_000_000
LAST_STAMP = (2**31 - 1) * _SECOND
"""In 2038; ROS 2 has no later one, ns."""
_NO_CELLS = np.empty(0, np.int8)
_LARGE = 65_536
"""A longer payload is read in place, bytes; shorter ones are read faster as a copy."""


@dataclass(frozen=True, slots=True, eq=False)
class LaserScan:
    """sensor_msgs/LaserScan as it comes; `stamp` in ns, `ranges` float32, shape (N,), read-only, N >= 0.

    Angles in rad, ranges in m, `time_increment` in s. `angle_max`, `scan_time` and intensities are left out:
    ranges tell how many beams there are.
    """

    stamp: int
    frame: str
    angle_min: float
    angle_increment: float
    time_increment: float
    range_min: float
    range_max: float
    ranges: Ranges


class StampedTransform(NamedTuple):
    """geometry_msgs/TransformStamped as it comes: where `child` is in `parent` at `stamp` (ns); unchecked."""

    stamp: int
    parent: str
    child: str
    transform: Transform


@dataclass(frozen=True, slots=True)
class StampedPose:
    """A pose topic's message as it comes: where `child` is in `frame` at `stamp` (ns).

    `child` is "" if the message does not say. The numbers are unchecked: see `transform.unit`.
    """

    stamp: int
    frame: str
    child: str
    transform: Transform


@dataclass(frozen=True, slots=True)
class PointField:
    """Where one of a point's values lies: `offset` bytes after its begin.

    `datatype` is that of sensor_msgs/PointField.
    """

    name: str
    offset: int
    datatype: int
    count: int


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud2:
    """sensor_msgs/PointCloud2 as it comes; `stamp` in ns, `data` uint8, shape (bytes,), read-only."""

    stamp: int
    frame: str
    height: int
    width: int
    fields: tuple[PointField, ...]
    big_endian: bool
    point_step: int
    row_step: int
    data: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyGrid:
    """What nav_msgs/OccupancyGrid says: `data` int8, [iy, ix], row 0 south: 0 to 100, or -1 for unknown.

    `stamp` in ns, `resolution` in m, `origin` the lower-left corner's position in `frame`, m; the yaw is 0.
    """

    stamp: int
    frame: str
    resolution: float
    origin: tuple[float, float]
    data: NDArray[np.int8]


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyGridUpdate:
    """What map_msgs/OccupancyGridUpdate says: `data` as in `OccupancyGrid`, from the cell (x, y) on."""

    stamp: int
    frame: str
    x: int
    y: int
    data: NDArray[np.int8]


def decode_laser_scan(payload: bytes) -> LaserScan:
    """Read a LaserScan, of either byte order.

    Raises:
        BadCdr: it is none.
    """
    message = _decoded(payload, LASER_SCAN)
    return LaserScan(
        _stamp(message.header.stamp),
        _frame(message.header.frame_id),
        message.angle_min,
        message.angle_increment,
        message.time_increment,
        message.range_min,
        message.range_max,
        _read_only(message.ranges),
    )


def decode_tf_message(payload: bytes) -> tuple[StampedTransform, ...]:
    """Read a TFMessage, as on /tf and /tf_static.

    Raises:
        BadCdr: it is none.
    """
    return tuple(
        StampedTransform(
            _stamp(each.header.stamp),
            _frame(each.header.frame_id),
            _frame(each.child_frame_id),
            _transform(each.transform.translation, each.transform.rotation),
        )
        for each in _decoded(payload, TF_MESSAGE).transforms
    )


def decode_pose_stamped(payload: bytes) -> StampedPose:
    """Read a PoseStamped.

    Raises:
        BadCdr: it is none.
    """
    message = _decoded(payload, POSE_STAMPED)
    return _pose(message.header, "", message.pose)


def decode_pose_with_covariance_stamped(payload: bytes) -> StampedPose:
    """Read a PoseWithCovarianceStamped; the covariance is not looked at.

    Raises:
        BadCdr: it is none.
    """
    message = _decoded(payload, POSE_WITH_COVARIANCE_STAMPED)
    return _pose(message.header, "", message.pose.pose)


def decode_odometry(payload: bytes) -> StampedPose:
    """Read an Odometry; twist and covariances are not looked at.

    Raises:
        BadCdr: it is none.
    """
    message = _decoded(payload, ODOMETRY)
    return _pose(message.header, _frame(message.child_frame_id), message.pose.pose)


def decode_point_cloud2(payload: bytes) -> PointCloud2:
    """Read a PointCloud2; large data are a view of `payload`. Whether the layout fits them is not looked at.

    Raises:
        BadCdr: it is none.
    """
    message = _decoded(payload, POINT_CLOUD2)
    fields = tuple(PointField(each.name, each.offset, each.datatype, each.count) for each in message.fields)
    return PointCloud2(
        _stamp(message.header.stamp),
        _frame(message.header.frame_id),
        message.height,
        message.width,
        fields,
        bool(message.is_bigendian),
        message.point_step,
        message.row_step,
        _read_only(message.data),
    )


POSES: dict[str, Callable[[bytes], StampedPose]] = {
    POSE_STAMPED: decode_pose_stamped,
    POSE_WITH_COVARIANCE_STAMPED: decode_pose_with_covariance_stamped,
    ODOMETRY: decode_odometry,
}
"""How messages are read that tell a robot's pose, by type."""


def encode_occupancy_grid(grid: OccupancyGrid) -> bytes:
    """CDR of an OccupancyGrid, little endian; a stamp past LAST_STAMP is given as that one."""
    types = typestore().types
    stamp = _time(types, grid.stamp)
    point = types["geometry_msgs/msg/Point"](*grid.origin, 0.0)
    level = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    origin = types["geometry_msgs/msg/Pose"](point, level)
    height, width = grid.data.shape
    info = types["nav_msgs/msg/MapMetaData"](stamp, grid.resolution, width, height, origin)
    header = types["std_msgs/msg/Header"](stamp, grid.frame)
    return _encoded(types[OCCUPANCY_GRID](header, info, _NO_CELLS), OCCUPANCY_GRID, grid.data)


def encode_occupancy_grid_update(update: OccupancyGridUpdate) -> bytes:
    """CDR of an OccupancyGridUpdate, likewise."""
    types = typestore().types
    header = types["std_msgs/msg/Header"](_time(types, update.stamp), update.frame)
    height, width = update.data.shape
    message = types[OCCUPANCY_GRID_UPDATE](header, update.x, update.y, width, height, _NO_CELLS)
    return _encoded(message, OCCUPANCY_GRID_UPDATE, update.data)


def from_ros1(payload: bytes, name: str) -> bytes:
    """CDR of a message as ROS 1 writes it.

    Raises:
        BadCdr: it is damaged, or no `name`.
    """
    rosbags = rosbags_types()
    try:
        return bytes(rosbags.store.ros1_to_cdr(payload, name))
    except (rosbags.error, KeyError, struct.error, IndexError, ValueError, AssertionError) as error:
        raise BadCdr(f"payload: {len(payload)} bytes are not a {name} of ROS 1: {error}") from error


def _decoded(payload: bytes, name: str) -> Any:  # noqa: ANN401 - a class that rosbags generates
    rosbags = rosbags_types()
    try:
        return rosbags.store.deserialize_cdr(memoryview(payload) if len(payload) > _LARGE else payload, name)
    except rosbags.error as error:
        cause = str(error.__cause__ or error)
        raise BadCdr(f"payload: {len(payload)} bytes are not a {name}: {cause}") from error


def _encoded(message: object, name: str, cells: NDArray[np.int8]) -> bytes:
    """CDR of a message that ends in cells, and has none yet: a map's millions are copied once."""
    empty = typestore().serialize_cdr(message, name, little_endian=True)
    return b"".join((empty[:-4], struct.pack("<I", cells.size), np.ascontiguousarray(cells).data))


def _stamp(time: Any) -> int:  # noqa: ANN401 - builtin_interfaces/Time
    return int(time.sec * _SECOND + time.nanosec)


def _time(types: Any, stamp: int) -> Any:  # noqa: ANN401 - builtin_interfaces/Time
    return types["builtin_interfaces/msg/Time"](*divmod(min(stamp, LAST_STAMP), _SECOND))


def _frame(name: str) -> str:
    """A frame's name without the '/' that ROS 1 began it with."""
    return name.lstrip("/")


def _transform(position: Any, rotation: Any) -> Transform:  # noqa: ANN401 - of geometry_msgs
    return Transform(position.x, position.y, position.z, rotation.x, rotation.y, rotation.z, rotation.w)


def _pose(header: Any, child: str, pose: Any) -> StampedPose:  # noqa: ANN401 - of std_msgs, geometry_msgs
    transform = _transform(pose.position, pose.orientation)
    return StampedPose(_stamp(header.stamp), _frame(header.frame_id), child, transform)


def _read_only(values: NDArray[Any]) -> NDArray[Any]:
    values.flags.writeable = False
    return values
