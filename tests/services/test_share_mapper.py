"""The mapper of one share of a map that is cut: what it keeps, what it answers, and what it counts."""

import json
import math
import re
from contextlib import ExitStack

import httpx
import numpy as np
import pytest

from gathering import gathered, parts, tiles_of, tiles_of_grid
from ogm_client import MapClient, MapperError
from ogm_core.errors import LimitReached
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.types import Pose, Scan
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.serving.other_mappers import AlreadyMapped
from ogm_services.mapper.shares.gathering import BESIDE

MAP = {"resolution": 0.5, "reach": 4.0}
STAR = {"angle_increment": math.tau / 8, "range_max": 8.0}
THREES = (3.0,) * 8
WEST, NEAR_WEST = [-40.25, 0.25, 0.0], [-1.25, 0.25, 0.0]
EAST, NEAR_EAST = [40.25, 0.25, 0.0], [1.25, 0.25, 0.0]


@pytest.fixture
def shares(start_mapper, eventually):
    """The mappers of the shares of a map that is cut at x = 0; all of them hear what is put by `drive`."""
    with ExitStack() as running:
        west = running.enter_context(start_mapper(map=MAP, shares={"cuts_x": [0.0], "index": 0}))
        network = {"listen": [], "connect": [west.endpoint]}
        sections = {"map": MAP, "shares": {"cuts_x": [0.0], "index": 1}}
        east = running.enter_context(start_mapper(network=network, **sections))
        yield Shares(west, east, eventually)


class Shares:
    def __init__(self, west, east, eventually):
        self.both = west, east
        self.session, self.keys = west.session, west.keys
        self._eventually = eventually
        self.sent = 0

    def drive(self, *poses, ranges=THREES):
        """Scans of a star at these poses; returns when none is pending at either share."""
        for pose in poses:
            self.both[0].scan(ranges, at=self.sent, seq=self.sent, pose=pose, **STAR)
            self.sent += 1
        self._eventually(lambda: all(self.status(k)["scans"]["received"] == self.sent for k in (0, 1)))
        self._eventually(lambda: not any(self.status(k)["scans"]["pending"] for k in (0, 1)))

    def status(self, index):
        """The status of a share, after a look whether its books balance."""
        told = json.loads(self.both[0].answer(f"shares/{index}/status").payload.to_bytes())
        for scans in (told["scans"], *(source for source in self.sources(told))):
            counted = scans["integrated"] + sum(scans["dropped"].values()) + sum(scans["of_others"].values())
            assert scans["received"] == scans["pending"] + counted
        return told

    @staticmethod
    def sources(told):
        return [source for robot in told["robots"].values() for source in robot["sources"].values()]

    def scans(self, index):
        scans = self.status(index)["scans"]
        return scans["integrated"], *scans["of_others"].values()

    def part(self, index, parameters=""):
        """The messages of a share's part, and what is attached."""
        return parts(self.session, self.keys, parameters)[index]


def whole_map(poses, ranges=THREES):
    """One map of all cells, of the same scans."""
    grid = OccupancyGrid(GridSettings(**MAP))
    for n, pose in enumerate(poses):
        grid.integrate(
            Scan(n, 0.0, STAR["angle_increment"], 0.0, 8.0, np.array(ranges, np.float32)), Pose(*pose)
        )
    return grid


def test_two_shares_hold_the_map_of_one_and_count_each_scan_once(shares):
    poses = [WEST, NEAR_WEST, NEAR_EAST, EAST, EAST]
    shares.drive(*poses)
    assert gathered(parts(shares.session, shares.keys)) == tiles_of_grid(whole_map(poses))
    assert [shares.scans(k) for k in (0, 1)] == [(2, 1, 0, 2), (3, 1, 0, 1)]
    told = shares.status(1)
    assert told["share"] == {
        "index": 1,
        "shares": 2,
        "cuts_x": [0.0],
        "cuts_y": [],
        "bounds": [0.0, None, None, None],
    }
    assert told["revision"] == 5
    (source,) = shares.sources(told)
    assert source["integrated"] == 3
    assert source["of_others"] == {"border": 1, "border_dropped": 0, "elsewhere": 1}


def test_a_share_keeps_no_scans_once_they_are_in_its_cells(shares):
    shares.drive(WEST, NEAR_WEST, EAST)
    for mapper in shares.both:
        assert mapper.service.memory.held()["recent"] == 0
    assert [shares.scans(k)[0] for k in (0, 1)] == [2, 1]


def test_a_part_says_which_it_is_and_tells_what_has_changed_since(shares):
    shares.drive(NEAR_WEST, WEST)
    updates, attached = shares.part(0)
    assert [attached[name] for name in ("share", "shares", "cuts_x", "cuts_y")] == [0, 2, [0.0], []]
    tag = "{epoch}-{run}-{revision}".format(**attached)
    (same,), _ = shares.part(0, f"since={tag}")
    assert (same.prev, same.revision, same.whole, len(same.tiles)) == (2, 2, False, 0)
    shares.drive(WEST)
    (changed,), _ = shares.part(0, f"since={tag}")
    assert (changed.prev, changed.revision, changed.whole) == (2, 3, False)
    assert changed.tiles.tolist() == [[-2, -1], [-2, 0]]
    assert tiles_of(shares.part(0)[0]) == tiles_of(updates) | tiles_of([changed])
    (other,), _ = shares.part(1, f"since={tag}")
    assert (other.whole, other.prev) == (True, 0), "the tag is another share's"


