"""Distances and inflation that a mapper computes: alike over HTTP and Zenoh, with validators and limits."""

import io
import re
import tracemalloc
from contextlib import ExitStack

import msgpack
import numpy as np
import pytest
from PIL import Image

from ogm_client import BadReply, MapClient, MapperError, MissingExtra
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.placing.receipts import Receipts
from ogm_core.types import Pose, Scan
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.live.monitor import Monitor
from ogm_services.mapper.serving import large_answers
from ogm_services.mapper.serving.answer_memory import AnswerMemory
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.large_answers import LARGE_AT_ONCE
from ogm_services.replies.answer import Busy
from ogm_services.replies.in_flight import InFlight

LAYERS = ["distance", "inflate"]
NEEDED = {"distance": {}, "inflate": {"radius": "0.5"}}
MEDIA = {"png": "image/png", "npz": "application/x-npz"}
MIB = 2**20


def fetch(mapper, layer, form, **given):
    """A layer over HTTP, after a look whether Zenoh has the same bytes and says the same of them."""
    response = mapper.http.get(f"/{layer}.{form}", params=given)
    assert response.status_code == 200, response.text
    parameters = ";".join(f"{name}={value}" for name, value in {"format": form, **given}.items())
    reply = mapper.answer(layer, parameters)
    assert reply.payload.to_bytes() == response.content
    assert str(reply.encoding) == response.headers["content-type"] == MEDIA[form]
    meta = msgpack.unpackb(reply.attachment.to_bytes())
    assert f'"{meta["epoch"]}-{meta["run"]}-{meta["revision"]}"' == response.headers["etag"]
    assert float(response.headers["ogm-resolution"]) == meta["resolution"]
    assert response.headers["ogm-origin"] == f"{meta['origin']['x']},{meta['origin']['y']}"
    return response


def arrays(response):
    with np.load(io.BytesIO(response.content)) as archive:
        return dict(archive)


def pixels(response):
    with Image.open(io.BytesIO(response.content)) as image:
        assert image.mode == "L"
        return np.asarray(image)


def refused(mapper, layer, form, **given):
    """Status, type and detail of the problem, the same over HTTP and Zenoh."""
    response = mapper.http.get(f"/{layer}.{form}", params=given)
    parameters = ";".join(f"{name}={value}" for name, value in {"format": form, **given}.items())
    told = mapper.problem(layer, parameters)
    assert response.headers["content-type"] == "application/problem+json"
    assert told == response.json()
    return told["status"], told["type"], told["detail"]


def test_distances_in_metres(cross):
    found = arrays(fetch(cross, "distance", "npz"))
    assert found["distance"].dtype == np.float32
    assert found["distance"].shape == (9, 7)
    # Walls are the cells (4, 0), (0, 3) and (-2, 0); the lower-left one is (-2, -5).
    walls = [(5, 6), (8, 2), (5, 0)]
    for row, column in np.ndindex(9, 7):
        nearest = min(np.hypot(row - y, column - x) for y, x in walls)
        assert found["distance"][row, column] == np.float32(nearest * 0.5)
    place = arrays(cross.http.get("/map.npz"))
    assert {"distance", *place} - {"log_odds"} == set(found)
    assert all(np.array_equal(found[name], place[name]) for name in place if name != "log_odds")


def test_inflated_cells(cross):
    found, before = (
        arrays(fetch(cross, "inflate", "npz", radius=0.5)),
        cross.http.get("/map.json?values=trinary"),
    )
    states = np.array(before.json()["data"]).reshape(9, 7)
    near = arrays(fetch(cross, "distance", "npz"))["distance"] <= 0.5
    assert found["occupancy"].dtype == np.int8
    assert np.array_equal(found["occupancy"], np.where(near, 100, states))
    assert near.sum() == 3 * 4  # each wall is at an edge of the map; unknown cells count as any other
    assert np.array_equal(arrays(fetch(cross, "inflate", "npz", radius=0))["occupancy"], states)


