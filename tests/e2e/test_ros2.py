"""`ogm ros2` as a process beside a mapper: it lists, maps, outlives the mapper and ends at Ctrl-C."""

import json
import math
import random
import re
import signal
import threading

import pytest
from rosbags.typesys import Stores, get_typestore

import naive_cdr
from ogm_client import RobotPublisher
from ogm_client.session import NetworkConfig, open_session
from ros2_robots import RmwZenohRobot

MS = 10**6


@pytest.fixture
def robot(listener, endpoint):
    """A robot behind the router at `endpoint`, which drives till its end."""
    with open_session(NetworkConfig(connect=(endpoint,))) as session:
        node = RmwZenohRobot(session, namespace="/cart")
        static = node.publisher("/cart/tf_static", "TFMessage", latched=True)
        static(naive_cdr.tf_message([(0, "base_link", "laser", (0.0, 0, 0, 0, 0, 0, 1))]))
        tf, scan = node.publisher("/cart/tf", "TFMessage"), node.publisher("/cart/scan", "LaserScan")
        ending = threading.Event()

        def drive():
            n = 0
            while not ending.wait(0.02):
                n += 1
                turned = (0.0, 0.0, 0.0, 0.0, 0.0, math.sin(n / 200), math.cos(n / 200))
                still = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
                edges = [(n * 20 * MS, "map", "odom", still), (n * 20 * MS, "odom", "base_link", turned)]
                tf(naive_cdr.tf_message(edges))
                numbers = (-1.0, 1.0, 0.02, 0.0, 0.1, 0.1, 10.0)
                scan(naive_cdr.laser_scan(n * 20 * MS - 10 * MS, "laser", numbers, [2.0] * 101))

        driving = threading.Thread(target=drive)
        driving.start()
        yield node
        ending.set()
        driving.join()


def test_a_robot_is_mapped_and_outlives_the_mapper(ogm, robot, endpoint, eventually):
    mapper = ogm.ready(ogm.mapper())
    feed = ogm.start("ros2", "--zenoh", endpoint, "--connect", mapper.endpoint)

    def integrated(mapper):
        return mapper.status()["scans"]["integrated"]

    eventually(lambda: integrated(mapper) > 20)
    status = mapper.status()
    assert status["robots"]["cart"]["sources"].keys() == {"scan"}
    assert status["scans"]["dropped"]["no_pose"] == 0
    mapper.command.stop(signal.SIGKILL)
    again = ogm.ready(ogm.start("mapper", "--http-port", "0", "--listen", mapper.endpoint))
    eventually(lambda: integrated(again) > 20)
    ended = feed.stop(signal.SIGINT)
    assert (ended.code, ended.out) == (0, "")
    assert re.sub(".* no mapper of map 'default' takes .*\n", "", ended.warnings) == ""  # on a busy machine
    assert f"looking for robots: rmw_zenoh at {endpoint}, domain 0" in ended.err
    assert "cart/scan: " in ended.err
    assert " sent" in ended.err


def test_topics_are_listed(ogm, robot, endpoint):
    ended = ogm.run("ros2", "--list", "--json", "--zenoh", endpoint)
    assert ended.code == 0, ended
    listed = {topic["topic"]: topic for topic in json.loads(ended.out)}
    assert listed.keys() == {"/cart/tf_static", "/cart/tf", "/cart/scan"}
    scan = listed["/cart/scan"]
    assert (scan["source"], scan["domain"], scan["node"]) == ("rmw_zenoh", 0, "/cart/driver")
    assert scan["type"] == "sensor_msgs/msg/LaserScan"
    assert scan["qos"] == {"reliable": False, "transient_local": False, "depth": 5}


def test_a_list_of_what_nobody_answers_for_ends(ogm, endpoint):
    ended = ogm.run("ros2", "--list", "--json", "--zenoh", endpoint)
    assert ended.complaint(1).startswith(
        f"ogm: cannot connect to {endpoint}: does the router of rmw_zenoh, or a "
        "zenoh-bridge-ros2dds, run on the robot"
    )


def test_a_map_is_not_published_on_another_nodes_topic(ogm, robot, endpoint):
    robot.publisher("/map", "OccupancyGrid", latched=True)
    ended = ogm.run("ros2", "--zenoh", endpoint, "--connect", endpoint, "--publish-map", "/map")
    assert ended.complaint(2) == (
        f"ogm: /map: /cart/driver publishes it already (rmw_zenoh at {endpoint}, domain 0), as who gives map "
        "-> odom usually does; publish on another topic, such as /ogm/map\n"
    )


def test_a_node_asks_for_the_map_as_it_is_then(ogm, listener, endpoint, eventually):
    """With GetMap, beside the topic; `ogm erase` is seen at once."""
    mapper = ogm.ready(ogm.mapper())
    with RobotPublisher("box", address=mapper.endpoint, reliable=True) as box:
        looks = {"angle_min": -3.0, "angle_increment": 0.01, "range_min": 0.1, "range_max": 10.0}
        box.publish_scan([2.0] * 600, **looks, pose=(0.0, 0.0, 0.0))
        eventually(lambda: mapper.status()["revision"] == 1)
    ogm.start("ros2", "--zenoh", endpoint, "--connect", mapper.endpoint, "--publish-map", "/ogm/map")
    with open_session(NetworkConfig(connect=(endpoint,))) as session:
        saver = RmwZenohRobot(session, node="saver")
        eventually(lambda: saver.call("/ogm/get_map"))
        known = []
        for erased in (False, True):
            if erased:
                area = ("erase", "--region=0.5,-1,1.5,1", "--url", mapper.endpoint)
                assert ogm.run(*area).out.endswith(" cells erased\n")
            ((payload, _),) = saver.call("/ogm/get_map")
            grid = get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr(payload, "nav_msgs/msg/OccupancyGrid")
            said = json.loads(mapper.get("map.json?values=trinary"))
            assert grid.data.tolist() == said["data"]
            assert (grid.info.width, grid.info.height) == (said["width"], said["height"])
            assert (grid.info.origin.position.x, grid.header.frame_id) == (said["origin"]["x"], "map")
            known.append(sum(cell >= 0 for cell in said["data"]))
        assert 200 < known[1] < known[0] - 200


def test_topics_on_dds_are_listed_with_interface_and_domain(ogm):
    pytest.importorskip("cyclonedds", reason="the extra dds is not installed")
    from ogm_core.ros2 import cdr
    from ogm_services.ros2.dds import DdsSource

    domain = random.randint(1, 101)
    source = DdsSource(domain, "lo")
    latched = source.publish_latched("/r1/tf_static", cdr.TF_MESSAGE)
    try:
        ended = ogm.run("ros2", "--list", "--dds", "--interface", "lo", "--domain", domain)
    finally:
        latched.close()
        source.close()
    assert ended.code == 0, ended
    assert f"looking for robots: DDS on lo, domain {domain}" in ended.err
    row = next(line for line in ended.out.splitlines() if "/r1/tf_static" in line)
    assert ["dds", str(domain)] == row.split()[:2]
