"""A gateway as a service over fake shares: what it answers, and while shares are missing."""

import io
import json
import time

import httpx
import msgpack
import numpy as np
import pytest
from websockets.sync.client import connect

from ogm_client import MapClient, MapperError, PartialMap, RobotPublisher
from ogm_client.session import NetworkConfig, open_session
from ogm_core.files.map_files import encode_npz
from ogm_core.grid import OccupancyGrid
from ogm_core.status import StoreInfo
from ogm_core.types import Pose
from ogm_services.mapper.gateway.gateway_service import GatewayService
from ogm_services.settings.settings import Settings
from shares_desk import SETTINGS, FakeShare, ServedShare, scan_at

CUTS = {"cuts_x": [0.0], "cuts_y": [0.0]}
FAN = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.1, "range_max": 9.0, "sensor": "laser"}


class Fleet:
    """Four fake shares on a router, the one mapper that they stand for, and gateways."""

    def __init__(self, endpoint, shares=range(4)):
        self.endpoint = endpoint
        self.one = OccupancyGrid(SETTINGS, "one", "run")
        self.rng = np.random.default_rng(5)
        self.router = open_session(NetworkConfig(listen=(endpoint,)))
        self._sessions = [self.router]
        self.shares = [ServedShare(self.join(), FakeShare(k)) for k in shares]
        self._scans = 0
        self._gateways = []

    def join(self):
        self._sessions.append(open_session(NetworkConfig(connect=(self.endpoint,))))
        return self._sessions[-1]

    def integrate(self, count=1):
        for _ in range(count):
            placed = scan_at(self._scans, self.rng)
            self._scans += 1
            self.one.integrate(*placed)
            for served in self.shares:
                served.share.integrate(*placed)

    def gateway(self, *, timeout=5.0, **shares):
        """A gateway of its own, and a client of its HTTP."""
        settings = {
            "map": {"reach": 5.0},
            "network": {"map_name": "m", "connect": [self.endpoint]},
            "http": {"port": 0},
            "shares": {**CUTS, "gather_timeout": timeout, **shares},
        }
        service = GatewayService(Settings.model_validate(settings)).__enter__()
        http = httpx.Client(base_url=service.addresses[1].split()[-1], timeout=30.0)
        self._gateways.append((service, http))
        return service, http

    def close(self):
        for service, http in self._gateways:
            http.close()
            service.__exit__(None, None, None)
        for session in reversed(self._sessions):
            session.close()


@pytest.fixture
def fleet(endpoint):
    fleet = Fleet(endpoint)
    yield fleet
    fleet.close()


def npz(content):
    with np.load(io.BytesIO(content)) as arrays:
        return dict(arrays)


def test_a_gateway_answers_as_one_mapper_would(fleet):
    fleet.integrate(8)
    _, http = fleet.gateway()
    whole = fleet.one.snapshot()
    answer = http.get("/map.npz")
    assert answer.content == encode_npz(whole)
    assert answer.headers["OGM-Revision"] == "32"
    assert answer.headers["ETag"].startswith(f'"{answer.headers["OGM-Epoch"]}-{answer.headers["OGM-Run"]}-')
    assert http.get("/map.npz", headers={"If-None-Match": answer.headers["ETag"]}).status_code == 304
    shown = http.get("/map.json").json()
    assert (shown["width"], shown["height"], shown["offset"]) == (
        whole.width,
        whole.height,
        list(whole.offset),
    )
    assert "missing" not in shown
    fleet.integrate(1)
    later = http.get("/map.npz", headers={"If-None-Match": answer.headers["ETag"]})
    assert later.content == encode_npz(fleet.one.snapshot())
    assert later.headers["OGM-Revision"] == "36"
    for name in (
        "map.png",
        "map.pgm",
        "map.yaml",
        "distance.png",
        "quality",
        "tiles.json",
        "metrics",
        "map.tiles",
    ):
        assert http.get(f"/{name}").status_code == 200, name
    assert http.get("/readyz").text == "ok"


def test_two_gateways_give_equal_tags_to_equal_bytes(fleet):
    fleet.integrate(5)
    (_, first), (_, second) = fleet.gateway(), fleet.gateway()
    fleet.integrate(1)
    for name in ("map.png", "map.npz", "map.json", "map.pgm?palette=probability"):
        one, other = first.get(f"/{name}"), second.get(f"/{name}")
        assert one.headers["ETag"] == other.headers["ETag"]
        assert one.content == other.content