def test_pictures(cross):
    metres = arrays(cross.http.get("/distance.npz"))["distance"][::-1]
    grey = pixels(fetch(cross, "distance", "png"))
    assert np.array_equal(grey, np.minimum(np.floor(100 * metres + 0.5), 255))
    assert grey[3, 5] == 50  # beside the wall in the east, one cell of 0.5 m away
    shortest = pixels(fetch(cross, "distance", "png", max_distance=0.001))
    assert np.array_equal(shortest, np.where(metres == 0.0, 0, 255))
    wide = pixels(fetch(cross, "distance", "png", max_distance=10))
    assert np.array_equal(wide, np.floor(25.5 * metres + 0.5))
    states = arrays(cross.http.get("/inflate.npz?radius=0.5"))["occupancy"][::-1]
    greys = np.select([states == 100, states == 0], [0, 254], 205)
    assert np.array_equal(pixels(fetch(cross, "inflate", "png", radius=0.5)), greys)
    assert np.array_equal(
        pixels(fetch(cross, "inflate", "png", radius=0)), pixels(cross.http.get("/map.png"))
    )


@pytest.mark.parametrize("longest", [{}, {"max_distance": 0.6}])
def test_a_region_is_cut_from_the_whole(cross, longest):
    whole = arrays(cross.http.get("/distance.npz", params=longest))["distance"]
    response = fetch(cross, "distance", "npz", region="0.1,-1,1.4,0.9", **longest)
    found = arrays(response)
    assert found["offset"].tolist() == [0, -2]
    assert np.array_equal(found["distance"], whole[3:7, 2:5])
    assert response.headers["ogm-origin"] == "0.0,-1.0"
    assert (found["distance"] == np.float32(0.6)).any() == bool(longest)
    grown = arrays(cross.http.get("/inflate.npz?radius=1"))["occupancy"]
    part = arrays(fetch(cross, "inflate", "npz", region="0.1,-1,1.4,0.9", radius=1))["occupancy"]
    assert np.array_equal(part, grown[3:7, 2:5])


def test_it_is_what_the_clients_grid_computes(cross):
    with MapClient(cross.endpoint, map_name="hall") as client, MapClient(str(cross.http.base_url)) as http:
        grid = client.get_map()
        for each in (client, http):
            for longest in (None, 0.8):
                here = grid.distance() if longest is None else grid.distance(longest)
                there = each.distance(max_distance=longest)
                assert np.array_equal(here.values, there.values)
                assert there.values.dtype == here.values.dtype == np.float32
            assert np.array_equal(grid.inflate(0.75).values, each.inflate(0.75).values)
            part = each.distance((0.1, -1.0, 1.4, 0.9))
            assert (part.origin, part.at(1.25, 0.25)) == ((0.0, -1.0), grid.distance().at(1.25, 0.25))
            assert each.inflate(0.5, (0.1, -1.0, 1.4, 0.9)).values.shape == (4, 3)
            assert np.isnan(part.at(9.0, 9.0))
            for name in ("resolution", "anchor", "epoch", "run", "revision", "stamp"):
                assert getattr(part, name) == getattr(grid, name), name
            assert each.fetch("inflate.png", radius=0.5) == cross.http.get("/inflate.png?radius=0.5").content


@pytest.mark.parametrize("layer", LAYERS)
@pytest.mark.parametrize("form", MEDIA)
def test_validators(cross, layer, form):
    response = fetch(cross, layer, form, **NEEDED[layer])
    etag = response.headers["etag"]
    assert etag == cross.http.get("/map.npz").headers["etag"]
    assert response.headers["cache-control"] == "no-cache"
    path = f"/{layer}.{form}"
    for headers, status in (
        ({"If-None-Match": etag}, 304),
        ({"If-None-Match": '"other"'}, 200),
        ({"If-Match": etag}, 200),
        ({"If-Match": '"other"'}, 412),
    ):
        assert cross.http.get(path, params=NEEDED[layer], headers=headers).status_code == status
    assert cross.http.head(path, params=NEEDED[layer]).headers["etag"] == etag


