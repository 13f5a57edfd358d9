"""MCAP recordings, written: each pose and scan twice, once to the last bit and once for viewers.

`/ogm/robots/ROBOT/pose` and `/ogm/robots/ROBOT/scan/SENSOR` carry ogm_msgs, which are read back; `/tf` and
`/ROBOT/SENSOR` (LaserScan) are what Foxglove, Lichtblick, PlotJuggler and rosbag2 know; `/map` comes last.
"""

import re
from typing import BinaryIO

from ogm_core.errors import BadRecording
from ogm_core.ros2 import cdr, topics
from ogm_core.ros2.mcap_package import mcap_package
from ogm_core.ros2.recording_messages import (
    POSE,
    SCAN,
    TYPE_HASHES,
    definition,
    encode_laser_scan,
    encode_pose,
    encode_scan,
    encode_transforms,
)
from ogm_core.ros2.typestore import check_installed
from ogm_core.types import Pose, PoseStamped, Scan

LIBRARY = "zenoh-ogm"
"""What a recording says wrote it."""
ROBOT, SENSOR = "robot", "sensor"
"""Metadata of a channel of ours: whose messages it carries; names of ROS 2 cannot hold all of ours."""
MAP_FRAME = "map"
MOST_CHANNELS = 65_000
"""So many channels a recording has at most, and a few more for viewers: MCAP numbers them with 16 bits."""
_HASHES = {**topics.TYPE_HASHES, **TYPE_HASHES}
_NOT_IN_TOPICS = re.compile(r"[^A-Za-z0-9_]")


class NoChannelLeft(BadRecording):
    """A recording has messages of as many robots and sensors as one can have: of others it takes none."""


def check_writable() -> None:
    """Find out, before a file is made, whether recordings can be written.

    Raises:
        MissingExtra: mcap or rosbags is not installed.
    """
    check_installed()
    mcap_package()


class McapWriter:
    """Writes messages into a file, in the order of its calls, from `__init__` to `finish`.

    Times, ns, are when messages came: they order them for other readers, so they never go back here. What
    was written up to `flush` can be read, whatever happens later.

    Raises:
        MissingExtra: mcap or rosbags is not installed.
        NoChannelLeft: a message is of one robot or sensor too many; nothing of it is written.
        OSError: the file cannot be written.
    """

    def __init__(self, file: BinaryIO, *, chunk_size: int = 1024 * 1024) -> None:
        check_writable()
        self._file = file
        self._writer = mcap_package().Writer(file, chunk_size=chunk_size)
        self._writer.start(profile="ros2", library=LIBRARY)
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str, str], int] = {}
        self._robots: dict[str, str] = {}
        self._sensors: dict[str, dict[str, str]] = {}
        """What robots, and sensors by robot, are called in topics."""
        self._time = 0

    def pose(self, robot: str, message: PoseStamped, time: int) -> None:
        """Write a robot's pose."""
        self._put(POSE, robot, "", encode_pose(message), time, message.stamp)
        self._transforms(message.stamp, ((MAP_FRAME, base_frame(robot), message.pose),), time)

    def scan(self, robot: str, sensor: str, scan: Scan, time: int) -> None:
        """Write a scan of one of its sensors."""
        self._put(SCAN, robot, sensor, encode_scan(scan), time, scan.stamp)
        base, frame = base_frame(robot), sensor_frame(robot, sensor)
        own = () if scan.pose is None else ((MAP_FRAME, base, scan.pose),)
        self._transforms(scan.stamp, (*own, (base, frame, scan.mount)), time)
        self._put(cdr.LASER_SCAN, robot, sensor, encode_laser_scan(scan, frame), time, scan.stamp)

    def map(self, grid: cdr.OccupancyGrid, time: int) -> None:
        """Write a map."""
        self._put(cdr.OCCUPANCY_GRID, "", "", cdr.encode_occupancy_grid(grid), time, grid.stamp)

    def flush(self) -> None:
        """See to it that what was written can be read, by others, too."""
        self._writer.flush()
        self._file.flush()

    def finish(self) -> None:
        """Write the summary, without which most readers take the file for damaged; nothing comes after."""
        self._writer.finish()
        self._file.flush()

    def _transforms(self, stamp: int, edges: tuple[tuple[str, str, Pose], ...], time: int) -> None:
        self._put(cdr.TF_MESSAGE, "", "", encode_transforms(stamp, edges), time, stamp)

    def _put(self, kind: str, robot: str, sensor: str, payload: bytes, time: int, stamp: int) -> None:
        self._time = max(self._time, time)
        channel = self._channels.get((kind, robot, sensor)) or self._channel(kind, robot, sensor)
        self._writer.add_message(channel, log_time=self._time, publish_time=stamp, data=payload)

    def _channel(self, kind: str, robot: str, sensor: str) -> int:
        """Declare what messages of a kind, of a robot and maybe a sensor, are written on."""
        if kind in TYPE_HASHES and len(self._channels) >= MOST_CHANNELS:
            raise NoChannelLeft(
                f"{robot}/{sensor or 'pose'} has no place in the recording, which has {MOST_CHANNELS} "
                "channels: start a new one; do robots change their names?"
            )
        schema = self._schemas.get(kind)
        if schema is None:
            schema = self._writer.register_schema(kind, "ros2msg", definition(kind).encode())
            self._schemas[kind] = schema
        metadata = {"offered_qos_profiles": "", "topic_type_hash": _HASHES[kind]}
        if kind in TYPE_HASHES:
            metadata |= {ROBOT: robot, SENSOR: sensor} if sensor else {ROBOT: robot}
        topic = self._topic(kind, robot, sensor)
        channel: int = self._writer.register_channel(topic, "cdr", schema, metadata)
        self._channels[kind, robot, sensor] = channel
        return channel

    def _topic(self, kind: str, robot: str, sensor: str) -> str:
        if kind == cdr.TF_MESSAGE:
            return "/tf"
        if kind == cdr.OCCUPANCY_GRID:
            return "/map"
        name = _token(robot, self._robots)
        if kind == POSE:
            return f"/ogm/robots/{name}/pose"
        sensor = _token(sensor, self._sensors.setdefault(robot, {}))
        return f"/ogm/robots/{name}/scan/{sensor}" if kind == SCAN else f"/{name}/{sensor}"


def base_frame(robot: str) -> str:
    """What a robot's base is called in tf."""
    return f"{robot}/base_link"


def sensor_frame(robot: str, sensor: str) -> str:
    """What a robot's sensor is called in tf."""
    frame = f"{robot}/{sensor}"
    return f"{frame}/scan" if frame == base_frame(robot) else frame


def _token(name: str, known: dict[str, str]) -> str:
    """A name as it may stand in a topic's: letters, digits and _, no digit first, and no other's."""
    if name not in known:
        plain = token = re.sub(r"^(?=\d)", "_", _NOT_IN_TOPICS.sub("_", name))
        number = 1
        while token in known.values():
            number += 1
            token = f"{plain}_{number}"
        known[name] = token
    return known[name]
