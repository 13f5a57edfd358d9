"""Erasing in a running mapper, over HTTP, Zenoh and by a client: what is unknown then, and what is told."""

import io
import json
import math
import shutil

import numpy as np
import pytest

from ogm_client import BadParameter, MapClient, MapperError
from ogm_services.mapper.storage.map_store import MapStore
from ogm_services.replies.queryables import MAX_PARAMETERS
from stored_maps import fingerprint

EAST = "0.5,-0.1,3,0.6"
"""The arm of the cross from cell (1, 0) to its wall, (4, 0)."""
AROUND_EAST = "0.4,0.2,2.6,0.1,2.5,0.5,0.4,0.4"
"""The same four cells, as a polygon."""
MOST_DIGITS = "-1.2345678901234567e-101"


class OverHttp:
    def __init__(self, mapper):
        self.mapper = mapper

    def erase(self, **given):
        """What is answered, and 200, or what is refused and its code."""
        response = self.mapper.http.post("/erase", params=given)
        assert response.headers["cache-control"] == "no-store"
        return response.json(), response.status_code


class OverZenoh:
    def __init__(self, mapper):
        self.mapper = mapper

    def erase(self, **given):
        (reply,) = self.mapper.ask("erase", ";".join(f"{name}={value}" for name, value in given.items()))
        if reply.ok is not None:
            assert str(reply.ok.key_expr) == "ogm/v1/hall/erase"
            return json.loads(reply.ok.payload.to_bytes()), 200
        problem = json.loads(reply.err.payload.to_bytes())
        return problem, problem["status"]


OVER = pytest.mark.parametrize("over", [OverHttp, OverZenoh])


@pytest.fixture
def keeping(start_mapper, no_errors, tmp_path):
    """A mapper of cells of 0.5 m that stores its map, with the cross in it."""
    sections = {"map": {"resolution": 0.5}, "mapper": {"data": str(tmp_path / "data"), "pose_wait": 60.0}}
    with start_mapper(**sections) as mapper:
        mapper.draw_cross()
        yield mapper


@pytest.fixture
def drawn(mapper):
    """A mapper with the cross in it that may be changed."""
    mapper.draw_cross()
    return mapper


def known(mapper):
    """Indices (ix, iy) of the known cells, and the ETag."""
    response = mapper.http.get("/map.npz").raise_for_status()
    with np.load(io.BytesIO(response.content)) as arrays:
        rows, columns = np.nonzero(~np.isnan(arrays["log_odds"]))
        ix, iy = arrays["offset"].tolist()
        shape = arrays["log_odds"].shape
    return {(ix + i, iy + j) for i, j in zip(columns.tolist(), rows.tolist(), strict=True)}, (ix, iy, shape)


@OVER
@pytest.mark.parametrize("area", [{"region": EAST}, {"polygon": AROUND_EAST}], ids=["region", "polygon"])
def test_the_cells_are_unknown_and_it_is_the_next_revision(keeping, over, area):
    before, _ = known(keeping)
    then, quality = keeping.status(), keeping.http.get("/quality").json()
    tag = keeping.http.get("/map.png").headers["etag"]
    answer, code = over(keeping).erase(**area)
    identity = {"epoch": then["epoch"], "run": then["run"], "revision": 4}
    assert (answer, code) == ({**identity, "cells": 4}, 200)
    gone = {(1, 0), (2, 0), (3, 0), (4, 0)}
    assert gone < before
    # The map has shrunk to what it still knows: from the wall in the west to the middle.
    assert known(keeping) == (before - gone, (-2, -5, (9, 3)))
    after = keeping.status()
    assert {name: after[name] for name in identity} == identity
    assert (after["stamp"], after["scans"], after["poses"]) == (then["stamp"], then["scans"], then["poses"])
    assert (after["map_info"]["width"], after["map_info"]["height"]) == (3, 9)
    fresh = keeping.http.get("/map.png", headers={"If-None-Match": tag})
    assert (fresh.status_code, fresh.headers["etag"]) == (
        200,
        '"{epoch}-{run}-{revision}"'.format(**identity),
    )
    assert keeping.http.get("/cell?x=2.25&y=0.25").json()["known"] is False
    figures = keeping.service.live_map.fresh_quality()
    assert (figures["scans"], figures["cell_updates"]) == (3, quality["cell_updates"])
    assert figures["known_m2"] == pytest.approx(0.25 * len(before - gone))