def test_it_is_computed_once_for_all_who_ask_until_the_map_changes(mapper, monkeypatch):
    mapper.draw_cross()
    made = []
    make = mapper.service.answers.queries._made
    monkeypatch.setattr(mapper.service.answers.queries, "_made", lambda *a: made.append(a) or make(*a))
    first = fetch(mapper, "distance", "npz")
    assert fetch(mapper, "distance", "npz").content == first.content
    fetch(mapper, "inflate", "png", radius=1)
    assert len(made) == 2
    mapper.http.post("/erase?region=1.5,0,3,0.5").raise_for_status()
    after = fetch(mapper, "distance", "npz")
    assert len(made) == 3
    assert after.headers["etag"] != first.headers["etag"]
    # What is left are the walls in the north and in the west.
    assert arrays(after)["distance"].max() > arrays(first)["distance"].max()


@pytest.mark.parametrize("layer", LAYERS)
def test_an_empty_map(mapper, layer):
    assert refused(mapper, layer, "png", **NEEDED[layer])[:2] == (404, "map-empty")
    found = arrays(fetch(mapper, layer, "npz", **NEEDED[layer]))
    (values,) = [found[name] for name in ("distance", "occupancy") if name in found]
    assert values.shape == (0, 0)
    with MapClient(mapper.endpoint, map_name="hall") as client:
        assert client.distance().values.shape == client.inflate(1.0).values.shape == (0, 0)


def test_a_map_without_an_occupied_cell(mapper):
    mapper.scan([float("inf")] * 8, pose=[0.25, 0.25, 0.0], range_max=2.0, at=1)
    mapper.scan([float("inf")] * 8, pose=[0.25, 0.25, 0.0], range_max=2.0, at=2)
    mapper.settle(received=2)
    assert np.isposinf(arrays(fetch(mapper, "distance", "npz"))["distance"]).all()
    assert (arrays(fetch(mapper, "distance", "npz", max_distance=3))["distance"] == 3.0).all()
    assert (pixels(fetch(mapper, "distance", "png")) == 255).all()
    grown = fetch(mapper, "inflate", "png", radius=5)
    assert np.array_equal(pixels(grown), pixels(mapper.http.get("/map.png")))


@pytest.mark.parametrize(
    ("layer", "form", "given", "status", "detail"),
    [
        ("inflate", "png", {}, 400, "radius: missing"),
        ("inflate", "npz", {"radius": -0.1}, 400, "radius: 0 to 100 is needed, got -0.1"),
        ("inflate", "npz", {"radius": 101}, 400, "radius: 0 to 100 is needed, got 101"),
        ("inflate", "npz", {"radius": "wide"}, 400, "radius: a number is needed, got 'wide'"),
        ("inflate", "npz", {"radius": 1, "max_distance": 1}, 400, "max_distance: unknown parameter"),
        ("distance", "npz", {"max_distance": 0}, 400, "max_distance: 0.001 to 1000 is needed"),
        (
            "distance",
            "png",
            {"max_distance": 1001},
            400,
            "max_distance: 0.001 to 1000 is needed",
        ),
        ("distance", "npz", {"radius": 1}, 400, "radius: unknown parameter; there are: at, max_distance, "),
        ("distance", "npz", {"region": "1,1,0,0"}, 400, "region: xmin < xmax"),
        ("distance", "png", {"region": "90,90,91,91"}, 400, "region .* lies wholly outside the map"),
        ("distance", "png", {"region": "1,1"}, 400, "region: xmin,ymin,xmax,ymax is needed"),
    ],
)
def test_what_cannot_be_computed_is_named(cross, layer, form, given, status, detail):
    told, kind, said = refused(cross, layer, form, **given)
    assert (told, kind) == (status, "bad-parameter")
    assert re.match(detail, said), said


def test_formats(cross):
    assert cross.http.get("/distance.gif").status_code == cross.http.get("/distance").status_code == 404
    problem = cross.problem("distance", "format=json")
    assert (problem["status"], problem["detail"]) == (404, "format: one of png, npz is needed, got 'json'")
    for layer in LAYERS:
        problem = cross.problem(layer, "radius=1")
        assert (problem["status"], problem["type"]) == (400, "bad-parameter")
        assert problem["detail"] == "format: missing: it says in which one the answer is to be"


