"""A gateway as a service over fake shares, as the client library and viewers find it."""

import json
import sys
import time

import msgpack
import numpy as np
import pytest
import zenoh
from PIL import Image
from websockets.sync.client import connect

from fleet_desk import npz
from ogm_client import MapClient, MapperError, PartialMap, RobotPublisher
from ogm_client import follower as follower_module
from ogm_core.files.map_files import encode_npz
from ogm_core.wire.map_update import decode_updates
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


def test_a_follower_stays_with_one_of_several_gateways_while_it_lives(fleet, eventually, monkeypatch):
    monkeypatch.setattr(follower_module, "SILENCE", 0.2)  # so often it asks whether its copy is right
    fleet.integrate(4)
    gateways = {service.parts.run: service for service, _ in (fleet.gateway(), fleet.gateway())}
    with MapClient(map_name="m", session=fleet.join(), timeout=30.0) as client, client.follow() as follower:
        own = follower.version.run
        for _ in range(15):
            fleet.integrate(1)
            assert follower.wait(after=follower.version, timeout=30.0).version.run == own

        def right():
            return np.array_equal(follower.grid().log_odds, client.get_map().log_odds, equal_nan=True)

        eventually(right)
        gateways.pop(own).__exit__(None, None, None)
        fleet.integrate(1)
        eventually(lambda: follower.version.run in gateways and right())


def test_what_other_gateways_tell_makes_nobody_ask_whose_own_lives(fleet, eventually, monkeypatch):
    monkeypatch.setattr(follower_module, "SILENCE", 1000.0)
    monkeypatch.setattr(follower_module, "ALIVE", 1000.0)
    fleet.gateway(), fleet.gateway()
    with MapClient(map_name="m", session=fleet.join(), timeout=30.0) as client, client.follow() as follower:
        eventually(lambda: follower._heard_own > 0.0)
        fleet.integrate(1)
        follower.wait(after=follower.version, timeout=30.0)
        asked = follower._asked
        for _ in range(10):
            fleet.integrate(1)
            assert follower.wait(after=follower.version, timeout=30.0) is not None
        assert follower._asked == asked


def test_what_has_changed_since_a_gateway_told_it_says_while_it_lives(fleet):
    fleet.integrate(4)
    (first, _), (second, http) = fleet.gateway(), fleet.gateway()
    session, epoch = fleet.join(), http.get("/map.json").json()["epoch"]

    def told(run):
        replies = session.get(
            f"ogm/v1/m/map?format=tiles;since={epoch}-{run}-0",
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=30.0,
        )
        found = [reply.ok or json.loads(reply.err.payload.to_string())["type"] for reply in replies]
        updates = [each for each in found if not isinstance(each, str)]
        runs = [next(decode_updates(each.payload.to_bytes())).run for each in updates]
        return sorted(runs), [each for each in found if isinstance(each, str)]

    both = sorted((first.parts.run, second.parts.run))
    assert told(first.parts.run) == ([first.parts.run], ["other-gateway"])
    assert told("0" * 32) == told("*") == (both, [])
    # Over HTTP nobody else has been asked.
    assert http.get(f"/map.tiles?since={epoch}-{first.parts.run}-0").status_code == 200


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
        with pytest.raises(PartialMap, match=r"by \?complete=0 behind"):
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
