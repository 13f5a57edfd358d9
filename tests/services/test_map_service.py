"""The service nav_msgs/GetMap: the map of the moment, over rmw_zenoh (Humble, too) and the bridge."""

import random
import struct
import threading
from contextlib import closing

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from gateway_desk import sessions
from ogm_client.errors import MapperError
from ogm_core.ros2 import cdr
from ogm_services.ros2 import map_publisher, map_service
from ogm_services.ros2.bridge import BridgeSource
from ogm_services.ros2.map_fetch import MapFetch
from ogm_services.ros2.map_publisher import MapPublisher
from ogm_services.ros2.map_service import MapService
from ogm_services.ros2.rmw_zenoh import RmwZenohSource
from ros2_robots import BridgeRobot, RmwZenohRobot

NAME = "/ogm/get_map"
GID = bytes(range(16))


def read(payload):
    """A reply as a library reads it: its one field is the map."""
    message = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(payload, cdr.OCCUPANCY_GRID)
    return message.data.reshape(message.info.height, message.info.width).tolist(), message


class Fetch:
    """What a service asks for the map; `cells` is the map of the moment, None: without a known cell."""

    def __init__(self, cells=None):
        self.cells, self.fetched, self.wrong = cells, 0, None
        self.begun, self.go_on = threading.Event(), threading.Event()
        self.go_on.set()

    def trinary(self):
        self.fetched += 1
        cells = self.cells
        self.begun.set()
        assert self.go_on.wait(20.0)
        if self.wrong is not None:
            raise self.wrong
        return None if cells is None else self._grid(cells)

    def without_cells(self):
        return self._grid(np.empty((0, 0)))

    @staticmethod
    def _grid(cells):
        return cdr.OccupancyGrid(7 * 10**9, "site", 0.5, (-1.0, -2.0), np.array(cells, np.int8))


@pytest.fixture
def join(listener, endpoint):
    """`join()` opens a session of its own on the network."""
    with sessions(endpoint) as join:
        yield join


@pytest.fixture(params=["rmw_zenoh", "humble", "bridge"])
def network(request, join):
    """A source, and a robot in its form."""
    if request.param == "bridge":
        source, robot = BridgeSource(join(), "here"), BridgeRobot(join())
    else:
        source = RmwZenohSource(join(), 3, "here")
        robot = RmwZenohRobot(join(), domain=3, node="saver", old=request.param == "humble")
    with closing(source):
        yield source, robot


def called(robot, eventually):
    """What the one service replies, once it is known there."""
    found = eventually(lambda: robot.call(NAME))
    (reply,) = found
    return reply


def test_the_map_is_that_of_the_moment_in_which_it_is_asked_for(network, eventually):
    source, robot = network
    fetch = Fetch()
    with closing(MapService(NAME, [source], fetch)):
        cells, message = read(called(robot, eventually)[0])
        assert (cells, message.info.width, message.header.frame_id) == ([], 0, "site")
        for map_now in ([[0, 100, -1], [-1, 0, 0]], [[100]]):
            fetch.cells = map_now
            cells, message = read(called(robot, eventually)[0])
            assert cells == map_now
            position, stamp = message.info.origin.position, message.header.stamp
            assert (position.x, position.y, message.info.resolution, stamp.sec) == (-1.0, -2.0, 0.5, 7)
    assert robot.call(NAME) == []  # it is gone


def test_a_reply_is_known_by_what_came_with_its_request(join, eventually):
    with closing(RmwZenohSource(join(), 3, "here")) as source, closing(MapService(NAME, [source], Fetch())):
        new, old = (RmwZenohRobot(join(), domain=3, node="saver", old=old) for old in (False, True))
        _, attached = called(new, eventually)
        seq, stamp, length, gid = struct.unpack("<qqB16s", attached)
        assert (seq, length, gid) == (1, 16, GID)
        assert stamp > 5  # the time of the reply
        ((_, attached),) = new.call(NAME, seq=2**40, gid=GID[::-1])
        assert struct.unpack("<qqB16s", attached)[::3] == (2**40, GID[::-1])
        _, attached = called(old, eventually)
        assert attached[attached.index(b"source_gid") + 11 :] == GID
        assert attached[16:24] == struct.pack("<q", 1)


def test_who_wait_when_a_fetch_begins_share_it_and_who_comes_later_does_not(join, eventually):
    with closing(RmwZenohSource(join(), 3, "here")) as source:
        fetch = Fetch([[0]])
        found = []
        with closing(MapService(NAME, [source], fetch)):
            robots = [RmwZenohRobot(join(), domain=3, node=f"saver{n}") for n in range(4)]
            eventually(lambda: all(robot.call(NAME) for robot in robots))
            before = fetch.fetched
            fetch.go_on.clear()
            fetch.begun.clear()
            first = threading.Thread(target=lambda: found.append(read(robots[0].call(NAME)[0][0])[0]))
            first.start()
            assert fetch.begun.wait(20.0)
            fetch.cells = [[100]]
            later = [
                threading.Thread(target=lambda robot=robot: found.append(read(robot.call(NAME)[0][0])[0]))
                for robot in robots[1:]
            ]
            for thread in later:
                thread.start()
            fetch.go_on.set()
            for thread in (first, *later):
                thread.join(20.0)
        assert sorted(found) == [[[0]], [[100]], [[100]], [[100]]]
        assert 2 <= fetch.fetched - before <= 4


