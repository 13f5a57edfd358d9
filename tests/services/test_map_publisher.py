"""Maps for robots and displays of ROS 2: value for value, whole or what has changed; no topic is taken."""

import json
import logging

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ogm_client.errors import BadReply
from ogm_core.ros2 import cdr
from ogm_core.ros2.cdr import OccupancyGrid
from ogm_services.ros2 import map_publisher
from ogm_services.ros2.bridge import BridgeSource
from ogm_services.ros2.map_fetch import MapFetch
from ogm_services.ros2.map_publisher import MapPublisher, MapTopic, TopicTaken
from ogm_services.ros2.rmw_zenoh import RmwZenohSource
from ros2_robots import BridgeRobot, RmwZenohRobot

UPDATE = "std_msgs/Header header\nint32 x\nint32 y\nuint32 width\nuint32 height\nint8[] data\n"


@pytest.fixture(scope="module")
def read():
    """`read(payload)` reads an OccupancyGrid, or an update, by a library: cells [iy, ix], and the message."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(UPDATE, cdr.OCCUPANCY_GRID_UPDATE))

    def read(payload, name=cdr.OCCUPANCY_GRID):
        message = store.deserialize_cdr(payload, name)
        about = message.info if name == cdr.OCCUPANCY_GRID else message
        return message.data.reshape(about.height, about.width), message

    return read


class Kept:
    """A source that keeps what is published, by topic."""

    def __init__(self):
        self.put = {}

    def publish_latched(self, name, message_type):
        kept = self.put.setdefault(name, [])

        class Latched:
            put = staticmethod(kept.append)
            look = close = staticmethod(lambda: None)

        return Latched


def grid(cells, origin=(-1.0, -2.0), stamp=0):
    return OccupancyGrid(stamp, "map", 0.05, origin, np.array(cells, np.int8))


BLANK = [[-1] * 4] * 4


def changed(*cells):
    found = np.array(BLANK, np.int8)
    for iy, ix, value in cells:
        found[iy, ix] = value
    return grid(found)


def test_a_map_is_sent_whole_then_what_differs_from_that(read):
    source = Kept()
    topic = MapTopic("/ogm/map", [source])
    whole, updates = source.put["/ogm/map"], source.put["/ogm/map_updates"]
    topic.send(grid(BLANK), 0.0)
    topic.send(grid(BLANK), 1.0)
    assert (len(whole), len(updates)) == (1, 0)
    topic.send(changed((1, 2, 100)), 2.0)
    topic.send(changed((1, 2, 100), (2, 2, 0)), 3.0)
    topic.send(changed((1, 2, 100), (2, 2, 0)), 4.0)
    assert (len(whole), len(updates)) == (1, 2)
    cells, message = read(updates[1], cdr.OCCUPANCY_GRID_UPDATE)
    assert (message.x, message.y, cells.tolist()) == (2, 1, [[100], [0]])  # both changes


def test_a_map_is_sent_whole_again_when_much_or_its_place_has_changed_or_after_a_while(read):
    source = Kept()
    topic = MapTopic("/m", [source])
    whole, updates = source.put["/m"], source.put["/m_updates"]
    topic.send(grid(BLANK), 0.0)
    topic.send(changed((0, 0, 100), (3, 3, 100)), 1.0)
    assert (len(whole), len(updates)) == (2, 0)
    topic.send(grid(BLANK, origin=(-1.0, -2.05)), 2.0)
    assert len(whole) == 3
    topic.send(grid([*BLANK, [0] * 4], origin=(-1.0, -2.05)), 3.0)
    assert (len(whole), len(updates)) == (4, 0)
    first = np.array([*BLANK, [0] * 4])
    first[0, 0] = 100
    topic.send(grid(first, origin=(-1.0, -2.05)), 4.0)
    assert (len(whole), len(updates)) == (4, 1)
    assert not topic.whole_is_due(12.9)
    assert topic.whole_is_due(13.0)
    topic.send(grid(first, origin=(-1.0, -2.05)), 12.9)
    assert (len(whole), len(updates)) == (4, 1)
    topic.send(grid(first, origin=(-1.0, -2.05)), 13.0)
    assert len(whole) == 5
    assert not topic.whole_is_due(99.0)
    topic.send(grid(first, origin=(-1.0, -2.05)), 99.0)
    assert len(whole) == 5
    assert read(whole[-1])[0].tolist() == first.tolist()


def test_who_comes_after_a_whole_map_is_given_no_update_of_an_older_one(read):
    source = Kept()
    topic = MapTopic("/m", [source])
    whole, updates = source.put["/m"], source.put["/m_updates"]
    topic.send(grid(BLANK), 0.0)
    topic.send(changed((1, 2, 100)), 1.0)
    last = changed((0, 0, 100), (1, 2, 0), (3, 3, 100))
    topic.send(last, 2.0)
    assert (len(whole), len(updates)) == (2, 2)
    shown = read(whole[-1])[0].copy()
    cells, message = read(updates[-1], cdr.OCCUPANCY_GRID_UPDATE)
    shown[message.y : message.y + message.height, message.x : message.x + message.width] = cells
    np.testing.assert_array_equal(shown, last.data)


def test_an_emptied_map_is_unknown(read):
    source = Kept()
    topic = MapTopic("/m", [source])
    topic.send(None, 0.0)
    assert source.put["/m"] == []
    topic.send(grid([[0, 100]]), 1.0)
    topic.send(None, 2.0)
    assert read(source.put["/m"][-1])[0].tolist() == [[-1, -1]]


def test_fetched_maps_are_those_of_the_mapper(mapper):
    fetch = MapFetch(mapper.session, "hall", "site")
    assert fetch.trinary() is None
    assert fetch.probabilities() is None
    before = fetch.version()
    mapper.draw_cross()
    assert fetch.version() != before
    for values, found in (("trinary", fetch.trinary()), ("", fetch.probabilities())):
        said = json.loads(mapper.http.get("/map.json", params={"values": values} if values else {}).content)
        assert found.data.ravel().tolist() == said["data"]
        assert found.data.shape == (said["height"], said["width"])
        assert found.origin == (said["origin"]["x"], said["origin"]["y"])
        assert (found.resolution, found.frame, found.stamp) == (0.5, "site", said["stamp"])
    assert set(fetch.trinary().data.ravel().tolist()) == {-1, 0, 100}


def test_of_a_map_that_counts_the_cells_are_those_that_the_mapper_was_told(start_mapper):
    with start_mapper(map={"resolution": 0.5, "cell_model": "rate"}) as mapper:
        fetch = MapFetch(mapper.session, "hall", "site")
        assert fetch.without_cells().resolution == 0.5
        mapper.draw_cross()
        for values, found in (("trinary", fetch.trinary()), ("percent", fetch.probabilities())):
            asked = {"values": values, "resolution": "coarse"}
            said = mapper.http.get("/map.json", params=asked).raise_for_status().json()
            assert found.data.ravel().tolist() == said["data"]
            assert found.data.shape == (said["height"], said["width"])
            assert (found.resolution, list(found.origin)) == (0.5, [said["origin"]["x"], said["origin"]["y"]])
        fine = mapper.http.get("/map.json").json()
        assert (fine["resolution"], fine["width"]) == (0.25, 2 * found.data.shape[1])


@pytest.fixture
def publisher(mapper, network, monkeypatch):
    """`publisher(...)` starts one on rmw_zenoh and the bridge."""
    monkeypatch.setattr(map_publisher, "LISTEN", 0.05)
    monkeypatch.setattr(map_publisher, "PERIOD", 0.02)
    session = network()
    sources = [RmwZenohSource(session, 0, "here"), BridgeSource(session, "here")]
    started = []

    def start(**topics):
        topics = {"trinary": None, "probabilities": None} | topics
        started.append(MapPublisher(sources, MapFetch(mapper.session, "hall", "map"), **topics))
        return started[-1]

    start.sources = sources
    yield start
    for each in started:
        each.close()
    for source in sources:
        source.close()


@pytest.mark.parametrize("form", ["rmw_zenoh", "humble", "bridge"])
def test_who_comes_late_has_the_map_value_for_value(publisher, mapper, network, eventually, read, form):
    running = publisher(trinary="/ogm/map")
    mapper.draw_cross()
    robot = BridgeRobot(network()) if form == "bridge" else RmwZenohRobot(network(), old=form == "humble")
    found = []
    subscriber = robot.subscriber("/ogm/map", "OccupancyGrid", lambda sample: found.append(sample))

    def is_the_mappers():
        running.check()
        if not found:
            return False
        cells, message = read(found[-1].payload.to_bytes())
        said = json.loads(mapper.http.get("/map.json", params={"values": "trinary"}).content)
        assert (message.info.origin.orientation.w, message.header.frame_id) == (1.0, "map")
        position = message.info.origin.position
        return cells.ravel().tolist() == said["data"] and (position.x, position.y) == (
            *(said["origin"]["x"], said["origin"]["y"]),
        )

    eventually(is_the_mappers)
    subscriber.undeclare()


def test_a_map_that_does_not_change_is_not_fetched_again(publisher, mapper, monkeypatch, eventually):
    mapper.draw_cross()
    asked = dict.fromkeys(("version", "trinary", "probabilities"), 0)
    unchanged = {name: getattr(MapFetch, name) for name in asked}

    def counted(name):
        def fetched(fetch):
            asked[name] += 1
            return unchanged[name](fetch)

        return fetched

    for name in asked:
        monkeypatch.setattr(MapFetch, name, counted(name))
    publisher(trinary="/ogm/map", probabilities="/ogm/likely")
    eventually(lambda: asked["version"] > 5)
    assert (asked["trinary"], asked["probabilities"]) == (1, 1)
    mapper.scan([1.0, 0.5, 1.0, 1.0], at=99, pose=[0.25, 0.25, 0.0], angle_increment=1.57, range_max=2.5)
    eventually(lambda: (asked["trinary"], asked["probabilities"]) == (2, 2))


@pytest.mark.parametrize("answer", [b"\xff", b"[]", b'{"data": [300], "width": 1, "height": 1}'])
def test_an_answer_that_is_no_map_is_a_bad_reply(network, monkeypatch, answer):
    fetch = MapFetch(network(), "hall", "map")
    monkeypatch.setattr(fetch._transport, "fetch", lambda service, parameters: answer)
    with pytest.raises(BadReply, match=r"map\.json: data, width and height are needed"):
        fetch.probabilities()


@pytest.mark.parametrize("topic", ["/map", "/map_updates"])
def test_a_topic_of_another_node_is_not_taken(publisher, network, eventually, topic):
    robot = RmwZenohRobot(network(), node="slam_toolbox")
    robot.publisher(topic, "OccupancyGrid", latched=True)
    eventually(lambda: publisher.sources[0].topics())
    running = publisher(trinary="/map")

    def taken():
        try:
            running.check()
        except TopicTaken as error:
            return str(error)
        return None

    text = eventually(taken)
    assert text.startswith(f"{topic}: /slam_toolbox publishes it already (rmw_zenoh here, domain 0)")
    assert "such as /ogm/map" in text
    assert [topic for topic in publisher.sources[0].topics() if topic.node == "/ogm"] == []


def test_a_mapper_that_is_away_is_waited_for(listener, network, monkeypatch, caplog, eventually):
    monkeypatch.setattr(map_publisher, "LISTEN", 0.01)
    monkeypatch.setattr(map_publisher, "PERIOD", 0.01)
    caplog.set_level(logging.INFO)
    source = RmwZenohSource(network(), 0, "here")
    running = MapPublisher([source], MapFetch(listener, "hall", "map"), trinary="/m", probabilities=None)
    eventually(lambda: "no mapper" in caplog.text)
    running.check()
    running.close()
    source.close()
