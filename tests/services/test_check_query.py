"""Points and footprints that a mapper checks: alike over HTTP and Zenoh, without a token, within limits."""

import json
import re

import numpy as np
import pytest

from ogm_client import BadParameter, BadReply, MapClient, MapperError
from ogm_services.mapper.serving.checks import MAX_BODY

# In the cross: seen free twice, a wall, seen free once, and beyond it.
FREE, WALL, UNDECIDED, BEYOND = [0.75, 0.25], [2.25, 0.25], [0.25, -0.25], [9.0, 9.0]


def ask(mapper, body):
    """The replies over HTTP and Zenoh: the status of the first one, and what both say."""
    content = body if isinstance(body, bytes) else json.dumps(body).encode()
    response = mapper.http.post("/check", content=content)
    (reply,) = mapper.session.get(f"{mapper.keys.root}/check", payload=content, timeout=30.0)
    said = reply.ok or reply.err
    assert (reply.ok is None) == (response.status_code != 200)
    assert said.payload.to_bytes() == response.content
    assert str(said.encoding) == response.headers["content-type"]
    assert response.headers["cache-control"] == "no-store"
    return response.status_code, response.json()


def states(mapper, **body):
    status, said = ask(mapper, body)
    assert status == 200, said
    assert list(said) == ["epoch", "run", "revision", "states"]
    assert {name: said[name] for name in said if name != "states"} == {
        name: mapper.status()[name] for name in ("epoch", "run", "revision")
    }
    return said["states"]


def test_points(cross):
    points = [FREE, WALL, UNDECIDED, BEYOND, [0.25, 0.25]]
    assert states(cross, points=points) == ["free", "occupied", "unknown", "unknown", "unknown"]
    assert states(cross, points=[[1.75, 0.25]]) == ["free"]
    assert states(cross, points=[[1.75, 0.25]], margin=0.2) == ["free"]
    assert states(cross, points=[[1.75, 0.25]], margin=0.25) == ["occupied"]  # it touches the wall
    assert states(cross, points=[[2.0, 0.25]]) == ["occupied"]
    assert states(cross, points=[[1.25, 0.25]], margin=0.25) == ["unknown"]  # and what is beside its row


def test_footprints(cross):
    box = [[0.5, 0.1], [1.9, 0.1], [1.9, 0.4], [0.5, 0.4]]
    beside = [[x, y + 0.15] for x, y in box]
    assert states(cross, footprints=[box, beside]) == [
        "unknown",
        "unknown",
    ]  # on the edge of the sensor's own cell
    box[0][0] = box[3][0] = 0.6
    assert states(cross, footprints=[box, beside]) == ["free", "unknown"]
    assert states(cross, footprints=[box], margin=0.1) == ["occupied"]
    assert states(cross, footprints=[[[-3, -3], [3, -3], [3, 3], [-3, 3]]]) == ["occupied"]


def test_it_is_what_the_clients_grid_says(cross):
    rng = np.random.default_rng(4)
    with MapClient(cross.endpoint, map_name="hall") as client, MapClient(str(cross.http.base_url)) as http:
        grid, seen = client.get_map(), set()
        for margin in (0.0, 0.2, 0.5):
            points = rng.uniform(-2.5, 3.0, (300, 2))
            said = grid.check(points, margin=margin).tolist()
            assert said == client.check(points, margin=margin).tolist()
            assert said == http.check(points, margin=margin).tolist()
            boxes = [point + rng.uniform(-0.2, 0.2, (4, 2)) for point in points[:80]]
            said += grid.check(footprints=boxes, margin=margin).tolist()
            assert said[300:] == client.check(footprints=boxes, margin=margin).tolist()
            assert said[300:] == http.check(footprints=boxes, margin=margin).tolist()
            seen |= set(said)
    assert seen == {"free", "occupied", "unknown"}


def test_an_empty_map_is_unknown(mapper):
    assert states(mapper, points=[[0, 0]], margin=1) == ["unknown"]
    with MapClient(mapper.endpoint, map_name="hall") as client:
        assert client.get_map().check([(0.0, 0.0)]).tolist() == ["unknown"]