def test_a_mapper_that_does_not_answer_is_told_to_who_asks(network, eventually, caplog):
    source, robot = network
    fetch = Fetch()
    fetch.wrong = MapperError(503, "unavailable", "map: the mapper starts")
    with closing(MapService(NAME, [source], fetch)):
        assert "the mapper starts" in called(robot, eventually)
        fetch.wrong, fetch.cells = None, [[100]]
        assert read(called(robot, eventually)[0])[0] == [[100]]
    assert "the mapper starts" in caplog.text


def test_more_requests_than_may_wait_are_refused(join, eventually, monkeypatch):
    monkeypatch.setattr(map_service, "MAX_WAITING", 0)
    with closing(RmwZenohSource(join(), 3, "here")) as source, closing(MapService(NAME, [source], Fetch())):
        robot = RmwZenohRobot(join(), domain=3, node="saver")
        assert called(robot, eventually) == "0 requests wait already"


class Asked:
    """A request, and what it is told."""

    def __init__(self):
        self.told = []

    def answer(self, payload):
        self.told.append(read(payload)[0])

    def refuse(self, why):
        self.told.append(why)


def test_who_still_waits_when_the_service_ends_is_told(monkeypatch):
    monkeypatch.setattr(map_service, "_CLOSING", 0.0)
    fetch, first, later = Fetch([[100]]), Asked(), [Asked(), Asked()]
    fetch.go_on.clear()
    service = MapService(NAME, [], fetch)
    service._take(first)
    assert fetch.begun.wait(20.0)
    for asked in later:
        service._take(asked)
    service.close()
    fetch.go_on.set()
    service._thread.join(20.0)
    assert first.told == [[[100]]]
    assert [asked.told for asked in later] == [["the map is offered no more"]] * 2
    assert fetch.fetched == 1


def test_after_a_bug_the_next_request_is_answered(eventually, caplog):
    fetch, first, second = Fetch([[100]]), Asked(), Asked()
    fetch.wrong = ZeroDivisionError("a bug")
    with closing(MapService(NAME, [], fetch)) as service:
        service._take(first)
        assert eventually(lambda: first.told) == ["the map could not be given: the gateway's log says why"]
        fetch.wrong = None
        service._take(second)
        assert eventually(lambda: second.told) == [[[100]]]
    assert "a request for the map failed" in caplog.text
    assert "ZeroDivisionError: a bug" in caplog.text


def test_a_service_that_another_node_offers_is_not_offered_twice(network, eventually, caplog):
    source, robot = network
    robot.serves(NAME)
    robot.serves("/ogm/get_map_of_yesterday")
    other = eventually(lambda: source.server_of(NAME))
    assert other == ("a node behind a bridge" if source.form == "bridge" else "/saver")
    assert source.server_of("/ogm/get") is None
    with closing(MapService(NAME, [source], Fetch([[0]]))):
        assert robot.call(NAME) == []
    assert f"{NAME} is not offered: {other} does so already ({source.where})" in caplog.text


def test_who_publishes_the_map_offers_it_beside_the_topic(mapper, join, monkeypatch, eventually):
    """Through a mapper: what `ogm ros2 --publish-map /hall/map` does."""
    monkeypatch.setattr(map_publisher, "LISTEN", 0.05)
    monkeypatch.setattr(map_publisher, "PERIOD", 1000.0)  # no message, and the map all the same
    mapper.draw_cross()
    fetch = MapFetch(mapper.session, "hall", "site")
    with closing(RmwZenohSource(join(), 0, "here")) as source:
        robot = RmwZenohRobot(join(), node="saver")
        with closing(MapPublisher([source], fetch, trinary="/hall/map", probabilities=None)):
            ((payload, _),) = eventually(lambda: robot.call("/hall/get_map"))
            assert read(payload)[0] == fetch.trinary().data.tolist()
            assert set(np.unique(read(payload)[0]).tolist()) == {-1, 0, 100}
            mapper.http.post("/reset")
            ((payload, _),) = robot.call("/hall/get_map")
            cells, message = read(payload)
            assert (cells, message.info.resolution) == ([], 0.5)
        eventually(lambda: not robot.call("/hall/get_map"))
        with closing(MapPublisher([source], fetch, trinary=None, probabilities="/hall/likely")):
            pass


def test_after_a_bug_the_map_goes_on_being_published(monkeypatch, eventually, caplog):
    monkeypatch.setattr(map_publisher, "LISTEN", 0.0)
    monkeypatch.setattr(map_publisher, "PERIOD", 0.01)
    fetch, asked = Fetch([[100]]), []

    def version():
        asked.append(True)
        if len(asked) == 1:
            raise ZeroDivisionError("a bug")
        return "first"

    fetch.version = version
    with closing(MapPublisher([], fetch, trinary="/hall/map", probabilities=None)):
        eventually(lambda: fetch.fetched)
    assert "publishing the map failed" in caplog.text
    assert "ZeroDivisionError: a bug" in caplog.text


def test_on_dds_there_is_no_service_that_clients_could_wait_for(eventually):
    pytest.importorskip("cyclonedds", reason="the extra dds is not installed")
    from ogm_services.ros2.dds import DdsSource

    with closing(DdsSource(random.randint(1, 101), "lo")) as source:
        ends = next(reader for publisher, reader, _ in source._ends if publisher)
        with (
            closing(MapService(NAME, [source], Fetch([[0]]))),
            closing(source.publish_latched("/ogm/map", cdr.OCCUPANCY_GRID)),
        ):
            names = eventually(
                lambda: {end.topic_name for end in ends.read(99) if hasattr(end, "topic_name")}
            )
            assert names == {"rt/ogm/map"}
