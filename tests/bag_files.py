"""Bags of a robot that drives along x, written by rosbags from messages that naive_cdr makes, and read."""

from types import SimpleNamespace
from typing import NamedTuple

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

import naive_cdr
from gateway_desk import MS, RANGES, planar
from ogm_core.logs.recorded import RecordedPose, RecordedScan
from ogm_services.ros2.bag_reader import BagOptions, BagReader
from ogm_services.settings.settings import Settings

STORE = get_typestore(Stores.ROS2_HUMBLE)


class Said(NamedTuple):
    """A message of a topic; `time` is when it was written, ns."""

    topic: str
    time: int
    payload: bytes
    type: str = "sensor_msgs/msg/LaserScan"


def tf(time, *edges, topic="/tf"):
    return Said(topic, time, naive_cdr.tf_message(list(edges)), "tf2_msgs/msg/TFMessage")


def scan(stamp, frame="laser", topic="/scan", time=None):
    numbers = (-0.5, 0.5, 0.5, 0.0, 0.1, 0.1, 10.0)
    payload = naive_cdr.laser_scan(stamp, frame, numbers, RANGES)
    return Said(topic, stamp if time is None else time, payload)


def at(n):
    return n * 100 * MS


def edge(stamp, parent, child, *pose):
    return stamp, parent, child, planar(*(pose or (0.0, 0.0, 0.0)))


def mount(time=0, x=0.2):
    return tf(time, edge(0, "base_link", "laser", x, 0.0, 0.5), topic="/tf_static")


def drive(count=6, parent="odom", frame="laser"):
    """Poses each 0.1 s at 1 m/s, and a scan 50 ms before each but the first."""
    for n in range(1, count + 1):
        stamp = at(n)
        yield tf(stamp, edge(stamp, parent, "base_link", stamp / 1e9, 0.0, 0.0))
        if n > 1:
            yield scan(stamp - 50 * MS, frame, time=stamp)


def write_bag(path, said, plugin=StoragePlugin.SQLITE3, version=9, writer=None):
    """A folder of rosbag2, with its messages as they are given."""
    with writer or Writer(path, version=version, storage_plugin=plugin) as writer:
        connections = {}
        for message in said:
            key = message.topic, message.type
            if key not in connections:
                connections[key] = writer.add_connection(message.topic, message.type, typestore=STORE)
            writer.write(connections[key], message.time, message.payload)
    return path


def read_bag(path, options=None, settings=None, **others):
    """What a BagReader makes of a bag, and the reader."""
    reader = BagReader(path, options or BagOptions(), settings or Settings(), **others)
    with reader:
        found = list(reader)
    poses = [each.message for each in found if isinstance(each, RecordedPose)]
    scans = [each for each in found if isinstance(each, RecordedScan)]
    return SimpleNamespace(reader=reader, found=found, poses=poses, scans=scans)
