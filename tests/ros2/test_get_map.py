"""GetMap as others ask for it: clients of pyzeros and of zenoh-ros2-sdk, and nodes of ROS 2 on DDS."""

import json
import random
import signal
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest

from ogm_client.session import NetworkConfig, open_session
from ogm_core.ros2 import cdr
from ogm_core.ros2.services import GET_MAP, GET_MAP_HASH
from ogm_services.ros2.map_publisher import MapTopic
from ogm_services.ros2.map_service import MapService
from ogm_services.ros2.rmw_zenoh import RmwZenohSource
from witness import MADE, rclpy_node, start, wanted, zenoh_node

DOMAIN = 7
NAME = "/ogm/get_map"
EXAMPLE = Path(__file__).parents[2] / "examples" / "ros2_get_map.py"


class Fetch:
    """What a service asks for the map; None: a map without a known cell."""

    cells = None

    def trinary(self):
        return None if self.cells is None else self._grid(self.cells)

    def without_cells(self):
        return self._grid(np.empty((0, 0), np.int8))

    @staticmethod
    def _grid(cells):
        return cdr.OccupancyGrid(2_000_000_003, "map", 0.05, (-1.0, -2.0), cells)


@pytest.mark.parametrize("library", ["pyzeros", "sdk"])
def test_a_node_that_asks_gets_the_map_of_the_moment(library, listener, endpoint):
    fetch = Fetch()
    with (
        open_session(NetworkConfig(connect=(endpoint,))) as session,
        closing(RmwZenohSource(session, DOMAIN, endpoint)) as source,
        closing(MapService(NAME, [source], fetch)),
        zenoh_node(library, DOMAIN, endpoint, "/saver") as saver,
    ):
        empty = saver.ask(call=NAME)["values"]
        assert (empty["info"]["width"], empty["data"]) == (0, [])
        fetch.cells = np.random.default_rng(1).integers(-1, 101, (1000, 1024)).astype(np.int8)
        read = saver.ask(call=NAME)["values"]
        info = read["info"]
        stamp = {"sec": 2, "nanosec": 3}
        assert (read["header"], info["width"], info["height"]) == (
            {"stamp": stamp, "frame_id": "map"},
            1024,
            1000,
        )
        assert (info["origin"]["position"]["x"], info["resolution"]) == (-1.0, float(np.float32(0.05)))
        np.testing.assert_array_equal(read["data"], fetch.cells.ravel())


@pytest.mark.parametrize("distribution", ["jazzy", "kilted"])
def test_the_type_is_known_by_the_hash_that_distributions_state(distribution):
    wanted(distribution)
    stated = json.loads((MADE / distribution / "share" / "nav_msgs" / "srv" / "GetMap.json").read_text())
    assert {each["type_name"]: each["hash_string"] for each in stated["type_hashes"]}[GET_MAP] == GET_MAP_HASH


@contextmanager
def example(distribution, domain):
    """The node of the examples, until Ctrl-C, with which it ends well."""
    settings = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with start(distribution, str(EXAMPLE), "--topic", "/ogm/map", settings=settings) as node:
        try:
            yield
            node.send_signal(signal.SIGINT)
            assert node.wait(60.0) == 0
        finally:
            node.kill()


def test_on_dds_the_node_of_the_examples_gives_the_map_that_is_published(distribution, eventually):
    pytest.importorskip("cyclonedds", reason="the extra dds is not installed")
    from ogm_services.ros2.dds import DdsSource

    wanted(f"{distribution}-messages")
    domain = random.randint(1, 101)
    cells = np.random.default_rng(1).integers(-1, 101, (300, 700)).astype(np.int8)
    maps = [cells, cells.copy(), cells.copy(), cells[:9, :5]]
    maps[1][7:90, 30:650] = 100
    maps[2][3:5, 4:60] = 0
    with (
        closing(DdsSource(domain, "lo")) as source,
        closing(MapTopic("/ogm/map", [source])) as topic,
        rclpy_node(distribution, domain, "/saver") as saver,
    ):

        def send(number):
            grid = cdr.OccupancyGrid((number + 1) * 10**9, "map", 0.05, (-1.0, -2.0), maps[number])
            topic.send(grid, 0.0)

        def is_given(number):
            saver.ask(call=NAME)
            given = saver.ask(replied=NAME)["values"][-1:]
            return [each["data"] for each in given] == [maps[number].ravel().tolist()]

        saver.ask(client=NAME)
        with example(distribution, domain):
            eventually(lambda: saver.ask(offered=NAME)["value"])
            saver.ask(call=NAME)
            (first,) = eventually(lambda: saver.ask(replied=NAME)["values"])
            assert (first["info"]["width"], first["data"]) == (0, [])
            for number in (0, 1, 2):  # whole, and two updates of it
                send(number)
                eventually(lambda number=number: is_given(number))
        eventually(lambda: not saver.ask(offered=NAME)["value"])
        with example(distribution, domain):  # it comes late: the whole map, and the last update
            eventually(lambda: saver.ask(offered=NAME)["value"])
            eventually(lambda: is_given(2))
            send(3)
            eventually(lambda: is_given(3))
