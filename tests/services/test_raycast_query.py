"""Rays that a mapper casts: the same bytes over HTTP and Zenoh, and what the client makes of its map."""

import json
import math
import re
from urllib.parse import urlencode

import numpy as np
import pytest

from ogm_client import BadReply, MapClient, MapperError
from ogm_services.mapper.serving import raycasts
from ogm_services.mapper.serving.query_parameters import ChoiceParameter, NumberParameter

MIDDLE = {"x": 0.25, "y": 0.25}
QUARTER = math.pi / 2


def raycast(mapper, **given):
    """What a mapper answers, the same over HTTP and Zenoh."""
    response = mapper.http.get("/raycast", params=given)
    reply = mapper.answer("raycast", ";".join(f"{name}={value}" for name, value in given.items()))
    assert response.status_code == 200, response.text
    assert reply.payload.to_bytes() == response.content
    assert str(reply.encoding) == response.headers["content-type"] == "application/json"
    assert response.headers["cache-control"] == "no-store"
    return response.json()


def refused(mapper, **given):
    """The problem that a mapper answers, the same over HTTP and Zenoh."""
    response = mapper.http.get("/raycast", params=given)
    assert response.headers["content-type"] == "application/problem+json"
    told = mapper.problem("raycast", ";".join(f"{name}={value}" for name, value in given.items()))
    assert told == response.json()
    assert told["status"] == response.status_code
    return told["status"], told["type"], told["detail"]


def test_rays_of_a_scan(cross):
    reply = raycast(cross, **MIDDLE, n=4, angle_increment=QUARTER)
    status = cross.status()
    assert {name: reply[name] for name in ("epoch", "run", "revision")} == {
        name: status[name] for name in ("epoch", "run", "revision")
    }
    assert list(reply) == ["epoch", "run", "revision", "ranges", "ends"]
    assert reply["ranges"] == pytest.approx([1.75, 1.25, 0.75, 0.25])
    assert reply["ends"] == ["hit", "hit", "hit", "unknown"]  # to the south it has been seen free once only


def test_bearings_ranges_and_what_is_unknown(cross):
    turned = raycast(cross, **MIDDLE, theta=QUARTER, angle_min=-QUARTER, n=1)
    assert (turned["ranges"], turned["ends"]) == ([1.75], ["hit"])
    short = raycast(cross, **MIDDLE, range_max=1.7, n=2, angle_increment=-QUARTER)
    assert (short["ranges"], short["ends"]) == ([1.7, pytest.approx(0.25)], ["none", "unknown"])
    through = raycast(cross, **MIDDLE, n=4, angle_increment=QUARTER, unknown="pass")
    assert through["ranges"] == pytest.approx([1.75, 1.25, 0.75, 1000.0])
    assert through["ends"] == ["hit", "hit", "hit", "none"]


def test_rays_are_those_of_the_clients_grid_to_the_last_bit(cross):
    rng = np.random.default_rng(3)
    with MapClient(cross.endpoint, map_name="hall") as client, MapClient(str(cross.http.base_url)) as http:
        grid = client.get_map()
        for _ in range(40):
            x, y = rng.uniform([-1.0, -2.5], [2.5, 2.0])
            theta, first, step = rng.uniform(-7, 7), rng.uniform(-4, 4), rng.uniform(-0.3, 0.3)
            fan = {"angle_min": first, "angle_increment": step, "n": 50}
            for unknown, longest in (("stop", 1000.0), ("pass", 2.0), ("stop", 0.9)):
                told = [
                    each.raycast(x, y, theta, **fan, max_range=longest, unknown=unknown)
                    for each in (client, http)
                ]
                bearings = [theta + (first + k * step) for k in range(50)]
                here = grid.raycast(x, y, bearings, longest, unknown=unknown)
                for rays in told:
                    assert rays.range.tolist() == here.range.tolist()
                    assert rays.found.tolist() == here.found.tolist()
    assert {"occupied", "unknown", "nothing"} >= set(here.found)


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({}, "x: missing"),
        ({"x": 0}, "y: missing"),
        ({"x": "east"}, "x: a number is needed, got 'east'"),
        ({"x": 0, "y": "nan"}, "y: a number is needed"),
        ({"x": 9, "y": 0.25}, r"point \(9, 0.25\) lies outside the map, x -1 to 2.5, y -2.5 to 2 m"),
        ({"x": 1e300, "y": 0}, r"point \(1e\+300, 0\): no cell has such coordinates"),
        ({"n": 0}, "n: 1 to 10000 is needed, got 0"),
        ({"n": 10_001}, "n: 1 to 10000 is needed, got 10001"),
        ({"n": 2.5}, "n: a whole number is needed, got 2.5"),
        ({"range_max": 0}, "range_max: more than 0 and at most 1000 is needed, got 0"),
        ({"range_max": -1}, "range_max: more than 0"),
        ({"range_max": 1000.5}, "range_max: more than 0 and at most 1000 is needed, got 1000.5"),
        ({"theta": 2e6}, "theta: -1000000 to 1000000 is needed, got 2"),
        ({"angle_min": "inf"}, "angle_min: a number is needed"),
        ({"angle_increment": 1e300}, "angle_increment"),
        ({"unknown": "go"}, "unknown: one of stop, pass is needed, got 'go'"),
        ({"max_range": 3}, "max_range: unknown parameter; there are: angle_increment, angle_min, n, "),
    ],
)
def test_what_cannot_be_cast_is_named(cross, given, named):
    asked = given if given.keys() <= {"x", "y"} else MIDDLE | given
    status, kind, detail = refused(cross, **asked)
    assert (status, kind) == (400, "bad-parameter")
    assert re.match(named, detail), detail


