"""Poses of a robot's base from tf: one at each sample of the fastest edge, in the map frame, in order."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import naive_tf
from ogm_core.errors import NoTransform, NoTransformYet
from ogm_core.ros2.base_poses import BasePoses, RobotFrames, robot_frames
from ogm_core.ros2.cdr import StampedTransform
from ogm_core.ros2.tf_tree import TfTree
from ogm_core.ros2.transform import Transform

MS = 10**6
S = 10**9
MAPPED = RobotFrames("map", "base", False)


def at(x=0.0, y=0.0, yaw=0.0):
    return Transform(x, y, 0.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


def edge(stamp, parent, child, transform=None):
    return StampedTransform(stamp, parent, child, at() if transform is None else transform)


def tree_of(*names, moving=()):
    """A chain of frames from the root down; those named in `moving` have a sample at 0 and at 100 ms."""
    tree = TfTree()
    for parent, child in pairwise(names):
        if child in moving:
            tree.add([edge(0, parent, child), edge(100 * MS, parent, child)])
        else:
            tree.add([edge(0, parent, child)], static=True)
    return tree


@pytest.mark.parametrize(
    ("names", "moving", "expected"),
    [
        (("map", "odom", "base_footprint", "base_link", "laser"), ("odom", "base_footprint"), 2),
        (("earth", "map", "odom", "base_link", "laser"), ("odom", "base_link"), 3),
        (("odom", "base_link", "laser"), ("base_link",), 1),
        (("r1/map", "r1/odom", "r1/base", "r1/laser"), ("r1/base",), 2),
        (("map", "r1/odom", "r1/base", "r1/laser"), ("r1/odom", "r1/base"), 2),
        (("map", "base", "mast", "laser"), ("base",), 1),
        (("map", "base", "mast", "laser"), ("base", "laser"), 1),  # the laser pans
        (("map", "odom", "base", "laser"), ("odom",), 2),  # odom -> base stands still
        (("map", "laser"), ("laser",), 1),
        (("map", "post", "laser"), (), 1),
        (("odom", "map", "base", "laser"), ("base",), 2),
    ],
)
def test_the_frames_of_a_robot(names, moving, expected):
    frames = robot_frames(tree_of(*names, moving=moving), names[-1])
    plain = [name.rpartition("/")[2] for name in names]
    fixed = names[plain.index("map")] if "map" in plain else names[plain.index("odom")]
    assert frames == RobotFrames(fixed, names[expected], "map" not in plain)


def test_other_names_are_taken_where_they_are_given():
    tree = tree_of("world", "wheels", "body", "laser", moving=("wheels", "body"))
    frames = robot_frames(tree, "laser", map_frame="world", odom_frame="wheels")
    assert frames == RobotFrames("world", "body", False)
    with pytest.raises(NoTransformYet) as caught:
        robot_frames(tree, "laser")
    assert str(caught.value) == (
        "no transform from laser to map: tf leads up from it to world only; "
        "there are body, laser, wheels, world"
    )
    with pytest.raises(NoTransformYet, match="no tf says where lidar is"):
        robot_frames(tree, "lidar")
    tree.add([edge(0, "laser", "world")], static=True)
    with pytest.raises(NoTransform, match="loop"):
        robot_frames(tree, "laser")


def test_there_is_one_pose_at_each_sample_of_the_fastest_edge():
    tree = TfTree()
    poses = BasePoses(tree, MAPPED)
    assert poses.take() == []
    tree.add([edge(0, "map", "odom"), edge(400 * MS, "map", "odom", at(y=4))])
    assert poses.take() == []
    tree.add(edge(n * 100 * MS, "odom", "base", at(x=n)) for n in range(3))
    found = poses.take()
    assert [stamp for stamp, _ in found] == [0, 100 * MS, 200 * MS]
    np.testing.assert_allclose([pose for _, pose in found], [[0, 0, 0], [1, 1, 0], [2, 2, 0]])
    assert poses.take() == []
    tree.add([edge(300 * MS, "odom", "base", at(x=3))])
    ((stamp, pose),) = poses.take()
    assert (stamp, pose) == (300 * MS, pytest.approx((3, 3, 0)))


def test_the_slow_edge_is_held_and_then_waited_for():
    tree = TfTree(tf_hold=0.3)
    poses = BasePoses(tree, MAPPED)
    tree.add([edge(0, "map", "odom", at(x=10)), *(edge(n * 100 * MS, "odom", "base") for n in range(7))])
    assert [(stamp // MS, pose.x) for stamp, pose in poses.take()] == [(n * 100, 10.0) for n in range(4)]
    assert poses.take() == []
    tree.add([edge(500 * MS, "map", "odom", at(x=12))])
    found = poses.take()
    assert [stamp // MS for stamp, _ in found] == [400, 500, 600]
    assert [pose.x for _, pose in found] == pytest.approx([11.6, 12, 12])
    assert not poses.counts


def test_where_the_slow_edge_cannot_be_told_there_is_no_pose_and_the_next_ones_come():
    tree = TfTree(tf_hold=0.3)
    poses = BasePoses(tree, MAPPED)
    tree.add([edge(200 * MS, "map", "odom"), *(edge(n * 100 * MS, "odom", "base") for n in range(14))])
    assert [stamp // MS for stamp, _ in poses.take()] == [200, 300, 400, 500]
    tree.add([edge(1200 * MS, "map", "odom", at(x=9))])
    assert [stamp // MS for stamp, _ in poses.take()] == [1200, 1300]
    assert poses.counts == {"oldest": 2, "gap": 6}


def test_poses_stay_in_the_order_of_their_stamps():
    tree = TfTree()
    poses = BasePoses(tree, RobotFrames("odom", "base", True))
    tree.add(edge(stamp, "odom", "base") for stamp in (5, 3, 9))
    assert [stamp for stamp, _ in poses.take()] == [3, 5, 9]
    tree.add(edge(stamp, "odom", "base") for stamp in (7, 11, 9))
    assert [stamp for stamp, _ in poses.take()] == [11]


def test_a_clock_that_is_set_back_begins_anew():
    tree = TfTree()
    poses = BasePoses(tree, RobotFrames("odom", "base", True))
    tree.add([edge(10**18, "odom", "base")])
    assert len(poses.take()) == 1
    tree.add([edge(7, "odom", "base"), edge(8, "odom", "base")])
    assert [stamp for stamp, _ in poses.take()] == [7, 8]


def test_what_moves_above_a_base_that_stands_in_odom_gives_the_poses():
    tree = TfTree(tf_hold=0.0)
    poses = BasePoses(tree, MAPPED)
    tree.add([edge(0, "odom", "base", at(x=1))], static=True)
    tree.add(edge(n, "map", "odom", at(x=n)) for n in range(3))
    assert [(stamp, pose.x) for stamp, pose in poses.take()] == [(0, 1.0), (1, 2.0), (2, 3.0)]


def test_a_robot_on_a_ramp_is_composed_in_3d_and_projected_once():
    # The map is tilted against odom; on it the robot drives ahead, turned by 90 degrees.
    ramp = naive_tf.about([1, 0, 0], 0.3)
    tree = TfTree()
    tree.add([edge(0, "map", "odom", Transform(0, 0, 1, math.sin(0.15), 0, 0, math.cos(0.15)))], static=True)
    tree.add([edge(0, "odom", "base", at(x=1, y=2, yaw=math.pi / 2))])
    ((_, pose),) = BasePoses(tree, MAPPED).take()
    x, y, _ = ramp @ [1, 2, 0]
    assert pose == pytest.approx((x, y, math.pi / 2))
    assert pose.y == pytest.approx(2 * math.cos(0.3))


@given(st.lists(st.integers(0, 19), min_size=1, max_size=40), st.data())
def test_however_messages_are_mixed_each_stamp_gives_one_pose_at_most(order, data):
    tree = TfTree()
    poses = BasePoses(tree, MAPPED)
    given = []
    for n in order:
        child = data.draw(st.sampled_from(["odom", "base"]))
        tree.add([edge(n * 50 * MS, {"odom": "map", "base": "odom"}[child], child, at(x=n))])
        given += poses.take()
    stamps = [stamp for stamp, _ in given]
    assert stamps == sorted(set(stamps))
    assert set(stamps) <= {n * 50 * MS for n in order}


def test_a_common_map_is_preferred_to_a_robot_s_own():
    tree = tree_of("map", "r1/map", "r1/odom", "r1/base", "r1/laser", moving=("r1/odom", "r1/base"))
    assert robot_frames(tree, "r1/laser") == RobotFrames("map", "r1/base", False)
