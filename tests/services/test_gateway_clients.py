"""A gateway as a service over fake shares, as the client library and viewers find it."""

import json
import sys
import time

import msgpack
import numpy as np
import pytest
from PIL import Image
from websockets.sync.client import connect

from fleet_desk import npz
from ogm_client import MapClient, MapperError, PartialMap, RobotPublisher
from ogm_core.files.map_files import encode_npz
from ogm_services.commands.get import fetch

FAN = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.1, "range_max": 9.0, "sensor": "laser"}


def test_the_client_library_and_queries_over_zenoh_find_one_mapper(fleet, eventually):
    fleet.integrate(6)
    fleet.gateway()
    fleet.gateway()
    with MapClient(map_name="m", session=fleet.join(), timeout=30.0) as client:
        grid = client.get_map()
        whole = fleet.one.snapshot()
        assert np.array_equal(grid.log_odds, npz(encode_npz(whole))["log_odds"], equal_nan=True)
        assert client.status().map == "m"
        x, y = whole.lattice.corner_of(whole.offset[0] + 50, whole.offset[1] + 50)
        assert client.cell(x + 0.01, y + 0.01)["ix"] == whole.offset[0] + 50
        with client.follow() as follower:
            change = follower.wait()
            assert change is not None
            fleet.integrate(1)
            newer = follower.wait(after=follower.version)
            assert newer is not None
            expected = npz(encode_npz(fleet.one.snapshot()))["log_odds"]
            # One share may have told of the scan before another.
            eventually(lambda: np.array_equal(follower.grid().log_odds, expected, equal_nan=True))
        with pytest.raises(MapperError, match="not-by-gateway"):
            client.erase(region=(0, 0, 1, 1))
        client.reset()
        assert client.get_map().width == 0


@pytest.mark.parametrize("over", ["http", "zenoh"])
def test_the_client_library_raises_what_is_there_of_a_partial_map(fleet, over, tmp_path):
    fleet.integrate(6)
    _, http = fleet.gateway()
    whole = npz(http.get("/map.npz").content)["log_odds"]
    fleet.shares[1].close()
    where = {"address": str(http.base_url)} if over == "http" else {"session": fleet.join()}
    with MapClient(map_name="m", timeout=30.0, **where) as client:
        with pytest.raises(PartialMap, match="share 1 ") as raised:
            client.get_map()
        (missing,) = raised.value.missing
        assert (missing.share, missing.bounds) == (1, (0.0, None, None, 0.0))
        assert missing.since > 1.7e18
        part = raised.value.map
        assert part.epoch == ""
        known = np.isfinite(part.log_odds)
        assert 0 < known.sum() < np.isfinite(whole).sum()
        taken = client.get_map(partial=True)
        assert np.array_equal(taken.log_odds, part.log_odds, equal_nan=True)
        assert taken.missing == (missing,)
        with pytest.raises(PartialMap) as raised:
            client.fetch("map.png")
        assert raised.value.map == client.fetch("map.png", complete=0)
        with pytest.raises(PartialMap, match="by complete=0"):
            fetch(client, "map.yaml", tmp_path / "part.yaml", sys.stdout.buffer)
        assert not list(tmp_path.iterdir())
        fetch(client, "map.yaml?complete=0", tmp_path / "part.yaml", sys.stdout.buffer)
        with Image.open(tmp_path / "part.pgm") as picture:
            assert picture.size == (part.width, part.height)
        for refused in (
            lambda: client.fetch("map.png", complete=1),
            lambda: client.fetch("map.pgm"),
            lambda: client.distance(),
        ):
            with pytest.raises(MapperError, match="partial-map") as error:
                refused()
            assert error.value.status == 503
        assert len(client.fetch("map.tiles")) > 100


def test_over_zenoh_a_partial_map_says_so_in_its_attachment(fleet):
    fleet.integrate(4)
    fleet.gateway()
    fleet.shares[3].close()
    (reply,) = fleet.join().get("ogm/v1/m/map?format=npz", timeout=30.0)
    told = msgpack.unpackb(reply.ok.attachment.to_bytes())
    assert [each["share"] for each in told["missing"]] == [3]
    assert "epoch" not in told
    (reply,) = fleet.join().get("ogm/v1/m/map?format=yaml", timeout=30.0)
    assert json.loads(reply.err.payload.to_string())["type"] == "partial-map"


def test_live_clients_of_a_gateway_see_tiles_robots_and_scans(fleet, eventually):
    fleet.integrate(4)
    service, http = fleet.gateway()
    url = http.base_url.copy_with(scheme="ws", path="/ws")
    with (
        connect(str(url), proxy=None) as socket,
        RobotPublisher("robot1", session=fleet.join(), map_name="m", reliable=True) as robot,
    ):
        hello = msgpack.unpackb(socket.recv(30.0))
        assert hello["run"] == service.parts.run
        view = {"type": "view", "z": 16, "tiles": [-1, -1, 0, 0], "scans": True}
        socket.send(msgpack.packb(view))
        seen, robots, scans = {}, {}, {}

        def look():
            # Again and again: what is put before a gateway has heard of its subscriber is not heard.
            robot.publish_pose(1.0, 2.0, 0.0, stamp=time.time_ns())
            robot.publish_scan([1.0, 2.0], stamp=time.time_ns(), pose=(1.0, 2.0, 0.5), **FAN)
            message = msgpack.unpackb(socket.recv(30.0))
            seen.update({tuple(tile[:3]): tile[4] for tile in message["tiles"]})
            robots.update(message["robots"])
            scans.update(message.get("scans", {}))
            return len(seen) == 4 and robots.get("robot1", {}).get("alive") and "robot1/laser" in scans

        eventually(look)
        assert scans["robot1/laser"]["pose"][:2] == [1.0, 2.0]
        for (z, x, y), png in seen.items():
            assert http.get(f"/tiles/{z}/{x}/{y}.png").content == png
        fleet.integrate(1)
        before = dict(seen)
        eventually(lambda: look() and seen != before)
        for (z, x, y), png in seen.items():
            assert http.get(f"/tiles/{z}/{x}/{y}.png").content == png