def test_a_region_names_the_tiles_that_it_meets(shares):
    shares.drive(NEAR_WEST, WEST)
    everything = {tuple(place) for place in shares.part(0)[0][0].tiles.tolist()}
    assert everything == {(-2, -1), (-2, 0), (-1, -1), (-1, 0)}
    (near,), _ = shares.part(0, "region=-1,0.1,-0.5,1")
    assert (near.whole, near.tiles.tolist()) == (True, [[-1, 0]])
    (border,), _ = shares.part(0, "region=-32.5,-0.5,-31.5,0.5")
    assert {tuple(place) for place in border.tiles.tolist()} == everything
    for nowhere in ("region=10,10,20,20", BESIDE):
        (beside,), _ = shares.part(0, nowhere)
        assert (beside.whole, len(beside.tiles), beside.revision) == (True, 0, 2)
    for wrong in ("region=1,0,-1,2", "region=1,2", "reg=1", "since=1"):
        (_, east) = (shares.both[0].ask(f"shares/{k}/part", wrong) for k in (0, 1))
        assert json.loads(east[0].err.payload.to_bytes())["type"] == "bad-parameter"


def test_a_share_that_is_reset_begins_a_new_epoch_alone(shares):
    shares.drive(NEAR_WEST)
    before = shares.status(0)["epoch"], shares.status(1)["epoch"]
    told = json.loads(shares.both[0].answer("shares/0/reset").payload.to_bytes())
    assert told["epoch"] != before[0]
    assert (told["share"]["index"], told["revision"]) == (0, 0)
    assert (shares.status(0)["epoch"], shares.status(1)["epoch"]) == (told["epoch"], before[1])
    found = parts(shares.session, shares.keys)
    assert [len(found[k][0][0].tiles) for k in (0, 1)] == [0, 2]
    refused = shares.both[0].ask("shares/*/reset")
    assert [json.loads(reply.err.payload.to_bytes())["type"] for reply in refused] == ["bad-parameter"] * 2
    assert shares.status(1)["epoch"] == before[1]


def test_a_share_answers_for_its_part_alone(shares):
    heard = []
    with shares.session.declare_subscriber(shares.keys.updates, heard.append):
        shares.drive(NEAR_WEST, WEST)
        for name in ("map", "cell", "quality", "status", "reset", "erase", "snapshots", "raycast"):
            assert shares.both[0].ask(name) == [], name
    assert heard == []
    # By a client that does not look what is described: that is what the mapper of a whole map answers.
    with httpx.Client(base_url=shares.both[1].http.base_url) as http:
        check_http(http)


def check_http(http):
    assert http.get("/").text.startswith("share 1 of 2 of map 'hall', which gateways serve")
    assert http.get("/status").json()["share"]["index"] == 1
    assert http.get("/readyz").status_code == 200
    assert 'ogm_scans_of_others_total{kind="border",map="hall"} 1.0' in http.get("/metrics").text
    which = "this is share 1 of 2 of map 'hall', which gateways serve: ask a gateway (`ogm gateway`)"
    for path in ("/map.png", "/map.yaml", "/tiles.json", "/cell", "/quality", "/ws"):
        refused = http.get(path)
        assert (refused.status_code, refused.headers["Content-Type"]) == (404, "application/problem+json")
        assert refused.json()["detail"] == f"{path} is not here: {which}"
    assert http.post("/reset").status_code == 404
    with MapClient(str(http.base_url)) as client:
        assert client.status().share.index == 1
        for ask in (client.get_map, lambda: client.fetch("map.png"), lambda: client.save_snapshot("monday")):
            with pytest.raises(MapperError, match=re.escape(which)):
                ask()


def test_a_second_mapper_of_the_same_share_ends(shares, start_mapper):
    network = {"listen": [], "connect": [shares.both[0].endpoint]}
    with (
        pytest.raises(AlreadyMapped, match=r"another mapper of share 1 of map 'hall' is alive .*/mapper/1/"),
        start_mapper(network=network, map=MAP, shares={"cuts_x": [0.0], "index": 1}),
    ):
        pass
    assert shares.status(1)["share"]["index"] == 1, "the first goes on"


def test_what_a_share_has_no_memory_for_it_drops_for_its_cells_only(shares, monkeypatch):
    def refuse(_, scan, *__):
        raise LimitReached("there is no memory left", "max_memory")

    monkeypatch.setattr(LiveMap, "integrate", refuse)
    shares.drive(NEAR_WEST, EAST)
    west, east = shares.status(0)["scans"], shares.status(1)["scans"]
    assert (west["dropped"]["limit"], east["dropped"]["limit"]) == (1, 1)
    assert west["of_others"] == {"border": 0, "border_dropped": 1, "elsewhere": 0}
    assert east["of_others"] == {"border": 0, "border_dropped": 1, "elsewhere": 0}


@pytest.mark.parametrize("refusal", [LimitReached("too large", "max_cells"), RuntimeError("a bug")])
def test_a_scan_that_no_share_takes_is_counted_at_home(shares, monkeypatch, refusal):
    def refuse(*_):
        raise refusal

    monkeypatch.setattr(LiveMap, "integrate", refuse)
    shares.drive(NEAR_WEST)
    west, east = shares.status(0)["scans"], shares.status(1)["scans"]
    reason, here = ("limit", "border") if isinstance(refusal, LimitReached) else ("failed", "border_dropped")
    assert west["dropped"][reason] == 1
    assert east["of_others"][here] == 1
    assert sum(east["dropped"].values()) == 0
