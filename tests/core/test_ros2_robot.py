"""A real robot, message by message: a TurtleBot 4, whose lidar looks to the left, on the map of its floor."""

import json
import math
from contextlib import suppress
from itertools import pairwise

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from scipy.ndimage import distance_transform_edt

from ogm_core.errors import NoPose, NoTransformYet
from ogm_core.files.ros_map_reader import read_ros_map
from ogm_core.placing.pose_history import PoseHistory
from ogm_core.ros2 import cdr
from ogm_core.ros2.base_poses import BasePoses, RobotFrames, robot_frames
from ogm_core.ros2.cdr import StampedTransform
from ogm_core.ros2.laser_scan import first_beam, mounted_scan
from ogm_core.ros2.tf_tree import TfTree
from ogm_core.ros2.transform import Transform
from ogm_core.types import Pose

DELAY = -0.1


@pytest.fixture(scope="module")
def olin(datasets):
    return datasets / "olin-mac-turtlebot4"


@pytest.fixture(scope="module")
def robot(olin):
    """What a gateway would have sent a mapper: poses and mounted scans, each as soon as it can be told."""
    found = json.loads((olin / "alignment.json").read_text())["map_T_odom"]
    half = found["theta"] / 2
    aligned = Transform(found["x"], found["y"], 0, 0, 0, math.sin(half), math.cos(half))
    tree, poses, history = TfTree(), None, PoseHistory()
    tree.add([StampedTransform(0, "map", "odom", aligned)], static=True)
    scans, waiting, stamps = [], [], []
    with Reader(olin / "rosbag2_sqlite3") as bag:
        for connection, _, raw in bag.messages():
            if connection.topic in ("/tf", "/tf_static"):
                tree.add(cdr.decode_tf_message(raw), static=connection.topic == "/tf_static")
            elif connection.topic == "/scan":
                waiting.append(cdr.decode_laser_scan(raw))
            if poses is None and waiting:
                try:
                    frames = robot_frames(tree, waiting[0].frame)
                except NoTransformYet:
                    continue
                poses = BasePoses(tree, frames)
            if poses is None:
                continue
            for stamp, pose in poses.take():
                stamps.append(stamp)
                history.append(stamp, pose)
            while waiting:
                message = waiting.pop(0)
                mount = tree.lookup(frames.base, message.frame, first_beam(message, delay=DELAY))
                scans.append(mounted_scan(message, mount, delay=DELAY, seq=len(scans)))
    return tree, frames, stamps, history, scans


def placed(history, scans):
    for scan in scans:
        with suppress(NoPose):
            yield scan, history.at(scan.stamp)


def test_its_frames_and_its_lidar(robot):
    tree, frames, stamps, _, scans = robot
    assert frames == RobotFrames("map", "base_link", False)
    assert tree.path("rplidar_link") == ("rplidar_link", "base_link", "odom", "map")
    assert len(tree.frames) == 39
    assert {scan.mount for scan in scans} == {scans[0].mount}
    assert scans[0].mount == pytest.approx(Pose(0.0039, 0.0, math.pi / 2), abs=1e-4)
    assert len(stamps) == 953
    assert stamps == sorted(stamps)
    assert max(later - stamp for stamp, later in pairwise(stamps)) == pytest.approx(1.136e9, abs=1e6)
    assert not tree.counts


def test_all_scans_but_those_of_a_gap_have_a_pose(robot):
    *_, history, scans = robot
    assert len(scans) == 357
    assert len(list(placed(history, scans))) >= 356


def test_poses_between_samples_are_those_of_a_lookup_in_3d(robot):
    tree, frames, _, history, scans = robot
    for scan, base in list(placed(history, scans))[-100:]:
        sensor = base.compose(scan.mount)
        looked_up = tree.lookup(frames.fixed, "rplidar_link", scan.stamp).planar()
        # The lidar is 14 cm above the base, which its odometry lets nod by up to a degree.
        assert math.dist(sensor[:2], looked_up[:2]) < 5e-3
        assert math.remainder(sensor.theta - looked_up.theta, math.tau) == pytest.approx(0.0, abs=1e-3)


def test_its_readings_lie_on_the_walls_of_its_floor(olin, robot):
    *_, history, scans = robot
    floor = read_ros_map(olin / "map" / "mac_1st_floor_final.yaml")
    away = distance_transform_edt(floor.occupancy != 100) * floor.resolution
    distances = []
    for scan, base in placed(history, scans):
        x, y, theta = base.compose(scan.mount)
        counted = np.isfinite(scan.ranges) & (scan.ranges > 0.2) & (scan.ranges < 10.0)
        ranges = scan.ranges[counted].astype(float)
        bearings = theta + scan.angle_min + np.flatnonzero(counted) * scan.angle_increment
        ends = np.stack((x + ranges * np.cos(bearings), y + ranges * np.sin(bearings)))
        ix, iy = np.floor((ends.T - floor.origin[:2]) / floor.resolution).astype(int).T
        inside = (ix >= 0) & (ix < away.shape[1]) & (iy >= 0) & (iy < away.shape[0])
        distances.append(np.where(inside, away[iy * inside, ix * inside], np.inf))
    distances = np.concatenate(distances)
    assert distances.size > 190_000
    assert np.mean(distances <= 0.1) >= 0.85