def test_a_parameter_that_is_given_twice(cross):
    response = cross.http.get(f"/raycast?{urlencode([('x', 0), ('x', 0), ('y', 0)])}")
    assert (response.status_code, response.json()["detail"]) == (400, "x: given twice")
    assert cross.problem("raycast", "x=0;y=0;x=0")["detail"] == "x: given twice"


def test_rays_that_would_cross_too_many_cells_are_refused(cross, monkeypatch):
    monkeypatch.setattr(raycasts, "MAX_CROSSED", 100)
    status, kind, detail = refused(cross, **MIDDLE, n=20, range_max=1.0)
    assert (status, kind) == (400, "bad-parameter")
    assert detail == (
        "n, range_max: these rays may cross 120 cells, at most 100 are looked at: ask for fewer rays, or "
        "shorter ones"
    )
    assert len(raycast(cross, **MIDDLE, n=16, range_max=1.0)["ranges"]) == 16


def test_an_empty_map_casts_no_ray(mapper):
    assert refused(mapper, **MIDDLE)[:2] == (404, "map-empty")
    with MapClient(mapper.endpoint, map_name="hall") as client, pytest.raises(MapperError, match="map-empty"):
        client.raycast(0.0, 0.0)


def test_the_map_of_the_moment_answers(mapper):
    mapper.draw_cross()
    before = raycast(mapper, **MIDDLE)
    mapper.http.post("/erase?region=1.5,0,2,0.5").raise_for_status()
    after = raycast(mapper, **MIDDLE)
    assert (before["ranges"], before["ends"]) == ([1.75], ["hit"])
    assert (after["ranges"], after["ends"]) == ([1.25], ["unknown"])
    assert after["revision"] == before["revision"] + 1


@pytest.mark.parametrize(
    "fields",
    [{"ranges": [1.0]}, {"ends": ["hit"]}, {"ends": ["wall"]}, {"ranges": [], "ends": []}],
)
def test_a_reply_that_is_no_mappers(cross, fields, monkeypatch):
    with MapClient(cross.endpoint, map_name="hall") as client:
        said = {
            "epoch": "e",
            "run": "r",
            "revision": 1,
            "ranges": [1.0, 2.0],
            "ends": ["hit", "none"],
        } | fields
        monkeypatch.setattr(client._transport, "fetch", lambda *_: json.dumps(said).encode())
        with pytest.raises(BadReply, match="raycast: a range and an end are needed of each of 2 rays"):
            client.raycast(0.0, 0.0, n=2)


def test_openapi_tells_ranges_and_defaults_and_heeds_them(cross):
    document = cross.http.get("/openapi.json").json()
    operation = document["paths"]["/raycast"]["get"]
    schemas = {parameter["name"]: parameter["schema"] for parameter in operation["parameters"]}
    assert [parameter["name"] for parameter in operation["parameters"] if parameter["required"]] == ["x", "y"]
    assert schemas["n"] == {
        "type": "integer",
        "minimum": 1,
        "maximum": 10_000,
        "examples": [1],
        "default": 1,
    }
    assert schemas["range_max"] == {
        "type": "number",
        "exclusiveMinimum": 0.0,
        "maximum": 1000.0,
        "examples": [1000.0],
        "default": 1000.0,
    }
    assert schemas["unknown"] == {
        "type": "string",
        "enum": ["stop", "pass"],
        "examples": ["stop"],
        "default": "stop",
    }
    assert set(operation["responses"]) == {"200", "400", "404", "421", "500", "503", "default"}
    content = operation["responses"]["200"]["content"]["application/json"]
    described = document["components"]["schemas"][content["schema"]["$ref"].rpartition("/")[2]]
    assert list(described["properties"]) == list(raycast(cross, **MIDDLE))
    for name in ("n", "range_max"):
        assert raycast(cross, **MIDDLE, **{name: schemas[name]["maximum"]})
    assert cross.http.head("/raycast", params=MIDDLE).status_code == 200


def test_parameters_describe_what_they_read():
    free = NumberParameter("a", "said")
    assert (free.schema(), free.needed, free.read({"a": "-3"})) == ({"type": "number"}, True, -3.0)
    assert ChoiceParameter("b", "said", ("one", "two")).read({"b": "two"}) == "two"
