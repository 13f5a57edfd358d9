"""A real robot, message by message: a TurtleBot 4, whose lidar looks to the left, on the map of its floor."""

import math
from contextlib import suppress
from itertools import pairwise

import pytest

import turtlebot4
from ogm_core.errors import NoPose, NoTransformYet
from ogm_core.placing.pose_history import PoseHistory
from ogm_core.ros2 import cdr
from ogm_core.ros2.base_poses import BasePoses, RobotFrames, robot_frames
from ogm_core.ros2.laser_scan import first_beam, mounted_scan
from ogm_core.ros2.tf_tree import TfTree
from ogm_core.types import Pose
from turtlebot4 import DELAY


@pytest.fixture(scope="module")
def robot(datasets):
    """What a gateway would have sent a mapper: poses and mounted scans, each as soon as it can be told."""
    tree, poses, history = TfTree(), None, PoseHistory()
    tree.add([turtlebot4.map_to_odom(datasets)], static=True)
    scans, waiting, stamps = [], [], []
    for topic, _, payload in turtlebot4.messages(datasets):
        if topic == "/scan":
            waiting.append(cdr.decode_laser_scan(payload))
        else:
            tree.add(cdr.decode_tf_message(payload), static=topic == "/tf_static")
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
    assert len(stamps) == turtlebot4.TRANSFORMS
    assert stamps == sorted(stamps)
    assert max(later - stamp for stamp, later in pairwise(stamps)) == pytest.approx(1.136e9, abs=1e6)
    assert not tree.counts


def test_all_scans_but_those_of_a_gap_have_a_pose(robot):
    *_, history, scans = robot
    assert len(scans) == turtlebot4.SCANS
    assert len(list(placed(history, scans))) >= 356


def test_poses_between_samples_are_those_of_a_lookup_in_3d(robot):
    tree, frames, _, history, scans = robot
    for scan, base in list(placed(history, scans))[-100:]:
        sensor = base.compose(scan.mount)
        looked_up = tree.lookup(frames.fixed, "rplidar_link", scan.stamp).planar()
        # The lidar is 14 cm above the base, which its odometry lets nod by up to a degree.
        assert math.dist(sensor[:2], looked_up[:2]) < 5e-3
        assert math.remainder(sensor.theta - looked_up.theta, math.tau) == pytest.approx(0.0, abs=1e-3)


def test_its_readings_lie_on_the_walls_of_its_floor(datasets, robot):
    *_, history, scans = robot
    hits, share = turtlebot4.on_walls(datasets, placed(history, scans))
    assert hits > 190_000
    assert share >= 0.85
