"""Large answers: the memory that making them takes is held before, and small ones always find a thread."""

import threading
import tracemalloc
from contextlib import ExitStack

import numpy as np
import pytest

from ogm_core.cells.log_odds import LogOdds
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.placing.receipts import Receipts
from ogm_core.tiles.pyramid import Square
from ogm_core.types import Pose, Scan
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.live.monitor import Monitor
from ogm_services.mapper.serving import large_answers as large_module
from ogm_services.mapper.serving import map_formats as formats_module
from ogm_services.mapper.serving.answer_memory import AnswerMemory
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.large_answers import LARGE_AT_ONCE
from ogm_services.mapper.serving.map_formats import MAP_FORMATS
from ogm_services.mapper.serving.map_tiles import MapTiles
from ogm_services.replies.answer import Busy
from ogm_services.replies.in_flight import InFlight

MIB = 1024**2
DEADLINE = 30.0
AROUND = 4 * MIB
"""What encoders take whatever the size of the map."""
WHOLE = "0,0,1e9,1e9"


class Desk:
    """Answers about a map of two scans far from each other: few tiles, and a rectangle of many cells."""

    def __init__(self, side, limit=2**40):
        self.live = LiveMap(OccupancyGrid(GridSettings(resolution=0.1), "e"))
        for x in (0.0, side):
            self.live.integrate(Scan(1, 0.0, 1.0, 0.0, 20.0, np.full(1, 1.5, np.float32)), Pose(x, x, 0.0))
        self.in_flight = InFlight(limit)
        self.answers = Answers(
            "hall", self.live, Receipts(), Monitor(self.live), memory=AnswerMemory(in_flight=self.in_flight)
        )


@pytest.fixture
def slow(monkeypatch):
    """JSON of more than 1000 cells is encoded once this is set; `slow.begun` counts who has come to it."""
    go_on, encode = threading.Event(), formats_module.encode_json
    go_on.begun = 0

    def slowly(snapshot, *rest):
        if snapshot.width * snapshot.height > 1000:
            go_on.begun += 1
            assert go_on.wait(DEADLINE)
        return encode(snapshot, *rest)

    monkeypatch.setattr(formats_module, "encode_json", slowly)
    yield go_on
    go_on.set()


@pytest.mark.parametrize("form", MAP_FORMATS)
@pytest.mark.parametrize("given", [{}, {"region": WHOLE}, {"max_size": "1000"}])
def test_no_answer_takes_more_to_make_than_is_held_for_it(form, given, monkeypatch):
    if not given.keys() <= {parameter.name for parameter in MAP_FORMATS[form].parameters}:
        pytest.skip("it has no such parameter")
    desk, sizes = Desk(200.0), []
    monkeypatch.setattr(desk.in_flight, "making", lambda size: sizes.append(size) or ExitStack())
    desk.answers.map(form, {"region": "0,0,1,1"} if "region" in given else {})  # tables are made once
    desk.live.integrate(Scan(2, 0.0, 1.0, 0.0, 20.0, np.full(1, 1.5, np.float32)), Pose(0.0, 0.0, 0.0))
    tracemalloc.start()
    try:
        desk.answers.map(form, given)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak <= sizes[-1] + AROUND
    assert sizes[-1] <= 60 * MIB  # of 4 million cells


@pytest.mark.parametrize("cells", ["int16", "float64"])
def test_no_tile_takes_more_to_make_than_is_held_for_it(cells, monkeypatch):
    live, sizes, in_flight = LiveMap(OccupancyGrid(GridSettings(0.1, LogOdds(cells)), "e")), [], InFlight()
    for x, y in np.mgrid[-40:41:10, -40:41:10].reshape(2, -1).T.tolist():
        live.integrate(Scan(1, 0.0, 0.1, 0.0, 20.0, np.full(63, 6.0, np.float32)), Pose(x, y, 0.0))
    monkeypatch.setattr(in_flight, "making", lambda size: sizes.append(size) or ExitStack())
    MapTiles(live).tile(Square(10, 0, 0), "ros")  # tables are made once
    for z in (16, 15, 10):
        tiles = MapTiles(live, in_flight=in_flight)
        tracemalloc.start()
        try:
            tiles.tile(Square(z, 0, 0), "ros")
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert peak <= sizes[-1] + AROUND
    assert sizes[-1] <= 16 * MIB


def test_where_a_picture_lies_is_told_without_room(monkeypatch):
    desk = Desk(50.0, limit=MIB)
    with desk.in_flight.making(MIB):
        assert desk.answers.map("pgw", {}).body.startswith(b"0.1\n")
        with pytest.raises(Busy):
            desk.answers.map("pgw", {"max_size": "100"})


@pytest.mark.parametrize("form", ["json", "npz", "pgm", "yaml"])
def test_what_has_no_room_is_not_even_begun(form, monkeypatch):
    desk = Desk(50.0, limit=MIB)
    monkeypatch.setattr(formats_module, f"encode_{form}", None)
    with (
        desk.in_flight.making(MIB),
        pytest.raises(Busy, match=r"making this one takes \d+ MiB: try again later"),
    ):
        desk.answers.map(form, {})
    assert desk.in_flight.held == 0


def test_it_is_held_while_it_is_made_and_given_back(slow, in_background, eventually):
    desk = Desk(20.0)
    making = in_background(desk.answers.map, "json", {})
    eventually(lambda: slow.begun == 1)
    cells = desk.live.snapshot().width * desk.live.snapshot().height
    assert desk.in_flight.held == 8 * cells
    slow.set()
    making.result(DEADLINE)
    assert desk.in_flight.held == 0


@pytest.mark.parametrize("region", [lambda k: f"0,0,{100 + k},1e9", lambda _: WHOLE])
def test_large_answers_take_half_of_the_threads_and_small_ones_find_the_others(
    slow, region, monkeypatch, in_background, eventually
):
    monkeypatch.setattr(large_module, "LARGE", 1000)
    desk = Desk(20.0)
    made = [in_background(desk.answers.map, "json", {"region": region(k)}) for k in range(LARGE_AT_ONCE)]
    eventually(lambda: desk.answers.memory.large._places._value == 0)
    with pytest.raises(Busy, match="4 answers of more than 1000 cells are being made: try again later"):
        desk.answers.map("npz", {})
    assert desk.answers.map("json", {"region": "0,0,2,2"}).body
    assert desk.answers.map("png", {}).body  # it is kept up to date
    assert not any(answer.done() for answer in made)
    slow.set()
    assert all(answer.result(DEADLINE).body for answer in made)
    assert desk.answers.map("npz", {}).body


def test_readers_of_large_maps_are_told_over_http_and_zenoh_to_come_later(
    slow, mapper, monkeypatch, in_background, eventually
):
    monkeypatch.setattr(large_module, "LARGE", 1000)
    mapper.scan([30.0] * 60, pose=[0.0, 0.0, 0.0], range_max=40.0)
    mapper.settle(received=1)
    for k in range(LARGE_AT_ONCE):
        in_background(mapper.service.answers.map, "json", {"region": f"-{90 + k},-90,90,90"})
    eventually(lambda: slow.begun == LARGE_AT_ONCE)
    response = mapper.http.get("/map.json")
    assert (response.status_code, response.headers["retry-after"]) == (503, "2")
    assert mapper.problem("map")["type"] == "busy"
    assert mapper.http.get("/cell?x=0&y=0").status_code == 200
    assert mapper.http.get("/map.json?region=0,0,0.5,0.5").status_code == 200
    slow.set()
    eventually(lambda: mapper.http.get("/map.json").status_code == 200)
