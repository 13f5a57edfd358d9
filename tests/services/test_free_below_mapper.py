"""A mapper that calls other cells free than the one before it, of one stored map."""

import re

import numpy as np
import pytest

from ogm_client import MapClient
from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.rate import Rate
from ogm_core.errors import BadSetting
from ogm_services.mapper.live.start_map import start_cells
from ogm_services.settings.settings import Settings

TILE = "/tiles/16/0/-1.png"
CAUTIOUS = {"resolution": 0.5, "free_below": 0.05}


@pytest.fixture
def both(start_mapper, tmp_path):
    """What is told of one stored map: by the mapper that made it, and by a cautious one, which is asked."""
    stored = {"data": str(tmp_path / "data")}
    with start_mapper(map={"resolution": 0.5}, mapper=stored) as mapper:
        mapper.draw_cross()
        usual = {path: mapper.http.get(path) for path in ("/map.pgm", "/map.npz", TILE, "/")}
        usual["cell"] = mapper.http.get("/cell", params={"x": 1.25, "y": 0.25}).json()
    with start_mapper(map=CAUTIOUS, mapper=stored) as mapper:
        yield usual, mapper


def test_a_stored_map_goes_on_and_only_what_is_free_has_changed(both, start_mapper, tmp_path):
    """East, north and west are free by p = 0.155, seen twice; the wall stays one."""
    usual, mapper = both
    assert mapper.status()["revision"] == 3
    pgm = mapper.http.get("/map.pgm")
    assert (b"\xfe" in usual["/map.pgm"].content, b"\xfe" in pgm.content) == (True, False)
    assert pgm.content == usual["/map.pgm"].content.replace(b"\xfe", b"\xcd")
    assert "free_thresh: 0.05\n" in mapper.http.get("/map.yaml").text
    assert 0 not in mapper.http.get("/map.json", params={"values": "trinary"}).json()["data"]
    assert mapper.http.get("/cell", params={"x": 1.25, "y": 0.25}).json() == usual["cell"]
    assert mapper.http.get("/quality").json()["free_m2"] == 0.0
    with start_mapper(map={"resolution": 0.5}, mapper={"data": str(tmp_path / "other")}) as again:
        again.draw_cross()
        assert again.http.get("/map.pgm").content == usual["/map.pgm"].content


def test_no_cache_takes_it_for_what_was_there_before(both):
    usual, mapper = both
    for path in ("/map.pgm", TILE):
        tag = usual[path].headers["etag"]
        assert mapper.http.get(path, headers={"If-None-Match": tag}).status_code == 200
    assert mapper.http.get(TILE).content != usual[TILE].content
    before, after = (re.search(r"static/(\w+)/", page.text)[1] for page in (usual["/"], mapper.http.get("/")))
    assert before != after
    assert "FREE_BELOW = 0.05;" in mapper.http.get(f"/static/{after}/constants.js").text


def test_questions_and_programs_go_by_it(both):
    """A ray eastward goes through two free cells to the wall at x = 2 m: or ends at the first of them."""
    _, mapper = both
    ray = mapper.http.get("/raycast", params={"x": 0.25, "y": 0.25, "n": 1}).json()
    assert (ray["ranges"], ray["ends"]) == ([0.25], ["unknown"])
    checked = mapper.http.post("/check", json={"points": [[1.25, 0.25]]})
    with MapClient(session=mapper.session, map_name="hall") as client:
        grids = [client.get_map()]
        with client.follow() as follower:
            follower.wait(timeout=30.0)
            grids.append(follower.grid())
        for grid in grids:
            assert grid.free_below == 0.05
            assert not (grid.occupancy == 0).any()
            assert (grid.crop((0.0, 0.0, 1.0, 0.5)).occupancy == -1).all()
            assert grid.raycast(0.25, 0.25, 0.0).range == 0.25
            assert grid.check([[1.25, 0.25]]) == ["unknown"]
            assert grid.to_snapshot().shrink(4).model.free_below == 0.05
    assert checked.json()["states"] == ["unknown"]


def test_a_start_map_must_have_cells_that_are_free():
    """Free cells start at 1 - confidence: that must be below what counts as free."""
    occupancy = np.array([[0, 10, 100, -1]], np.int8)
    told = r"free ones at 0\.09998; more than 0\.65 and less than 0\.05 are needed: raise it"
    with pytest.raises(BadSetting, match=told):
        start_cells(occupancy, LogOdds(free_below=0.05), 0.9)
    for free_below, confidence in ((0.05, 0.97), (0.1, 0.95), (0.11, 0.9), (0.3, 0.9), (0.5, 0.9)):
        model, every = LogOdds(free_below=free_below), np.arange(-1, 101, dtype=np.int8)
        p = model.probability(start_cells(every, model, confidence))
        assert np.array_equal(p[1:] < free_below, every[1:] / 100.0 < free_below)
        assert np.array_equal(p > 0.65, every / 100.0 > 0.65)


def test_every_cell_model_has_it():
    for name, model in (("log_odds", LogOdds), ("rate", Rate)):
        settings = Settings.model_validate({"map": {"cell_model": name, "free_below": 0.05}})
        assert settings.grid_settings().cell_model == model(free_below=0.05)
        assert Settings.model_validate({"map": {"cell_model": name}}).grid_settings().cell_model == model()
