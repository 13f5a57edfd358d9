"""Programs by others that speak as rmw_zenoh does: what they publish is listed and read; they get the map."""

from contextlib import ExitStack

import numpy as np
import pytest

import turtlebot4
from ogm_client.session import NetworkConfig, open_session
from ogm_core.ros2 import cdr
from ogm_core.ros2.topics import TYPE_HASHES, Qos, Topic
from ogm_services.ros2.rmw_zenoh import RmwZenohSource
from witness import zenoh_node

DOMAIN = 7
TYPES = {"/scan": cdr.LASER_SCAN, "/tf": cdr.TF_MESSAGE, "/tf_static": cdr.TF_MESSAGE}
DECODERS = {cdr.LASER_SCAN: cdr.decode_laser_scan, cdr.TF_MESSAGE: cdr.decode_tf_message}
RELIABLE = {"reliable": True, "latched": False, "depth": 10}


@pytest.fixture(params=["pyzeros", "sdk"])
def library(request):
    return request.param


@pytest.fixture
def node(library, listener, endpoint):
    """`node(name)` starts one."""
    with ExitStack() as running:
        yield lambda name: running.enter_context(zenoh_node(library, DOMAIN, endpoint, name))


@pytest.fixture
def source(listener, endpoint):
    with open_session(NetworkConfig(connect=(endpoint,))) as session:
        source = RmwZenohSource(session, DOMAIN, endpoint)
        yield source
        source.close()


def named(source, name):
    return next((topic for topic in source.topics() if topic.name == name), None)


def test_what_a_node_publishes_is_listed(node, source, eventually):
    robot = node("/r1/driver")
    robot.ask(publish="/r1/scan", type=cdr.LASER_SCAN, **RELIABLE)
    found = eventually(lambda: named(source, "/r1/scan"))
    expected = ("rmw_zenoh", "/r1/scan", cdr.LASER_SCAN, TYPE_HASHES[cdr.LASER_SCAN])
    assert found == Topic(*expected, Qos(True, False, 10), "/r1/driver", DOMAIN)


def test_all_that_a_robot_said_comes_as_it_was(node, source, datasets, eventually):
    said = list(turtlebot4.messages(datasets))
    robot, came = node("/tb4/driver"), {topic: [] for topic in TYPES}
    for topic, kind in TYPES.items():
        robot.ask(publish=topic, type=kind, **RELIABLE)
        source.subscribe(eventually(lambda name=topic: named(source, name)), came[topic].append)
    eventually(lambda: robot.ask(heard="/tf_static")["count"])
    for message in said:
        if message.topic == "/tf_static":
            robot.ask(put="/tf_static", cdr=message.payload.hex())
    turtlebot4.play(said, robot, came, eventually)
    eventually(lambda: len(came["/tf_static"]) == 2)
    for topic, kind in TYPES.items():
        expected = [message.payload for message in said if message.topic == topic]
        for one, other in zip(came[topic], expected, strict=True):
            assert_same(DECODERS[kind](one), DECODERS[kind](other))


def assert_same(one, other):
    if isinstance(one, tuple):
        assert one == other
        return
    for name in one.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), strict=True)


def test_a_node_gets_the_map(library, node, source, eventually):
    """One that comes late where it knows how to ask; pyzeros does not, and gets the next.

    zenoh-ros2-sdk asks wrongly for what is kept of topics whose names have two parts, so it is /map.
    """
    data = np.random.default_rng(1).integers(-1, 101, (1000, 1024)).astype(np.int8)
    first = cdr.OccupancyGrid(1, "map", 0.05, (-1.0, -2.0), data[:1, :1])
    last = cdr.OccupancyGrid(2, "map", 0.05, (-1.0, -2.0), data)
    latched = source.publish_latched("/map", cdr.OCCUPANCY_GRID)
    latched.put(cdr.encode_occupancy_grid(first))
    latched.put(cdr.encode_occupancy_grid(last))
    viewer = node("/viewer")
    viewer.ask(subscribe="/map", type=cdr.OCCUPANCY_GRID, reliable=True, latched=True, depth=1)

    def read():
        if library == "pyzeros":
            latched.put(cdr.encode_occupancy_grid(last))
        return viewer.ask(take="/map")["values"]

    read = eventually(read)[-1]
    info = read["info"]
    assert (read["header"]["stamp"], info["width"], info["height"]) == ({"sec": 0, "nanosec": 2}, 1024, 1000)
    assert (info["origin"]["position"]["x"], info["resolution"]) == (-1.0, float(np.float32(0.05)))
    np.testing.assert_array_equal(read["data"], data.ravel())
    latched.close()


@pytest.mark.parametrize("library", ["sdk"], indirect=True)
def test_others_know_who_publishes_the_map_and_how(node, source, eventually):
    latched = source.publish_latched("/map", cdr.OCCUPANCY_GRID)
    viewer = node("/viewer")
    (told,) = eventually(lambda: viewer.ask(told="/map")["publishers"])
    assert told == [
        *("/", "ogm", cdr.OCCUPANCY_GRID, TYPE_HASHES[cdr.OCCUPANCY_GRID]),
        *("RELIABLE", "TRANSIENT_LOCAL", 1),
    ]
    latched.close()


@pytest.mark.parametrize("library", ["pyzeros"], indirect=True)
def test_messages_are_numbered_and_say_whose_they_are(node, source, eventually):
    latched = source.publish_latched("/map", cdr.OCCUPANCY_GRID)
    viewer = node("/viewer")
    viewer.ask(subscribe="/map", type=cdr.OCCUPANCY_GRID, reliable=True, latched=False, depth=1)
    grid = cdr.encode_occupancy_grid(cdr.OccupancyGrid(1, "map", 0.05, (0.0, 0.0), np.zeros((1, 1), np.int8)))

    def two_came():
        latched.put(grid)
        return len(viewer.ask(take="/map")["values"]) >= 2

    eventually(two_came)
    (first, ours), (second, also_ours) = viewer.ask(attached="/map")["told"][:2]
    assert (second - first, ours, also_ours) == (1, True, True)
    latched.close()