def test_two_gateways_give_tiles_equal_tags_and_a_new_one_when_their_share_has_changed(fleet):
    (_, first), (_, second) = fleet.gateway(), fleet.gateway()
    fleet.integrate(5)

    def tiles(http):
        return {(x, y): http.get(f"/tiles/16/{x}/{y}.png") for x in (-1, 0) for y in (-1, 0)}

    one, other = tiles(first), tiles(second)
    for place, tile in one.items():
        assert tile.headers["ETag"] == other[place].headers["ETag"]
        assert tile.headers["ETag"].startswith(f'"{tile.headers["OGM-Epoch"]}-')
        assert tile.content == other[place].content
    assert len({tile.headers["ETag"] for tile in one.values()}) == 4
    placed = scan_at(99, fleet.rng)
    fleet.shares[3].share.integrate(placed[0], Pose(7.0, 7.0, 0.0))  # in the north-east
    changed = tiles(first)
    same = {place for place, tile in changed.items() if tile.headers["ETag"] == one[place].headers["ETag"]}
    assert same == {(-1, -1), (-1, 0), (0, 0)}
    asked = {"If-None-Match": one[0, 0].headers["ETag"]}
    assert first.get("/tiles/16/0/0.png", headers=asked).status_code == 304
    tag = changed[0, -1].headers["ETag"].strip('"')
    assert "immutable" in first.get(f"/tiles/16/0/-1.png?rev={tag}").headers["Cache-Control"]


def test_only_what_has_changed_is_asked_for(fleet):
    fleet.integrate(3)
    _, http = fleet.gateway()
    http.get("/map.npz")
    part = fleet.shares[0].share.state
    http.get("/map.npz")
    assert fleet.shares[0].asked[-1] == f"{part.epoch}-{part.run}-{part.revision}"


def test_while_a_share_is_missing_the_rest_is_told_and_says_so(fleet):
    fleet.integrate(8)
    _, http = fleet.gateway()
    whole = npz(http.get("/map.npz").content)
    fleet.shares[1].close()
    answer = http.get("/map.npz")
    assert answer.status_code == 200
    share, _, since = answer.headers["OGM-Missing"].partition(";since=")
    assert share == "1"
    assert abs(time.time_ns() - int(since)) < 60e9
    assert answer.headers["Cache-Control"] == "no-store"
    assert not {"ETag", "OGM-Epoch", "OGM-Run", "OGM-Revision"} & {name.title() for name in answer.headers}
    assert not {"etag", "ogm-epoch", "ogm-run", "ogm-revision"} & set(answer.headers)
    part = npz(answer.content)
    x, y = part["offset"] - whole["offset"]
    height, width = part["log_odds"].shape
    expected = whole["log_odds"][y : y + height, x : x + width].copy()
    ix = np.arange(width) + part["offset"][0]
    iy = np.arange(height) + part["offset"][1]
    expected[(iy[:, None] < 0) & (ix[None, :] >= 0)] = np.nan
    assert np.array_equal(part["log_odds"], expected, equal_nan=True)
    shown = http.get("/map.json").json()
    assert shown["missing"] == [{"share": 1, "bounds": [0.0, None, None, 0.0], "since": int(since)}]
    assert "epoch" not in shown


def test_what_would_mislead_without_a_share_is_refused_until_it_is_there(fleet):
    fleet.integrate(8)
    _, http = fleet.gateway()
    fleet.shares[1].close()
    refused = (
        *("/map.yaml", "/map.pgm", "/map.png?complete=1", "/distance.png", "/inflate.png?radius=0.2"),
        *("/raycast?x=-1&y=1&range_max=2", "/cell?x=1&y=-1"),
    )
    for asked in refused:
        answer = http.get(asked)
        assert (answer.status_code, answer.json()["type"]) == (503, "partial-map"), asked
        assert "share 1" in answer.json()["detail"]
        assert int(answer.headers["Retry-After"]) > 0
    assert http.get("/map.pgm?complete=0").headers["OGM-Missing"].startswith("1;")
    assert http.get("/cell?x=-1&y=1").json()["known"] in (True, False)
    assert http.get("/readyz").status_code == 200
    fleet.shares[1] = ServedShare(fleet.join(), fleet.shares[1].share)
    for asked in refused:
        assert http.get(asked).status_code == 200, asked
    assert "OGM-Missing" not in http.get("/map.png").headers


def test_no_share_at_all_is_not_ready(endpoint):
    fleet = Fleet(endpoint, shares=())
    try:
        _, http = fleet.gateway()
        assert http.get("/readyz").status_code == 503
        assert "no share" in http.get("/readyz").text
        answer = http.get("/map.json")
        assert [each["share"] for each in answer.json()["missing"]] == [0, 1, 2, 3]
        assert http.get("/status").json()["complete"] is False
    finally:
        fleet.close()


def test_a_share_that_keeps_silent_holds_nobody_up_for_longer_than_the_timeout(fleet):
    fleet.integrate(4)
    _, http = fleet.gateway(timeout=0.3)
    fleet.shares[2].silent = True
    answer = http.get("/map.npz")
    assert answer.headers["OGM-Missing"].startswith("2;")
    fleet.shares[2].silent = False
    assert "OGM-Missing" not in http.get("/map.npz").headers