@pytest.mark.parametrize(
    ("body", "detail"),
    [
        (b"", 'body: JSON is needed, such as {"points": '),
        (b"{", "body: JSON is needed"),
        (b"[[1, 2]]", "body: a JSON object is needed"),
        (b"[" * 5000, "body: JSON is needed"),
        (b'{"points": [[NaN, 0]]}', "body: JSON is needed"),
        ({}, "points or footprints: one of them is needed"),
        ({"points": [FREE], "footprints": []}, "points or footprints: one of them is needed"),
        ({"points": [FREE], "radius": 1}, "radius: unknown; there are: footprints, margin, points"),
        ({"points": []}, "points, footprints: 1 to 4096 are needed, got 0"),
        ({"points": 7}, "points: a list is needed, got 7"),
        ({"points": [7]}, r"points: a point \[x, y\] is needed, got 7"),
        ({"points": [[1, 2, 3]]}, r"points: a point \[x, y\] is needed, got \[1, 2, 3\]"),
        ({"points": [[1, True]]}, "points: a number is needed, got True"),
        ({"points": [[1, "2"]]}, "points: a number is needed, got '2'"),
        ({"points": [[1, 1e300]]}, "footprints: finite numbers are needed, of places that have cells"),
        ({"points": [FREE], "margin": -1}, "margin: 0 to 100 m is needed, got -1"),
        ({"points": [FREE], "margin": None}, "margin: a number is needed, got None"),
        ({"footprints": [FREE]}, r"footprints: a point \[x, y\] is needed, got 0.75"),
        ({"footprints": [3]}, "footprints: a list is needed, got 3"),
        ({"footprints": [[FREE]]}, "footprints: number 0: 3 to 64 corners are needed, got 1"),
        ({"footprints": [[FREE, WALL]]}, "footprints: number 0: 3 to 64 corners are needed, got 2"),
        ({"footprints": [[FREE] * 65]}, "footprints: number 0: 3 to 64 corners are needed, got 65"),
        (
            {"footprints": [[[0, 0], [1e4, 0], [0, 1e4]]]},
            r"points, footprints: .*at most 10000000 are looked at",
        ),
    ],
)
def test_what_cannot_be_checked_is_named(cross, body, detail):
    status, said = ask(cross, body)
    assert (status, said["type"]) == (400, "bad-parameter")
    assert re.match(detail, said["detail"]), said["detail"]


def test_parameters_are_none(cross):
    response = cross.http.post("/check?margin=1", json={"points": [FREE]})
    assert (response.status_code, response.json()["detail"]) == (400, "margin: check has no parameters")
    assert cross.http.get("/check").status_code == 405
    assert cross.problem("check", "margin=1")["detail"] == "margin: check has no parameters"
    assert cross.problem("check")["detail"].startswith("body: JSON is needed")


def test_a_body_has_64_kb_and_no_other_path_takes_that(cross):
    long = json.dumps({"points": [FREE]}).encode().ljust(MAX_BODY)
    assert ask(cross, long)[0] == 200
    response = cross.http.post("/check", content=long + b" ")
    assert (response.status_code, response.json()["type"]) == (413, "content-too-large")
    assert response.json()["detail"] == "the body is longer than 65536 bytes"
    (reply,) = cross.session.get(f"{cross.keys.root}/check", payload=long + b" ", timeout=30.0)
    assert b"payload: at most 65536 bytes may come with this query, got 65537" in reply.err.payload.to_bytes()
    for path in ("/reset", "/check/", "/checks", "/status"):
        assert cross.http.post(path, content=long).status_code == 413
    (reply,) = cross.session.get(f"{cross.keys.root}/raycast", payload=long, timeout=30.0)
    assert b"payload: at most 1024 bytes" in reply.err.payload.to_bytes()
    # On one connection each request has its own limit, and one in chunks, too.
    assert cross.http.post("/check", content=iter([long[:1000], long[1000:]])).status_code == 200
    assert cross.http.post("/reset", content=iter([long[:1000], long[1000:]])).status_code == 413