def test_a_reply_that_is_no_mappers(cross, monkeypatch):
    with MapClient(cross.endpoint, map_name="hall") as client:
        reply = client._transport.fetch_map({"radius": "1"}, "inflate.npz")
        monkeypatch.setattr(client._transport, "fetch_map", lambda *_: reply)
        with pytest.raises(BadReply, match="distance: not a layer that can be read"):
            client.distance()
        monkeypatch.setattr(client._transport, "fetch_map", lambda *_: reply._replace(npz=b"garbage"))
        with pytest.raises(BadReply, match="occupancy: not a layer that can be read"):
            client.inflate(1.0)
    small = MapClient(cross.endpoint, map_name="hall", max_bytes=500)
    with small, pytest.raises(BadReply, match="longer than 500 bytes"):
        small.distance()
    with MapClient(cross.endpoint, map_name="hall") as client, pytest.raises(MapperError, match="radius"):
        client.inflate(1000.0)
    assert issubclass(MissingExtra, Exception)


class Desk:
    """Answers about a map of two scans far from each other."""

    def __init__(self, side, limit=2**40):
        live = LiveMap(OccupancyGrid(GridSettings(resolution=0.1), "e"))
        for x in (0.0, side):
            live.integrate(Scan(1, 0.0, 1.0, 0.0, 20.0, np.full(1, 1.5, np.float32)), Pose(x, x, 0.0))
        self.in_flight = InFlight(limit)
        self.queries = Answers(
            "hall", live, Receipts(), Monitor(live), memory=AnswerMemory(in_flight=self.in_flight)
        ).queries


@pytest.mark.parametrize("form", MEDIA)
@pytest.mark.parametrize("layer", LAYERS)
@pytest.mark.parametrize("region", [{}, {"region": "50,50,100,100"}])
def test_no_layer_takes_more_to_make_than_is_held_for_it(layer, form, region, monkeypatch):
    desk, sizes = Desk(150.0), []
    monkeypatch.setattr(desk.in_flight, "making", lambda size: sizes.append(size) or ExitStack())
    make = getattr(desk.queries, layer)
    make(
        form,
        {"region": "0,0,1,1", "max_distance": "1"}
        if layer == "distance"
        else {"region": "0,0,1,1", "radius": "1"},
    )
    tracemalloc.start()
    try:
        make(form, {**NEEDED[layer], **region})
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak <= sizes[-1] + 4 * MIB
    assert sizes[-1] <= 60 * MIB  # of 2.25 million cells


@pytest.mark.parametrize("query", ["raycast", "check"])
def test_no_ray_nor_check_takes_more_than_is_held_for_it(query, monkeypatch):
    desk, sizes = Desk(150.0), []
    monkeypatch.setattr(desk.in_flight, "making", lambda size: sizes.append(size) or ExitStack())
    ask = {
        "raycast": lambda: desk.queries.raycast({"x": "1", "y": "0", "n": "900", "angle_increment": "0.01"}),
        "check": lambda: desk.queries.check({}, b'{"points": [[0, 0], [150, 150]]}'),
    }[query]
    ask()  # kernels are compiled
    tracemalloc.start()
    try:
        ask()
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert sizes[-1] > 2e6  # it looks at all of the map
    assert peak <= sizes[-1] + 4 * MIB


def test_what_has_no_room_is_not_begun_and_what_is_large_takes_its_turn(monkeypatch):
    desk = Desk(50.0, limit=MIB)
    with (
        desk.in_flight.making(MIB),
        pytest.raises(Busy, match=r"making this one takes \d+ MiB: try again later"),
    ):
        desk.queries.distance("npz", {})
    assert desk.in_flight.held == 0
    monkeypatch.setattr(large_answers, "LARGE", 1000)
    with ExitStack() as others:
        for _ in range(LARGE_AT_ONCE):
            others.enter_context(desk.queries._memory.large.making(1001))
        with pytest.raises(Busy, match="4 answers of more than 1000 cells are being made"):
            desk.queries.distance("npz", {"region": "0,0,1,1"})  # it looks at all of the map
        assert desk.queries.distance("npz", {"region": "0,0,1,1", "max_distance": "0.5"}).body
    assert desk.queries.distance("npz", {"region": "0,0,1,1"}).body


