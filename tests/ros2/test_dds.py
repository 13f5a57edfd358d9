"""Nodes of ROS 2 as they are, on DDS: what they publish is listed and read; who comes late gets the map."""

import os
import random
from contextlib import ExitStack

import numpy as np
import pytest

import naive_cdr
import turtlebot4
from ogm_core.ros2 import cdr
from ogm_core.ros2.topics import Qos, Topic
from witness import rclpy_node

TYPES = {"/scan": cdr.LASER_SCAN, "/tf": cdr.TF_MESSAGE, "/tf_static": cdr.TF_MESSAGE}
RELIABLE = {"reliable": True, "latched": False, "depth": 100}
LATCHED = {"reliable": True, "latched": True, "depth": 1}


@pytest.fixture
def domain():
    """A domain that nobody else is in, by all odds."""
    pytest.importorskip("cyclonedds", reason="the extra dds is not installed")
    return random.Random(os.urandom(8)).randint(1, 101)


@pytest.fixture
def node(distribution, domain):
    """`node(name)` starts one."""
    with ExitStack() as running:
        yield lambda name: running.enter_context(rclpy_node(distribution, domain, name))


@pytest.fixture
def source(domain):
    from ogm_services.ros2.dds import DdsSource

    source = DdsSource(domain, "lo")
    yield source
    source.close()


def named(source, name):
    return next((topic for topic in source.topics() if topic.name == name and topic.node), None)


def test_what_a_node_publishes_is_listed(node, source, domain, eventually):
    robot = node("/r1/driver")
    robot.ask(publish="/r1/scan", type=cdr.LASER_SCAN, reliable=False, latched=False, depth=5)
    robot.ask(publish="/r1/tf_static", type=cdr.TF_MESSAGE, **LATCHED)
    scan, static = (
        eventually(lambda name=name: named(source, name)) for name in ("/r1/scan", "/r1/tf_static")
    )
    # DDS tells no depth of others' queues.
    assert scan == Topic(
        "dds", "/r1/scan", cdr.LASER_SCAN, "", Qos(False, False, scan.qos.depth), "/r1/driver", domain
    )
    assert (static.qos.reliable, static.qos.transient_local) == (True, True)


def test_all_that_a_robot_said_comes_as_it_was(node, source, datasets, eventually):
    said = list(turtlebot4.messages(datasets))
    robots = [node("/tb4/driver"), node("/tb4/urdf")]
    for number, message in enumerate(message for message in said if message.topic == "/tf_static"):
        robots[number].ask(publish="/tf_static", type=cdr.TF_MESSAGE, **LATCHED)
        robots[number].ask(put="/tf_static", cdr=message.payload.hex())  # before anyone listens
    came = {topic: [] for topic in TYPES}
    for topic in ("/scan", "/tf"):
        robots[0].ask(publish=topic, type=TYPES[topic], **RELIABLE)
    taken = [
        source.subscribe(eventually(lambda name=name: named(source, name)), found.append)
        for name, found in came.items()
    ]
    eventually(lambda: len(came["/tf_static"]) == 2)
    turtlebot4.play(said, robots[0], came, eventually)
    for topic, found in came.items():
        expected = [message.payload for message in said if message.topic == topic]
        if topic == "/tf_static":
            expected, found = sorted(expected), sorted(found)
        for one, other in zip(found, expected, strict=True):
            assert one[: len(other)] == other  # and up to three bytes of padding
    for subscription in taken:
        subscription.close()


def test_a_node_that_comes_late_gets_a_map_of_a_million_cells(node, source, eventually):
    data = np.random.default_rng(1).integers(-1, 101, (1000, 1024)).astype(np.int8)
    latched = source.publish_latched("/ogm/map", cdr.OCCUPANCY_GRID)
    latched.put(cdr.encode_occupancy_grid(cdr.OccupancyGrid(1, "map", 0.05, (-1.0, -2.0), data[:1, :1])))
    latched.put(cdr.encode_occupancy_grid(cdr.OccupancyGrid(2, "map", 0.05, (-1.0, -2.0), data)))
    viewer = node("/viewer")
    viewer.ask(subscribe="/ogm/map", type=cdr.OCCUPANCY_GRID, **LATCHED)
    (read,) = eventually(lambda: viewer.ask(take="/ogm/map")["values"])
    info = read["info"]
    assert (read["header"]["stamp"], info["width"], info["height"]) == ({"sec": 0, "nanosec": 2}, 1024, 1000)
    assert (info["origin"]["position"]["x"], info["resolution"]) == (-1.0, float(np.float32(0.05)))
    np.testing.assert_array_equal(read["data"], data.ravel())
    latched.close()


def test_robots_of_two_distributions_in_two_domains_are_not_mixed(domain, source, eventually):
    from ogm_services.ros2.dds import DdsSource

    other = DdsSource(domain % 101 + 1, "lo")
    scans = [scan_of(1.0), scan_of(2.0)]
    with (
        rclpy_node("jazzy", source.domain, "/driver") as one,
        rclpy_node("kilted", other.domain, "/driver") as two,
    ):
        robots, came = [(source, one), (other, two)], [[], []]
        for (there, robot), found in zip(robots, came, strict=True):
            robot.ask(publish="/scan", type=cdr.LASER_SCAN, **RELIABLE)
            there.subscribe(eventually(lambda there=there: named(there, "/scan")), found.append)
        eventually(lambda: all(robot.ask(heard="/scan")["count"] for _, robot in robots))
        for (_, robot), scan in zip(robots, scans, strict=True):
            robot.ask(put="/scan", cdr=scan.hex())
        eventually(lambda: all(came))
        assert [robot.ask(heard="/scan")["count"] for _, robot in robots] == [1, 1]
    assert came == [[scans[0]], [scans[1]]]
    other.close()


def scan_of(distance):
    return naive_cdr.laser_scan(5, "laser", (0, 0, 0.1, 0, 0, 0.1, 10), [distance, distance])
