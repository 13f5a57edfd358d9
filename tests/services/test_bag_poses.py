"""Where bags say that robots were: poses of topics, of several robots, and scans of clouds."""

import math
import struct

import numpy as np
import pytest

import naive_cdr
import turtlebot4
from bag_files import Said, at, drive, mount, read_bag, scan, write_bag
from gateway_desk import MS, RANGES
from ogm_core.errors import BadRecording
from ogm_core.placing.pose_history import PoseHistory
from ogm_core.ros2.point_cloud import Flattening
from ogm_core.types import Pose
from ogm_services.ros2.bag_reader import BagOptions
from ogm_services.ros2.options import Ros2Options
from ogm_services.settings.robots import RobotSettings
from ogm_services.settings.settings import Settings

KINDS = {
    "geometry_msgs/msg/PoseStamped": naive_cdr.pose_stamped,
    "geometry_msgs/msg/PoseWithCovarianceStamped": naive_cdr.pose_with_covariance_stamped,
    "nav_msgs/msg/Odometry": lambda stamp, frame, numbers: naive_cdr.odometry(stamp, frame, "base", numbers),
}
MOUNTED = Pose(0.3, -0.1, 0.25)


def by_topic(*topics, **others):
    return BagOptions(Ros2Options(pose_topics=topics, mount=MOUNTED, **others))


def tilted(yaw, pitch, roll):
    """The quaternion (x, y, z, w) of a robot on a slope: its yaw, then its pitch, then its roll."""
    (cy, sy), (cp, sp), (cr, sr) = ((math.cos(a / 2), math.sin(a / 2)) for a in (yaw, pitch, roll))
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


@pytest.mark.parametrize("kind", KINDS)
def test_poses_of_a_topic(tmp_path, kind):
    """Of any of the three types: position, and the way the robot looks, seen from above."""
    yaws = [0.0, 1.0, 3.0, -3.0, -0.5]
    said = []
    for n, yaw in enumerate(yaws, 1):
        numbers = (1.5 * n, -0.5 * n, 0.2, *tilted(yaw, 0.1, 0.15))
        said += [Said("/amcl_pose", at(n), KINDS[kind](at(n), "map", numbers), kind), scan(at(n) - 20 * MS)]
    bag = read_bag(write_bag(tmp_path / "bag", said), by_topic("/amcl_pose"))
    assert [each.stamp for each in bag.poses] == [at(n) for n in range(1, 6)]
    assert [each.seq for each in bag.poses] == [0, 1, 2, 3, 4]
    for n, (yaw, told) in enumerate(zip(yaws, bag.poses, strict=True), 1):
        assert told.pose == pytest.approx(Pose(1.5 * n, -0.5 * n, yaw), abs=1e-12)
    assert [each.message.stamp for each in bag.scans] == [at(n) - 20 * MS for n in range(1, 6)]
    assert {each.message.mount for each in bag.scans} == {MOUNTED}
    assert bag.scans[0].message.ranges.tolist() == RANGES


def test_poses_of_a_topic_are_those_of_the_same_robots_tf(datasets):
    """The TurtleBot 4 tells its odometry twice; the mount is that of its tf, by hand."""
    folder = turtlebot4.folder(datasets) / "rosbag2_sqlite3"
    by_tf = read_bag(folder)
    told = by_tf.scans[0].message.mount
    assert told == pytest.approx(Pose(0.0039, 0.0, math.pi / 2), abs=1e-3)
    options = Ros2Options(pose_topics=("/odom",), mount=told)
    found = read_bag(folder, BagOptions(options))
    assert len(found.poses) > 900
    histories = []
    for bag in (by_tf, found):
        histories.append(PoseHistory())
        for each in bag.poses:
            histories[-1].append(each.stamp, each.pose)
    compared = 0
    for one, other in zip(by_tf.scans, found.scans, strict=True):
        assert one.message.stamp == other.message.stamp
        assert one.message.ranges.tobytes() == other.message.ranges.tobytes()
        if max(by_tf.poses[0].stamp, found.poses[0].stamp) < one.message.stamp < found.poses[-1].stamp:
            here, there = (history.at(one.message.stamp) for history in histories)
            assert here == pytest.approx(there, abs=1e-3)
            compared += 1
    assert compared > 300