def test_openapi_tells_ranges(cross):
    paths = cross.http.get("/openapi.json").json()["paths"]
    schemas = {
        (path, parameter["name"]): (parameter["schema"], parameter["required"])
        for path in ("/distance.png", "/distance.npz", "/inflate.png", "/inflate.npz")
        for parameter in paths[path]["get"]["parameters"]
    }
    longest = {"type": "number", "minimum": 0.001, "maximum": 1000.0}
    assert schemas["/distance.npz", "max_distance"] == ({**longest, "examples": [5.0]}, False)
    assert schemas["/distance.png", "max_distance"] == (
        {**longest, "examples": [2.55], "default": 2.55},
        False,
    )
    radius = {"type": "number", "minimum": 0.0, "maximum": 100.0, "examples": [0.3]}
    assert schemas["/inflate.png", "radius"] == (radius, True)
    for path in ("/distance.npz", "/inflate.png"):
        answers = {"200", "304", "400", "404", "412", "421", "500", "503", "default"}
        assert set(paths[path]["get"]["responses"]) == answers


@pytest.mark.parametrize("form", ["png", "npz"])
@pytest.mark.parametrize("layer", LAYERS)
def test_layers_of_a_saved_map_are_those_of_the_map_then(start_mapper, tmp_path, layer, form):
    with start_mapper(map={"resolution": 0.5}, mapper={"data": tmp_path}) as mapper:
        mapper.draw_cross()
        parts = [NEEDED[layer], {**NEEDED[layer], "region": "-1,-1,1,1"}]
        then = [fetch(mapper, layer, form, **part) for part in parts]
        mapper.http.post("/save?name=monday").raise_for_status()
        mapper.scan([0.6], pose=[0.25, 0.25, 2.4], at=9)
        mapper.settle(received=4)
        for before, part in zip(then, parts, strict=True):
            saved = fetch(mapper, layer, form, at="monday", **part)
            assert saved.content == before.content
            assert saved.headers["etag"] == before.headers["etag"]
            assert fetch(mapper, layer, form, **part).content != before.content
        mapper.http.delete("/snapshots/monday").raise_for_status()
        assert refused(mapper, layer, form, at="monday", **NEEDED[layer])[:2] == (404, "unknown-snapshot")


def test_a_mapper_without_a_store_has_no_layers_of_saved_maps(cross):
    assert refused(cross, "distance", "npz", at="monday")[:2] == (503, "not-stored")


@pytest.mark.parametrize("over_http", [True, False])
def test_the_client_asks_for_layers_of_saved_maps(start_mapper, tmp_path, over_http):
    with start_mapper(map={"resolution": 0.5}, mapper={"data": tmp_path}) as mapper:
        mapper.draw_cross()
        address = str(mapper.http.base_url) if over_http else mapper.endpoint
        with MapClient(address, map_name="hall") as client:
            then = client.distance(max_distance=3.0), client.inflate(0.5, (-1, -1, 1, 1))
            client.save_snapshot("monday")
            mapper.scan([0.6], pose=[0.25, 0.25, 2.4], at=9)
            mapper.settle(received=4)
            saved = (
                client.distance(max_distance=3.0, at="monday"),
                client.inflate(0.5, (-1, -1, 1, 1), at="monday"),
            )
            now = client.distance(max_distance=3.0), client.inflate(0.5, (-1, -1, 1, 1))
    for before, one, other in zip(then, saved, now, strict=True):
        assert np.array_equal(one.values, before.values)
        assert (one.revision, one.offset) == (3, before.offset)
        assert other.revision == 4
        assert not np.array_equal(other.values, before.values)