@OVER
def test_scans_after_it_are_in_the_map_and_so_are_those_that_wait(keeping, over, eventually):
    before, _ = known(keeping)
    keeping.pose(0.25, 0.25, at=0)
    keeping.scan([2.0], run="a", seq=0, at=10)
    eventually(lambda: keeping.status()["scans"]["pending"] == 1)
    answer, _ = over(keeping).erase(region="-90,-90,90,90")
    assert (answer["cells"], answer["revision"]) == (len(before), 4)
    assert keeping.http.get("/map.png").status_code == 404
    keeping.pose(0.25, 0.25, at=100)
    after = keeping.settle(received=4)
    assert (after["revision"], after["scans"]["integrated"]) == (5, 4)
    assert known(keeping)[0] == {(1, 0), (2, 0), (3, 0), (4, 0)}
    assert keeping.service.live_map.fresh_quality()["scans"] == 4


def test_it_comes_after_every_message_that_was_put_before_it(mapper):
    for seq in range(200):
        mapper.scan([1.0], pose=[0, 0, 0], run="a", seq=seq)
    answer = json.loads(mapper.answer("erase", "region=-9,-9,9,9").payload.to_bytes())
    assert (answer["revision"], known(mapper)[0]) == (201, set())


@OVER
def test_it_is_on_the_disk_when_that_is_answered(keeping, over, tmp_path):
    """Whatever ends the mapper then: a store of this moment's files is the erased map."""
    asks = over(keeping)
    for k, (region, cells) in enumerate([(EAST, 4), ("-9,-9,9,-1.6", 2), ("-90,-90,90,90", 8)]):
        answer, code = asks.erase(region=region)
        assert (answer["cells"], answer["revision"], code) == (cells, 4 + k, 200)
        shutil.copytree(tmp_path / "data", tmp_path / f"crashed{k}")
        with MapStore(tmp_path / f"crashed{k}") as store:
            found = store.restore(keeping.service.parts.grid_settings)
        assert (found.grid.epoch, found.grid.revision) == (answer["epoch"], 4 + k)
        assert (found.grid.erasures, found.grid.snapshot().scans) == (1 + k, 3)
        assert fingerprint(found.grid) == fingerprint(keeping.service.live_map._grid)


def test_a_reset_is_on_the_disk_when_that_is_answered_as_well(keeping, tmp_path):
    status = keeping.http.post("/reset").raise_for_status().json()
    shutil.copytree(tmp_path / "data", tmp_path / "crashed")
    with MapStore(tmp_path / "crashed") as store:
        found = store.restore(keeping.service.parts.grid_settings)
    assert (found.grid.epoch, found.grid.revision) == (status["epoch"], 0)
    assert found.grid.snapshot().known_cells == 0


def test_a_map_that_was_saved_before_it_is_as_it_was(keeping):
    before = keeping.http.get("/map.npz").content
    keeping.http.post("/save?name=a").raise_for_status()
    keeping.http.post("/erase", params={"region": EAST}).raise_for_status()
    keeping.http.post("/save?name=b").raise_for_status()
    assert keeping.http.get("/map.npz?at=a").content == before
    assert keeping.http.get("/map.npz?at=b").content == keeping.http.get("/map.npz").content != before
    keeping.http.post("/restore?name=b").raise_for_status()
    figures = keeping.service.live_map.fresh_quality()
    assert (keeping.status()["revision"], figures["scans"]) == (4, 3)