def test_a_check_needs_no_token_and_no_page_of_elsewhere_may_ask(start_mapper):
    with start_mapper(map={"resolution": 0.5}, http={"token": "secret-of-the-mapper"}) as mapper:
        assert mapper.http.post("/check", json={"points": [FREE]}).json()["states"] == ["unknown"]
        assert mapper.http.post("/reset").status_code == 401
        assert mapper.http.put("/check", json={"points": [FREE]}).status_code == 401
        assert mapper.http.post("/check/", json={"points": [FREE]}).status_code == 401
        for headers, status in (({"Sec-Fetch-Site": "cross-site"}, 403), ({"Host": "elsewhere.org"}, 421)):
            assert mapper.http.post("/check", json={"points": [FREE]}, headers=headers).status_code == status


def test_openapi_tells_the_bodies_and_their_limits(cross):
    document = cross.http.get("/openapi.json").json()
    operation, schemas = document["paths"]["/check"]["post"], document["components"]["schemas"]
    assert set(operation["responses"]) == {"200", "400", "403", "413", "421", "500", "503", "default"}
    (content,) = operation["requestBody"]["content"].values()
    named = [one["$ref"].rpartition("/")[2] for one in content["schema"]["oneOf"]]
    assert named == ["PointsToCheck", "FootprintsToCheck"]
    for name, what in zip(named, ("points", "footprints"), strict=True):
        schema = schemas[name]
        assert (schema["required"], schema["additionalProperties"]) == ([what], False)
        (example,) = schema["examples"]
        status, reply = ask(cross, example)
        assert (status, len(reply["states"])) == (200, len(example[what]))
        margin = schema["properties"]["margin"]
        assert ask(cross, {**example, "margin": margin["maximum"]})[0] == 200
        beyond = [
            {what: []},
            {**example, "margin": margin["maximum"] * 1.001},
            {**example, "margin": margin["minimum"] - 0.001},
            {**example, "more": 1},
        ]
        assert [ask(cross, body)[0] for body in beyond] == [400] * 4
    points = schemas["PointsToCheck"]["properties"]["points"]["maxItems"]
    corners = schemas["FootprintsToCheck"]["properties"]["footprints"]["items"]["maxItems"]
    for most, body in ((points, '{"points":[%s]}'), (corners, '{"footprints":[[%s]]}')):
        asked = [body % ",".join(["[1,0]"] * (most + k)) for k in (0, 1)]
        assert [ask(cross, text.encode())[0] for text in asked] == [200, 400]


@pytest.mark.parametrize("said", [["free"], ["free", "full"], []])
def test_a_reply_that_is_no_mappers(cross, said, monkeypatch):
    with MapClient(cross.endpoint, map_name="hall") as client:
        reply = {"epoch": "e", "run": "r", "revision": 1, "states": said}
        monkeypatch.setattr(client._transport, "ask", lambda *_: json.dumps(reply).encode())
        with pytest.raises(BadReply, match="check: a state is needed of each of 2, got"):
            client.check([(0.0, 0.0), (1.0, 0.0)])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "points or footprints: one of them is needed"),
        ({"points": [(0, 0)], "footprints": []}, "points or footprints: one of them is needed"),
        ({"points": [1.0, 2.0]}, r"points \(x, y\) are needed, got an array of shape \(2,\)"),
        ({"points": [(0, 0, 0)]}, r"shape \(1, 3\)"),
        ({"points": [(0, float("nan"))]}, "points: finite numbers are needed"),
        ({"points": [("a", "b")]}, "points: "),
        ({"footprints": [[(0, 0), (1, 1)]]}, "footprints: number 0: 3 or more corners are needed, got 2"),
    ],
)
def test_mistakes_of_the_callers_are_told_before_anything_is_sent(cross, given, message):
    with MapClient(cross.endpoint, map_name="hall") as client:
        grid = client.get_map()
        for asked in (client, grid):
            with pytest.raises(BadParameter, match=message):
                asked.check(**given)
        with pytest.raises(MapperError, match="margin: 0 to 100 m is needed"):
            client.check([(0.0, 0.0)], margin=-1.0)
        with pytest.raises(BadParameter, match="margin: 0 to 100 m is needed"):
            grid.check([(0.0, 0.0)], margin=-1.0)