def test_what_is_asked_of_pose_topics_must_be_there(tmp_path):
    bag = write_bag(tmp_path / "bag", [scan(at(1))])
    with pytest.raises(BadRecording, match=r"holds no tf, so nothing says where its scans were taken$"):
        read_bag(bag)
    with pytest.raises(BadRecording, match=r"--pose-topic /pose: no poses come from it; there are none"):
        read_bag(bag, by_topic("/pose"))
    kind = "geometry_msgs/msg/PoseStamped"
    pose = Said("/pose", at(1), KINDS[kind](at(1), "map", (1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0)), kind)
    bag = write_bag(tmp_path / "two", [pose, scan(at(1))])
    with pytest.raises(BadRecording, match=r"holds no tf, .*; --pose-topic takes poses from /pose$"):
        read_bag(bag)
    with pytest.raises(BadRecording, match=r"none of its 1 scans can be placed: .* --mount X,Y,THETA"):
        read_bag(bag, BagOptions(Ros2Options(pose_topics=("/pose",))))


def in_namespace(name, said):
    return [each._replace(topic=f"/{name}{each.topic}") for each in said]


def of_two_robots(parent):
    """Each with the same names of frames, at the same times."""
    return sorted(
        [
            *in_namespace("left", [mount(), *drive(parent=parent)]),
            *in_namespace("right", [mount(x=0.4), *drive(parent=parent)]),
        ],
        key=lambda message: message.time,
    )


def test_several_robots_of_one_bag(tmp_path):
    """By their namespaces; each has its own tf, and all have one map."""
    bag = read_bag(write_bag(tmp_path / "bag", of_two_robots("map")), BagOptions(scan_topics=("/*/scan",)))
    for robot, x in {"left": 0.2, "right": 0.4}.items():
        found = [each.message for each in bag.found if each.robot == robot]
        poses = [each.pose.x for each in found if each in bag.poses]
        assert poses == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
        mounts = [each.message.mount for each in bag.scans if each.robot == robot]
        assert mounts == [pytest.approx(Pose(x, 0.0, 0.5))] * 5
    assert {each.sensor for each in bag.scans} == {"scan"}


def test_several_robots_whose_odometries_have_nothing_in_common(tmp_path):
    """They are on one map if it is said where their frames lie in it; else only the first one is."""
    folder = write_bag(tmp_path / "bag", of_two_robots("odom"))
    every = BagOptions(scan_topics=("*",))
    alone = read_bag(folder, every)
    assert {each.robot for each in alone.scans} == {"left"}
    assert "5 of /right/scan: no_common_frame" in alone.reader.not_read
    robots = (
        RobotSettings(match=r"left", origin=Pose(0.0, 0.0, 0.0)),
        RobotSettings(match=r"right", origin=Pose(10.0, 5.0, math.pi / 2), name="second"),
    )
    both = read_bag(folder, every, settings=Settings(robots=robots))
    second = [
        each.message.pose for each in both.found if each.robot == "second" and each.message in both.poses
    ]
    assert [pose.x for pose in second] == pytest.approx([10.0] * 6)
    assert [pose.y for pose in second] == pytest.approx([5.1, 5.2, 5.3, 5.4, 5.5, 5.6])
    assert [pose.theta for pose in second] == pytest.approx([math.pi / 2] * 6)
    assert sum(each.robot == "second" for each in both.scans) == 5


