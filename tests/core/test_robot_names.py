import pytest

from ogm_core.errors import NoCommonFrame
from ogm_core.ros2.common_frame import CommonFrame
from ogm_core.ros2.robot_names import longest_namespace, prefix_of, robot_name, sensor_name
from ogm_core.types import Pose
from ogm_core.wire.keys import NAME


@pytest.mark.parametrize(
    ("namespace", "prefix", "name"),
    [
        ("", "", "domain0"),
        ("/r1", "", "r1"),
        ("", "r1", "r1"),
        ("/fleet/r1", "", "fleet.r1"),
        ("/r1", "r1", "r1"),  # the prefix says it again
        ("/fleet/r1", "r1", "fleet.r1"),
        ("/site", "a", "site.a"),
        ("/1", "r1", "1.r1"),
        ("", "a b/\u00e9", "a_b._"),
        ("/" + "x" * 70, "", "x" * 64),
    ],
)
def test_a_robots_name(namespace, prefix, name):
    assert robot_name(namespace, prefix, "domain0") == name
    assert NAME.fullmatch(name)


@pytest.mark.parametrize(
    ("topic", "namespace", "robot", "name"),
    [
        ("/scan", "", "domain0", "scan"),
        ("/r1/scan", "/r1", "r1", "scan"),
        ("/r1/front/scan", "/r1", "r1", "front.scan"),
        ("/r1/scan", "", "r1", "scan"),
        ("/r10/scan", "", "r1", "r10.scan"),
        ("/fleet/r1/scan", "", "fleet.r1", "scan"),
        ("/rear/scan", "", "domain0", "rear.scan"),
    ],
)
def test_a_sensors_name(topic, namespace, robot, name):
    assert sensor_name(topic, namespace, robot) == name


def test_the_longest_namespace_that_a_topic_is_in():
    assert longest_namespace("/a/b/scan", ["", "/a", "/a/b", "/a/bc"]) == "/a/b"
    assert longest_namespace("/ab/scan", ["", "/a"]) == ""
    assert longest_namespace("/scan", ["/a"]) is None
    assert (prefix_of("a/b/laser"), prefix_of("laser")) == ("a/b", "")


def test_robots_share_the_map_frame_and_no_odometry():
    frames = CommonFrame("map")
    for robot in "abc":
        frames.admit(robot, "map", None)
    with pytest.raises(NoCommonFrame, match=r"in odom, those of a in map.*map -> odom.*'d:origin=X,Y,THETA'"):
        frames.admit("d", "odom", None)
    frames.admit("d", "odom", Pose(1.0, 2.0, 0.0))


def test_one_odometry_is_alone_until_it_has_a_map():
    frames = CommonFrame("map")
    frames.admit("a", "odom", None)
    frames.admit("a", "odom", None)
    for fixed in ("odom", "map", "b/map"):
        with pytest.raises(NoCommonFrame, match="those of a in odom of a"):
            frames.admit("b", fixed, None)
    frames.admit("a", "map", None)
    frames.admit("b", "map", None)