@OVER
def test_what_cannot_be_erased_is_told_and_changes_nothing(cross, over):
    asks, before = over(cross), cross.http.get("/map.npz").headers["etag"]
    for given, said in (
        ({}, "region or polygon: one of them is needed"),
        ({"region": EAST, "polygon": AROUND_EAST}, "region or polygon: one of them is needed"),
        (
            {"region": EAST, "at": "a"},
            "at: unknown parameter here, where all is of the map of now; there are: polygon, region",
        ),
        ({"region": "1,2,3"}, "region: xmin,ymin,xmax,ymax is needed"),
        ({"region": "1,1,0,0"}, "region: xmin < xmax"),
        ({"region": "nan,0,1,1"}, "region: a number is needed"),
        (
            {"region": "7,7,9,9"},
            "what is to be erased, x 7 to 9, y 7 to 9 m, lies wholly outside the map, x -1 to",
        ),
        ({"region": "0.3,0.3,0.4,0.4"}, "too small"),
        ({"polygon": "0,0,1,1"}, "polygon: x1,y1,x2,y2,... of 3 to 64 points is needed, got 4 numbers"),
        ({"polygon": "0,0,1,1,1"}, "got 5 numbers"),
        ({"polygon": "0,0,1,1,1,x"}, "polygon: a number is needed"),
        ({"polygon": ",".join(["1"] * 130)}, "got 130 numbers"),
        ({"polygon": "0,0,1,1,1,1e99"}, "polygon: finite numbers are needed"),
    ):
        problem, code = asks.erase(**given)
        assert (code, problem["type"]) == (400, "bad-parameter"), problem
        assert said in problem["detail"]
    assert cross.http.get("/map.npz").headers["etag"] == before


@OVER
def test_a_map_without_a_cell_is_told_apart(mapper, over):
    problem, code = over(mapper).erase(region=EAST)
    assert (code, problem["type"]) == (404, "map-empty")
    assert mapper.status()["revision"] == 0


@OVER
def test_the_longest_polygon_fits_into_a_question(cross, over):
    polygon = ",".join([MOST_DIGITS] * 128)
    assert len(f"polygon={polygon}") < MAX_PARAMETERS
    problem, code = over(cross).erase(polygon=polygon)
    assert (code, "too small" in problem["detail"]) == (400, True)


@pytest.mark.parametrize("way", ["http", "zenoh"])
def test_a_client_erases(drawn, way):
    before, _ = known(drawn)
    address = str(drawn.http.base_url) if way == "http" else drawn.endpoint
    with MapClient(address, map_name="hall", timeout=30.0) as client:
        maps = client.watch(interval=0.01)
        assert next(maps).revision == 3
        assert client.erase((0.5, -0.1, 3.0, 0.6)) == 4
        assert next(maps).revision == 4
        # A circle as fine as may be around the rest.
        angles = [math.tau * k / 64 for k in range(64)]
        assert client.erase(polygon=[(9 * math.cos(a), 9 * math.sin(a)) for a in angles]) == len(before) - 4
        assert next(maps).log_odds.size == 0
        with pytest.raises(MapperError) as empty:
            client.erase((0, 0, 1, 1))
        assert empty.value.type == "map-empty"
        for given in ({}, {"region": (0, 0, 1, 1), "polygon": np.eye(2)}, {"polygon": [1, 2, 3]}):
            with pytest.raises(BadParameter, match="polygon"):
                client.erase(**given)
    assert drawn.status()["revision"] == 5


@OVER
def test_the_log_says_who_has_erased_what(drawn, over, caplog):
    caplog.set_level("INFO")
    over(drawn).erase(region=EAST)
    (said,) = [text for text in caplog.messages if " has erased " in text]
    who = "127.0.0.1 over HTTP" if over is OverHttp else "somebody over Zenoh"
    assert said == f"{who} has erased 4 cells in x 0.5 to 3, y 0 to 0.5 m: revision 4"


def test_it_is_a_write_and_needs_the_token_and_a_page_of_its_own(start_mapper, no_errors, tmp_path):
    token = tmp_path / "token"
    token.write_text("0123456789abcdef" * 2)
    with start_mapper(map={"resolution": 0.5}, http={"token_file": str(token)}) as mapper:
        mapper.draw_cross()
        right = {"Authorization": f"Bearer {token.read_text()}"}
        foreign = {**right, "Origin": "http://elsewhere"}
        for headers, code in (({}, 401), (foreign, 403), (right, 200)):
            response = mapper.http.post("/erase", params={"region": EAST}, headers=headers)
            assert response.status_code == code
        assert mapper.status()["revision"] == 4


def test_what_is_refused_on_the_worker_is_no_bug(cross, caplog):
    OverHttp(cross).erase(region="7,7,9,9")
    assert not [record for record in caplog.records if record.exc_info]
