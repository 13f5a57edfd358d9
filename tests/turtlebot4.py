"""A real robot, recorded: a TurtleBot 4, and a map of its floor by others; README.md beside the data."""

import json
import math
from collections import Counter
from typing import NamedTuple

import numpy as np
from rosbags.rosbag2 import Reader
from scipy.ndimage import distance_transform_edt

from ogm_core.files.ros_map_reader import read_ros_map
from ogm_core.ros2.cdr import StampedTransform
from ogm_core.ros2.transform import Transform

DELAY = -0.1
"""Of its scans' stamps, s."""
SCANS, TRANSFORMS = 357, 953
TOPICS = ("/scan", "/tf", "/tf_static")
REACH = (0.2, 10.0)
"""Ranges that are compared with the map, m."""


class Message(NamedTuple):
    """A message as it was recorded; `time` in ns."""

    topic: str
    time: int
    payload: bytes


class OnWalls(NamedTuple):
    """How many hits were compared, and which share of them is within 0.1 m of an occupied cell."""

    hits: int
    share: float


def folder(datasets):
    return datasets / "olin-mac-turtlebot4"


def messages(datasets):
    """What it sent on TOPICS, in order."""
    with Reader(folder(datasets) / "rosbag2_sqlite3") as bag:
        for connection, time, payload in bag.messages():
            if connection.topic in TOPICS:
                yield Message(connection.topic, time, bytes(payload))


WAITING = 16
"""Of each topic so many may be on their way when a recording is played: fewer than a reader keeps."""


def play(said, robot, came, eventually):
    """Have a robot say again what moves, which it publishes already; `came`: what was received, by topic.

    It goes on when nearly all that it has said has come: how much queues hold is not what is tested. Its
    first scans come 3.5 s before their transforms, which they wait for.
    """
    eventually(lambda: all(robot.ask(heard=topic)["count"] for topic in ("/scan", "/tf")))
    sent = Counter()
    for message in said:
        if message.topic != "/tf_static":
            robot.ask(put=message.topic, cdr=message.payload.hex())
            sent[message.topic] += 1
            if sent.total() % 10 == 0:
                eventually(lambda: all(len(found) >= sent[topic] - WAITING for topic, found in came.items()))
    eventually(lambda: all(len(found) >= sent[topic] for topic, found in came.items()))


def alignment(datasets):
    """Where its odometry began, (x, y, theta) on the map of its floor."""
    found = json.loads((folder(datasets) / "alignment.json").read_text())["map_T_odom"]
    return found["x"], found["y"], found["theta"]


def map_to_odom(datasets):
    """The edge of tf that its recording lacks."""
    x, y, theta = alignment(datasets)
    aligned = Transform(x, y, 0.0, 0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2))
    return StampedTransform(0, "map", "odom", aligned)


def on_walls(datasets, placed):
    """How well readings fit the map of its floor; `placed`: scans, each with the pose of its base."""
    floor = read_ros_map(folder(datasets) / "map" / "mac_1st_floor_final.yaml")
    away = distance_transform_edt(floor.occupancy != 100) * floor.resolution
    distances = []
    for scan, base in placed:
        x, y, theta = base.compose(scan.mount)
        counted = np.isfinite(scan.ranges) & (scan.ranges > REACH[0]) & (scan.ranges < REACH[1])
        ranges = scan.ranges[counted].astype(float)
        bearings = theta + scan.angle_min + np.flatnonzero(counted) * scan.angle_increment
        ends = np.stack((x + ranges * np.cos(bearings), y + ranges * np.sin(bearings)))
        ix, iy = np.floor((ends.T - floor.origin[:2]) / floor.resolution).astype(int).T
        inside = (ix >= 0) & (ix < away.shape[1]) & (iy >= 0) & (iy < away.shape[0])
        distances.append(np.where(inside, away[iy * inside, ix * inside], np.inf))
    distances = np.concatenate(distances)
    return OnWalls(distances.size, float(np.mean(distances <= 0.1)))
