"""The Foxglove bridge, seen by a viewer that speaks the protocol: map, robots, scans, and what goes away."""

import math
import struct
import threading
from contextlib import contextmanager

import numpy as np
import pytest

from foxglove_viewer import protobuf, vector, viewing
from ogm_client import MapClient
from ogm_client.session import NetworkConfig, open_session
from ogm_core.errors import OgmError
from ogm_core.ros2.typestore import typestore
from ogm_core.status import RobotStatus
from ogm_core.types import Pose, PoseStamped, Scan
from ogm_core.wire.keys import Source
from ogm_core.wire.messages import encode_pose, encode_scan
from ogm_services.foxglove import heard_robots, map_channel, robot_channels
from ogm_services.foxglove.bridge import FoxgloveBridge
from ogm_services.foxglove.heard_robots import Heard, HeardRobots
from ogm_services.foxglove.robot_channels import RobotChannels
from ogm_services.foxglove.server import FoxgloveServer

HALF = math.sqrt(0.5)
T0_S = 1_700_000_000


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Maps come ten times as often."""
    monkeypatch.setattr(map_channel, "PERIOD", 0.1)


@contextmanager
def serving(client, heard=None):
    """The URL of a bridge that works in a thread."""
    server = FoxgloveServer("test", "127.0.0.1", 0)
    ending = threading.Event()
    try:
        with FoxgloveBridge(server, client, heard, "tcp/there:7447") as bridge:

            def run():
                while not ending.wait(0.01):
                    bridge.step()

            thread = threading.Thread(target=run)
            thread.start()
            try:
                yield server.url
            finally:
                ending.set()
                thread.join()
    finally:
        server.close()


@contextmanager
def bridged(endpoint, map_name="hall"):
    with (
        open_session(NetworkConfig(connect=(endpoint,))) as session,
        MapClient(map_name=map_name, session=session) as client,
    ):
        heard = HeardRobots(session, map_name)
        with serving(client, heard) as url:
            yield url


@pytest.fixture
def url(mapper):
    with bridged(mapper.endpoint) as url:
        yield url


@pytest.fixture
def viewer(url):
    with viewing(url) as viewer:
        yield viewer


def occupancy(payload):
    """An OccupancyGrid as a viewer reads it: cells, resolution, origin, frame."""
    message = typestore().deserialize_cdr(payload, "nav_msgs/msg/OccupancyGrid")
    info, origin = message.info, message.info.origin
    assert (origin.orientation.x, origin.orientation.y, origin.orientation.z) == (0.0, 0.0, 0.0)
    cells = message.data.reshape(info.height, info.width)
    return cells, info.resolution, (origin.position.x, origin.position.y), message.header.frame_id


def shown_map(mapper):
    """The map as the mapper itself tells it to ROS."""
    asked = {"values": "trinary", "resolution": "coarse"}
    said = mapper.http.get("/map.json", params=asked).raise_for_status().json()
    return np.array(said["data"], np.int8).reshape(said["height"], said["width"]), said


def transforms(payload):
    """Each transform of a FrameTransforms: parent, child, x, y, heading, stamp (s, ns)."""
    found = []
    for each in protobuf(payload)[1]:
        fields = protobuf(each)
        time = protobuf(fields[1][0])
        place, turn = vector(fields[4][0]), vector(fields[5][0])
        heading = 2.0 * math.atan2(turn[2], turn[3])
        x, y = (*place, 0.0, 0.0)[:2]
        stamp = time.get(1, [0])[0], time.get(2, [0])[0]
        found.append((fields[2][0].decode(), fields[3][0].decode(), x, y, heading, stamp))
    return found


def arrows(payload):
    """Where each entity of a SceneUpdate has its arrow (x, y), by id; and the ids that are deleted."""
    update = protobuf(payload)
    found = {}
    for each in update.get(2, []):
        entity = protobuf(each)
        assert entity[2] == [b"map"]
        (text,) = entity[13]
        assert protobuf(text)[6] == entity[3]
        (arrow,) = entity[7]
        place = vector(protobuf(protobuf(arrow)[1][0])[1][0])
        found[entity[3][0].decode()] = (*place, 0.0, 0.0)[:2]
    return found, [protobuf(each)[3][0].decode() for each in update.get(1, [])]


def test_channels_say_what_viewers_need_to_read_them(viewer):
    said = {
        topic: (channel["encoding"], channel["schemaName"], channel["schemaEncoding"])
        for topic in ("/map", "/tf", "/robots")
        if (channel := viewer.channel(topic))
    }
    assert said == {
        "/map": ("cdr", "nav_msgs/msg/OccupancyGrid", "ros2msg"),
        "/tf": ("protobuf", "foxglove.FrameTransforms", "protobuf"),
        "/robots": ("protobuf", "foxglove.SceneUpdate", "protobuf"),
    }
    definition = viewer.channel("/map")["schema"]
    assert definition.startswith("std_msgs/Header header\n")
    for part in ("nav_msgs/MapMetaData", "geometry_msgs/Pose", "builtin_interfaces/Time"):
        assert f"\nMSG: {part}\n" in definition


def test_the_map_is_the_mappers_cell_for_cell_and_again_when_it_changes(mapper, viewer):
    mapper.draw_cross()
    viewer.subscribe("/map")
    cells, resolution, origin, frame = occupancy(viewer.next("/map"))
    expected, said = shown_map(mapper)
    np.testing.assert_array_equal(cells, expected)
    assert {-1, 0, 100} == set(np.unique(cells).tolist())
    assert (resolution, frame) == (0.5, "map")
    assert origin == (said["origin"]["x"], said["origin"]["y"])

    mapper.scan([5.0], at=9, pose=[0.25, 0.25, 0.0])
    wider = viewer.next("/map", lambda payload: occupancy(payload)[0].shape != cells.shape)
    np.testing.assert_array_equal(occupancy(wider)[0], shown_map(mapper)[0])


def test_a_map_that_counts_has_the_cells_that_its_mapper_was_told(start_mapper):
    with (
        start_mapper(map={"resolution": 0.5, "cell_model": "rate"}) as mapper,
        bridged(mapper.endpoint) as url,
        viewing(url) as viewer,
    ):
        mapper.draw_cross()
        viewer.subscribe("/map")
        cells, resolution, origin, _ = occupancy(viewer.next("/map"))
        expected, said = shown_map(mapper)
        np.testing.assert_array_equal(cells, expected)
        assert {-1, 0, 100} == set(np.unique(cells).tolist())
        assert (resolution, origin) == (0.5, (said["origin"]["x"], said["origin"]["y"]))


def test_a_map_that_is_reset_is_unknown_where_it_was_known(mapper, viewer):
    mapper.draw_cross()
    viewer.subscribe("/map")
    before = occupancy(viewer.next("/map"))
    mapper.http.post("/reset").raise_for_status()
    after = occupancy(viewer.next("/map", lambda payload: not (occupancy(payload)[0] != -1).any()))
    assert after[0].shape == before[0].shape
    assert after[1:] == before[1:]


def test_a_large_map_is_shrunk_by_a_whole_factor(mapper, viewer, monkeypatch):
    monkeypatch.setattr(map_channel, "LARGEST", 4)
    mapper.draw_cross()
    viewer.subscribe("/map")
    cells, resolution, origin, _ = occupancy(viewer.next("/map"))
    whole, said = shown_map(mapper)
    factor = -(-max(whole.shape) // 4)
    assert factor > 1
    assert resolution == 0.5 * factor
    assert max(cells.shape) <= 4
    assert origin == (said["origin"]["x"], said["origin"]["y"])
    for row in range(cells.shape[0]):
        for column in range(cells.shape[1]):
            block = whole[row * factor : (row + 1) * factor, column * factor : (column + 1) * factor]
            likeliest = 100 if (block == 100).any() else 0 if (block == 0).any() else -1
            assert cells[row, column] == likeliest


def test_who_comes_later_gets_the_map_that_has_not_changed_since(mapper, url):
    mapper.draw_cross()
    with viewing(url) as first, viewing(url) as second:
        first.subscribe("/map")
        expected = first.next("/map")
        second.subscribe("/map")
        assert second.next("/map") == expected
        second.unsubscribe("/map")
    with viewing(url) as third:  # nobody looked meanwhile
        third.subscribe("/map")
        assert third.next("/map") == expected


def test_robots_move_as_transforms_and_as_arrows_with_names(mapper, viewer):
    viewer.subscribe("/tf")
    viewer.subscribe("/robots")
    mapper.pose(1.0, -2.0, math.pi / 2, robot="r1", at=1_500_000_000)
    mapper.pose(3.0, 0.5, robot="r2", at=2)
    seen = {}
    while len(seen) < 2:
        seen |= {each[1]: each for each in transforms(viewer.next("/tf"))}
    assert seen["r1/base_link"] == ("map", "r1/base_link", 1.0, -2.0, math.pi / 2, (T0_S + 1, 500_000_000))
    assert seen["r2/base_link"] == ("map", "r2/base_link", 3.0, 0.5, 0.0, (T0_S, 2))
    found = {}
    while len(found) < 2:
        found |= arrows(viewer.next("/robots"))[0]
    assert found == {"r1": (1.0, -2.0), "r2": (3.0, 0.5)}

    mapper.pose(4.0, 0.5, robot="r2", at=3)
    assert arrows(viewer.next("/robots"))[0] == {"r2": (4.0, 0.5)}


def test_all_poses_that_came_between_two_messages_are_told_in_order(eventually):
    server = FoxgloveServer("test", "127.0.0.1", 0)
    try:
        robots = RobotChannels(server.context)
        server.add_listener(robots.subscribed)
        with viewing(server.url) as viewer:
            viewer.subscribe("/tf")
            heard = Heard()
            for x in (1.0, 2.0, 3.0):
                heard.add(*pose_message("r", x))
            eventually(robots._transforms.has_sinks)
            robots.step(heard, None, 0.0)
            assert [each[2] for each in transforms(viewer.next("/tf"))][:3] == [1.0, 2.0, 3.0]
    finally:
        server.close()


def pose_message(robot, x, stamp=1):
    return Source(robot, None), encode_pose(PoseStamped(stamp, Pose(x, 0.0, 0.0)))


def laser_scan(payload):
    """Frame, pose (x, y), angles and ranges of a LaserScan."""
    fields = protobuf(payload)
    pose = protobuf(fields[3][0])
    x, y = (*vector(pose[1][0]), 0.0, 0.0)[:2]
    ranges = struct.unpack(f"<{len(fields[6][0]) // 8}d", fields[6][0])
    angles = tuple(fields.get(number, [0.0])[0] for number in (4, 5))
    return fields[2][0].decode(), (x, y), angles, ranges


def subscribe_scans(mapper, viewer, topic):
    """Subscribe to a channel of scans; the server tells of one a moment before it lets anybody subscribe."""
    viewer.channel(topic)
    viewer.subscribe("/robots")
    mapper.pose(7.0, robot="later", at=1)
    viewer.next("/robots", lambda payload: "later" in arrows(payload)[0])
    viewer.subscribe(topic)


def test_scans_sit_on_their_robots_by_their_mounts(mapper, viewer):
    mapper.scan(
        [1.0, math.nan, math.inf, 8.0, 0.1, 2.5],
        robot="r1",
        sensor="front",
        at=7,
        angle_min=-0.5,
        angle_increment=0.25,
        range_min=0.2,
        mount=[0.3, -0.1, 0.0],
    )
    subscribe_scans(mapper, viewer, "/robots/r1/scan/front")
    frame, place, angles, ranges = laser_scan(viewer.next("/robots/r1/scan/front"))
    assert (frame, place, angles) == ("r1/base_link", (0.3, -0.1), (-0.5, 0.75))
    np.testing.assert_array_equal(ranges, [1.0, math.nan, math.nan, math.nan, math.nan, 2.5])
    assert viewer.channel("/robots/r1/scan/front")["schemaName"] == "foxglove.LaserScan"


def test_a_scan_that_says_where_it_was_taken_lies_there_and_so_does_its_robot(mapper, viewer):
    viewer.subscribe("/robots")
    place = {"pose": [1.0, 2.0, math.pi / 2], "mount": [0.5, 0.0, 0.0]}
    mapper.scan([1.0], robot="r1", sensor="s", at=1, **place)
    assert arrows(viewer.next("/robots"))[0] == {"r1": (1.0, 2.0)}
    subscribe_scans(mapper, viewer, "/robots/r1/scan/s")
    frame, (x, y), _, _ = laser_scan(viewer.next("/robots/r1/scan/s"))
    assert frame == "map"
    assert (x, y) == pytest.approx((1.0, 2.5))


def test_who_comes_later_gets_robots_that_stand_still(mapper, url):
    with viewing(url) as first:
        first.subscribe("/robots")
        mapper.pose(1.0, -2.0, robot="r1", at=1)
        assert arrows(first.next("/robots"))[0] == {"r1": (1.0, -2.0)}
        with viewing(url) as second:
            second.subscribe("/robots")
            second.subscribe("/tf")
            assert arrows(second.next("/robots"))[0] == {"r1": (1.0, -2.0)}
            assert [each[1:4] for each in transforms(second.next("/tf"))] == [("r1/base_link", 1.0, -2.0)]


def test_a_robot_that_stands_still_since_before_is_where_the_mapper_says(mapper):
    mapper.pose(1.0, -2.0, robot="r1", at=1)
    mapper.scan([1.0], robot="r1", at=1)
    mapper.settle(received=1)
    with bridged(mapper.endpoint) as url, viewing(url) as viewer:
        viewer.subscribe("/robots")
        assert arrows(viewer.next("/robots"))[0] == {"r1": (1.0, -2.0)}


def test_over_http_robots_are_where_the_mapper_says(mapper):
    mapper.draw_cross()
    with MapClient(str(mapper.http.base_url)) as client, serving(client) as url, viewing(url) as viewer:
        viewer.subscribe("/map")
        np.testing.assert_array_equal(occupancy(viewer.next("/map"))[0], shown_map(mapper)[0])
        viewer.subscribe("/robots")
        mapper.pose(1.0, -2.0, robot="r1", at=1)
        viewer.next("/robots", lambda payload: arrows(payload)[0].get("r1") == (1.0, -2.0))
        mapper.pose(1.5, -2.0, robot="r1", at=1_000_000_000)
        viewer.next("/robots", lambda payload: arrows(payload)[0].get("r1") == (1.5, -2.0))


def test_what_is_no_message_is_said_and_shown_by_nobody(mapper, viewer, caplog, eventually):
    viewer.subscribe("/robots")
    mapper.put("robots/r1/pose", b"nonsense")
    mapper.put("robots/r1/scan/s", b"nonsense")
    mapper.pose(1.0, 0.0, robot="r1", at=1)
    assert arrows(viewer.next("/robots"))[0] == {"r1": (1.0, 0.0)}
    ours = "ogm_services.foxglove.robot_channels"
    eventually(lambda: sum(record.name == ours for record in caplog.records) == 2)
    assert "/robots/r1/scan/s" not in viewer.channels


def test_robots_that_are_gone_are_taken_away(eventually):
    server = FoxgloveServer("test", "127.0.0.1", 0)
    try:
        robots = RobotChannels(server.context)
        here = {"r1": RobotStatus(Pose(1.0, 2.0, 0.0), 1, alive=True), "r2": gone_after(0.0)}
        with viewing(server.url) as viewer:
            viewer.subscribe("/robots")
            eventually(robots._scene.has_sinks)
            heard = Heard()
            heard.add(*pose_message("r2", 4.0))
            robots.step(heard, here, 100.0)
            assert arrows(viewer.next("/robots")) == ({"r1": (1.0, 2.0), "r2": (4.0, 0.0)}, [])
            robots.step(Heard(), {"r2": gone_after(61.0)}, 159.0)  # heard less than a minute ago
            assert arrows(viewer.next("/robots")) == ({}, ["r1"])
            robots.step(Heard(), {"r2": gone_after(61.0)}, 161.0)
            assert arrows(viewer.next("/robots")) == ({}, ["r2"])
    finally:
        server.close()


def gone_after(age):
    return RobotStatus(Pose(5.0, 0.0, 0.0), 1, alive=False, age_s=age)


def test_a_mapper_that_is_started_anew_is_shown_and_meanwhile_viewers_are_told(start_mapper, endpoint):
    there = {"map": {"resolution": 0.5}, "network": {"listen": [endpoint]}}
    with start_mapper(**there) as before:
        before.draw_cross()
        with open_session(NetworkConfig(connect=(endpoint,))) as session:
            client = MapClient(map_name="hall", session=session, timeout=1.0)
            with serving(client, HeardRobots(session, "hall")) as url, viewing(url) as viewer:
                viewer.subscribe("/map")
                first = occupancy(viewer.next("/map"))[0]
                before.service.__exit__(None, None, None)
                viewer.told(
                    lambda said: (
                        said["op"] == "status"
                        and said["message"].startswith("no mapper answers at tcp/there:7447")
                    )
                )
                with start_mapper(**there) as after:
                    after.scan([2.0], at=1, pose=[0.25, 0.25, 0.0])
                    viewer.told(lambda said: said["op"] == "removeStatus")
                    second = occupancy(
                        viewer.next("/map", lambda payload: occupancy(payload)[0].shape != first.shape)
                    )[0]
                    np.testing.assert_array_equal(second, shown_map(after)[0])


def test_what_waits_to_be_shown_is_bounded(monkeypatch):
    monkeypatch.setattr(heard_robots, "MAX_BYTES", 10)
    heard = Heard()
    for k in range(100):
        heard.add(Source("r", None), bytes([k]))
    assert [payload[0] for payload in heard.poses["r"]] == list(range(36, 100))
    heard.add(Source("r", "a"), b"123456")
    heard.add(Source("r", "b"), b"12345")  # one byte too many
    heard.add(Source("r", "a"), b"1234567890")  # in place of the other
    heard.add(Source("r", "a"), b"12345678901")
    assert heard.scans == {Source("r", "a"): b"1234567890"}


def test_one_robot_and_one_sensor_too_many_are_said_and_not_shown(monkeypatch, caplog):
    monkeypatch.setattr(robot_channels, "MAX_ROBOTS", 1)
    monkeypatch.setattr(robot_channels, "MAX_SENSORS", 1)
    server = FoxgloveServer("test", "127.0.0.1", 0)
    try:
        robots, heard = RobotChannels(server.context), Heard()
        for name in ("r1", "r2"):
            heard.add(*pose_message(name, 1.0))
        scan = Scan(1, 0.0, 0.1, 0.0, 8.0, np.ones(3, np.float32))
        for sensor in ("front", "back"):
            heard.add(Source("r1", sensor), encode_scan(scan))
        robots.step(heard, {"r3": RobotStatus(Pose(0.0, 0.0, 0.0), 1, alive=True)}, 0.0)
        with viewing(server.url) as viewer:
            viewer.channel("/robots/r1/scan/front")
            assert set(viewer.channels) == {"/tf", "/robots", "/robots/r1/scan/front"}
    finally:
        server.close()
    said = [record.getMessage() for record in caplog.records if "not shown" in record.getMessage()]
    assert said == [
        "/robots: r2 is not shown: 1 robots are, at most",
        "r1/back: not shown: a robot has 1 sensors at most",
    ]


def test_a_port_that_is_taken_is_refused_in_a_line():
    server = FoxgloveServer("test", "127.0.0.1", 0)
    try:
        port = server.url.rpartition(":")[2]
        with pytest.raises(OgmError, match=f"cannot listen on 127.0.0.1:{port}: Address already in use. Is"):
            FoxgloveServer("test", "127.0.0.1", int(port))
    finally:
        server.close()
