"""GetMap as others ask for it: clients of pyzeros and of zenoh-ros2-sdk."""

import json
from contextlib import closing

import numpy as np
import pytest

from ogm_client.session import NetworkConfig, open_session
from ogm_core.ros2 import cdr
from ogm_core.ros2.services import GET_MAP, GET_MAP_HASH
from ogm_services.ros2.map_service import MapService
from ogm_services.ros2.rmw_zenoh import RmwZenohSource
from witness import MADE, wanted, zenoh_node

DOMAIN = 7
NAME = "/ogm/get_map"


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