def test_the_status_adds_up_what_the_shares_have_counted(fleet):
    fleet.integrate(6)
    _, http = fleet.gateway()
    for k, served in enumerate(fleet.shares):
        dropped = {"limit": k, "no_pose": 2}
        served.scans = {"received": 40, "integrated": 5 + k, "pending": 6, "dropped": dropped, "lost": 3}
    status = http.get("/status").json()
    scans = status["scans"]
    assert (scans["received"], scans["integrated"], scans["lost"]) == (40, 26, 3)
    assert (scans["dropped"]["limit"], scans["dropped"]["no_pose"]) == (6, 2)
    assert scans["pending"] == 6
    assert status["map_info"]["known_cells"] == fleet.one.snapshot().known_cells
    assert status["complete"] is True
    assert [(s["share"], s["state"], s["revision"]) for s in status["shares"]] == [
        (k, "up", 6) for k in range(4)
    ]
    assert status["shares"][1]["bounds"] == [0.0, None, None, 0.0]
    fleet.shares[3].scans["integrated"] = 0  # it was started again
    assert http.get("/status").json()["complete"] is False
    fleet.shares[3].scans |= {"integrated": 11, "dropped": {"overload": 1}}
    fleet.shares[2].store = StoreInfo(3, "disk full", 10)
    status = http.get("/status").json()
    assert status["complete"] is False
    assert status["shares"][3]["overload"] == 1
    assert (status["shares"][2]["state"], status["shares"][2]["detail"]) == ("not storing", "disk full")
    fleet.shares[0].close()
    status = http.get("/status").json()
    assert (status["shares"][0]["state"], status["complete"]) == ("missing", False)


def test_reset_is_done_when_every_share_has_begun_a_new_epoch(fleet):
    fleet.integrate(4)
    _, http = fleet.gateway()
    before = http.get("/status").json()["epoch"]
    answer = http.post("/reset")
    assert answer.status_code == 200
    assert answer.json()["epoch"] != before
    assert answer.json()["revision"] == 0
    assert http.get("/map.json").json()["width"] == 0


def test_a_reset_of_which_a_share_has_not_heard_is_not_done(fleet):
    fleet.integrate(4)
    _, http = fleet.gateway()
    share = fleet.shares[2].share
    fleet.shares[2].close()
    answer = http.post("/reset")
    assert (answer.status_code, answer.json()["type"]) == (503, "partial-map")
    assert "share 2 " in answer.json()["detail"]
    fleet.shares[2] = ServedShare(fleet.join(), share)
    assert http.get("/map.json").json()["width"] > 0  # it keeps its cells
    assert http.post("/reset").status_code == 200
    assert http.get("/map.json").json()["width"] == 0


def test_what_a_gateway_cannot_do_it_says(fleet):
    _, http = fleet.gateway()
    for asked in ("POST /erase?region=0,0,1,1", "POST /save?name=x", "DELETE /snapshots/x"):
        answer = http.request(*asked.split())
        assert (answer.status_code, answer.json()["type"]) == (501, "not-by-gateway"), asked
    assert http.get("/snapshots").json()["type"] == "not-stored"


def test_a_share_of_other_settings_is_missing_and_the_gateway_says_why(fleet, caplog):
    fleet.integrate(2)
    _, http = fleet.gateway(cuts_x=[3.2])
    assert "OGM-Missing" in http.get("/map.npz").headers
    why = http.get("/readyz").text
    assert "cuts_x" in why
    assert "[3.2]" in why
    assert any("cuts_x" in record.getMessage() for record in caplog.records)
    assert "cuts_x" in http.get("/status").json()["shares"][0]["detail"]


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
def test_the_client_library_raises_what_is_there_of_a_partial_map(fleet, over):
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


def test_of_two_processes_of_a_share_the_one_that_was_heard_of_last_counts(fleet, eventually):
    fleet.integrate(3)
    _, http = fleet.gateway()
    old = http.get("/map.json").json()
    newer = FakeShare(2, epoch="e2", run="newer")
    served = ServedShare(fleet.join(), newer)
    placed = scan_at(50, fleet.rng)
    newer.integrate(*placed)

    def taken():
        return http.get("/status").json()["shares"][2]["run"]

    eventually(lambda: taken() == "newer")
    assert [taken() for _ in range(3)] == ["newer"] * 3
    served.close()
    eventually(lambda: http.get("/map.json").json()["run"] == old["run"])  # the old one is all there is


def test_the_figures_of_a_gateway_are_those_of_the_whole_map(fleet):
    fleet.integrate(6)
    _, http = fleet.gateway()
    for served in fleet.shares:
        served.scans |= {"received": 6, "integrated": 2}
    quality, whole = http.get("/quality").json(), fleet.one.snapshot()
    assert quality["known_m2"] == pytest.approx(whole.known_cells * 0.05**2)
    assert (quality["scans"], quality["cell_updates"]) == (8, None)
    assert "missing_shares" not in quality
    fleet.shares[1].close()
    assert [each["share"] for each in http.get("/quality").json()["missing_shares"]] == [1]