def test_poses_of_several_robots_topics(tmp_path):
    said = []
    for n, name in enumerate(("a", "b"), 1):
        pose = naive_cdr.pose_stamped(at(1), "map", (float(n), 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        said += [Said(f"/{name}/pose", at(1), pose, "geometry_msgs/msg/PoseStamped")]
        said += [scan(at(1), topic=f"/{name}/scan")]
    options = BagOptions(Ros2Options(pose_topics=("/*/pose",), mount=MOUNTED), ("*",))
    bag = read_bag(write_bag(tmp_path / "bag", said), options)
    assert {each.robot: each.message.pose.x for each in bag.found if each.message in bag.poses} == {
        "a": 1.0,
        "b": 2.0,
    }
    assert sorted(each.robot for each in bag.scans) == ["a", "b"]


def cloud(stamp, points, topic="/points"):
    fields = [(name, 4 * n, 7) for n, name in enumerate("xyz")]
    data = b"".join(struct.pack("<fff", *point) for point in points)
    payload = naive_cdr.point_cloud2(stamp, "laser", (1, len(points)), fields, (12, 12 * len(points)), data)
    return Said(topic, stamp, payload, "sensor_msgs/msg/PointCloud2")


POINTS = [(2.0, 0.0, 0.5), (3.0, 0.0, 0.5), (0.0, 4.0, 0.5), (-1.0, 0.0, 9.0), (1.5, 0.0, 0.0)]
"""Two ahead, one to the left; one too high, and one on the floor."""


def test_clouds_become_scans(tmp_path):
    """Of each bearing the nearest point within the band; by the mount, which turns by 0.5 rad."""
    said = [mount(), *drive(), cloud(at(3), POINTS)]
    folder = write_bag(tmp_path / "bag", said)
    clouds = BagOptions(Ros2Options(cloud_topics=("/points",), flattening=Flattening(0.2, 1.0, bins=360)))
    bag = read_bag(folder, clouds)
    assert [(each.sensor, each.message.stamp) for each in bag.scans] == [("points", at(3))]
    (found,) = bag.scans
    assert found.message.mount == pytest.approx(Pose(0.2, 0.0, 0.0))
    seen = np.flatnonzero(np.isfinite(found.message.ranges))
    bearings = np.degrees(found.message.angle_min + seen * found.message.angle_increment)
    assert bearings.round().tolist() == [29.0, 119.0]  # 0.5 rad are 28.65 degrees
    assert found.message.ranges[seen].tolist() == pytest.approx([2.0, 4.0])
    assert bag.reader.scans == 1
    lower = BagOptions(Ros2Options(cloud_topics=("/points",), flattening=Flattening(-0.1, 1.0, bins=360)))
    ranges = read_bag(folder, lower).scans[0].message.ranges
    assert np.nanmin(ranges) == pytest.approx(1.5)


def test_clouds_are_asked_for_alone_or_beside_scans(tmp_path):
    folder = write_bag(tmp_path / "bag", [mount(), *drive(), cloud(at(3), POINTS)])
    assert {each.sensor for each in read_bag(folder).scans} == {"scan"}
    both = BagOptions(Ros2Options(cloud_topics=("/points",)), ("/scan",))
    assert {each.sensor for each in read_bag(folder, both).scans} == {"scan", "points"}
    with pytest.raises(BadRecording, match=r"--cloud-topic /p: .* no such PointCloud2; .* /points \(1\)"):
        read_bag(folder, BagOptions(Ros2Options(cloud_topics=("/p",))))
    only = write_bag(tmp_path / "clouds", [mount(), cloud(at(3), POINTS)])
    with pytest.raises(BadRecording, match=r"holds no LaserScan; .*; --cloud-topic makes scans of /points$"):
        read_bag(only)


def test_scans_with_too_many_beams_are_counted(tmp_path):
    """As a mapper would not take them: `mapper.max_beams` holds for bags, too."""
    folder = write_bag(tmp_path / "bag", [mount(), *drive()])
    settings = Settings(mapper={"max_beams": 2})
    with pytest.raises(BadRecording, match=r"none of its 5 scans can be placed: .*malformed"):
        read_bag(folder, settings=settings)
    assert len(read_bag(folder, settings=Settings(mapper={"max_beams": 3})).scans) == 5
