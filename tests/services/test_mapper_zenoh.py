"""The mapper over Zenoh: its queryables, their errors, its liveliness token, one mapper a map."""

import json
import re
from typing import get_args

import msgpack
import pytest
import zenoh

from ogm_core.wire.keys import Write
from ogm_services.mapper.serving.other_mappers import AlreadyMapped
from ogm_services.replies.turns import Turns

WRITES = get_args(Write)
META = ["epoch", "run", "revision", "stamp", "resolution", "width", "height", "origin", "anchor", "offset"]


def alive(session, pattern="ogm/v1/*/alive/mapper/*/*"):
    """Tokens of the mappers that are alive."""
    return {str(reply.ok.key_expr) for reply in session.liveliness().get(pattern, timeout=30.0)}


def told(reply):
    """The type of an error reply."""
    assert str(reply.err.encoding) == "application/problem+json"
    return json.loads(reply.err.payload.to_bytes())["type"]


@pytest.mark.parametrize(
    ("parameters", "path"),
    [
        ("", "/map.json"),
        ("format=json", "/map.json"),
        ("format=json;values=trinary", "/map.json?values=trinary"),
        ("format=png", "/map.png"),
        ("format=png;region=-1,-1,1,1", "/map.png?region=-1,-1,1,1"),
        ("region=-1,-1,1,1;format=png;palette=probability", "/map.png?region=-1,-1,1,1&palette=probability"),
        ("format=png;max_size=3", "/map.png?max_size=3"),
        ("format=pgm", "/map.pgm"),
        ("format=pgm;palette=probability", "/map.pgm?palette=probability"),
        ("format=yaml;region=0,0,1,1", "/map.yaml?region=0,0,1,1"),
        ("format=npz", "/map.npz"),
        ("format=npz;_time=[now(-1h)..]", "/map.npz"),
        ("t=1;format=png;t=2", "/map.png"),
    ],
)
def test_the_map_is_what_http_serves(cross, parameters, path):
    reply, response = cross.answer("map", parameters), cross.http.get(path)
    assert str(reply.key_expr) == "ogm/v1/hall/map"
    assert reply.payload.to_bytes() == response.content
    assert str(reply.encoding) == response.headers["content-type"].partition(";")[0]
    meta = msgpack.unpackb(reply.attachment.to_bytes())
    assert f'"{meta["epoch"]}-{meta["run"]}-{meta["revision"]}"' == response.headers["etag"]
    assert float(response.headers["ogm-resolution"]) == meta["resolution"]
    assert response.headers["ogm-origin"] == f"{meta['origin']['x']},{meta['origin']['y']}"


@pytest.mark.parametrize("region", ["", "region=-1,-1,1,1"])
def test_the_attachment_is_the_json_without_its_data(cross, region):
    body = json.loads(cross.answer("map", region).payload.to_bytes())
    assert {name: body.pop(name) for name in ("map", "frame")} == {"map": "hall", "frame": "map"}
    del body["data"]
    for form in ("json", "png", "pgm", "yaml", "npz"):
        reply = cross.answer("map", f"format={form};{region}")
        meta = msgpack.unpackb(reply.attachment.to_bytes())
        assert list(meta) == META
        assert meta == body
        assert type(meta["stamp"]) is int


def test_an_empty_map(mapper):
    reply = mapper.answer("map")
    assert json.loads(reply.payload.to_bytes())["data"] == []
    meta = msgpack.unpackb(reply.attachment.to_bytes())
    assert (meta["width"], meta["height"], meta["revision"], meta["stamp"]) == (0, 0, 0, None)
    for form in ("png", "pgm", "yaml"):
        assert mapper.problem("map", f"format={form}") == mapper.http.get(f"/map.{form}").json()
        assert mapper.problem("map", f"format={form}")["type"] == "map-empty"
    assert mapper.answer("map", "format=npz").payload.to_bytes() == mapper.http.get("/map.npz").content


@pytest.mark.parametrize(
    ("key", "parameters", "path"),
    [
        ("cell", "x=2.1;y=0.1", "/cell?x=2.1&y=0.1"),
        ("cell", "x=-9;y=9", "/cell?x=-9&y=9"),
    ],
)
def test_json_answers_are_those_of_http(cross, key, parameters, path):
    reply = cross.answer(key, parameters)
    assert str(reply.key_expr) == f"ogm/v1/hall/{key}"
    assert str(reply.encoding) == "application/json"
    assert reply.attachment is None
    assert json.loads(reply.payload.to_bytes()) == cross.http.get(path).json()


def test_quality_is_that_of_http(cross, eventually):
    eventually(lambda: cross.http.get("/quality").json()["series"]["revision"])  # nothing changes any more
    reply = cross.answer("quality")
    assert str(reply.key_expr) == "ogm/v1/hall/quality"
    assert (str(reply.encoding), reply.attachment) == ("application/json", None)
    assert reply.payload.to_bytes() == cross.http.get("/quality").content


def test_status(cross):
    ours, theirs = json.loads(cross.answer("status").payload.to_bytes()), cross.status()
    assert 0 < ours.pop("uptime_s") < theirs.pop("uptime_s")
    assert 0 < ours["robots"]["r"].pop("age_s") < theirs["robots"]["r"].pop("age_s")
    assert ours == theirs


@pytest.mark.parametrize(
    ("key", "parameters", "status", "kind", "named"),
    [
        ("map", "format=gif", 404, "not-found", "format"),
        ("map", "format=", 404, "not-found", "format"),
        ("map", "no=1", 400, "bad-parameter", "no"),
        ("map", "format=png;values=trinary", 400, "bad-parameter", "values"),
        ("map", "format=png;palette=red", 400, "bad-parameter", "palette"),
        ("map", "region=1,1,0,0", 400, "bad-parameter", "region"),
        ("map", "region=90,90,91,91", 400, "bad-parameter", "region"),
        ("map", "region=0,0,1,1;region=0,0,2,2", 400, "bad-parameter", "region"),
        ("map", "format=png;format=png", 400, "bad-parameter", "format"),
        ("map", "format=png&region=0,0,1,1", 404, "not-found", "png&region"),
        ("cell", "", 400, "bad-parameter", "x"),
        ("cell", "x=1;y=nan", 400, "bad-parameter", "nan"),
        ("quality", "x=1", 400, "bad-parameter", "x"),
        ("status", "format=json", 400, "bad-parameter", "format"),
        ("reset", "map=hall", 400, "bad-parameter", "map"),
    ],
)
def test_a_query_that_fails_is_told_why(cross, key, parameters, status, kind, named):
    problem = cross.problem(key, parameters)
    assert (problem["status"], problem["type"]) == (status, kind)
    assert named in problem["detail"]
    assert set(problem) == {"type", "title", "status", "detail"}
    assert cross.status()["revision"] == 3


@pytest.mark.parametrize("pattern", ["ogm/v1/hall/*", "ogm/v1/*/*", "ogm/v1/hall/**", "ogm/**"])
def test_a_wildcard_is_answered_on_concrete_keys_and_resets_nothing(cross, pattern):
    before = cross.status()["epoch"]
    replies = list(cross.session.get(pattern, timeout=30.0))
    answers = {str(reply.ok.key_expr): reply.ok for reply in replies if reply.ok is not None}
    mine = {key for key in answers if key.startswith("ogm/v1/hall/alive/mapper/")}
    assert len(mine) == ("**" in pattern)
    whole = {f"ogm/v1/hall/{name}" for name in ("map", "quality", "status")}
    assert set(answers) - mine == whole
    assert answers["ogm/v1/hall/map"].payload.to_bytes() == cross.http.get("/map.json").content
    # `cell` and `raycast` lack coordinates, `check` its body, `distance` and `inflate` a format; there are no
    # `snapshots`; the others are writes.
    refused = [reply for reply in replies if reply.ok is None]
    assert sorted(told(reply) for reply in refused) == ["bad-parameter"] * (5 + len(WRITES)) + ["not-stored"]
    texts = "".join(reply.err.payload.to_string() for reply in refused)
    assert all(texts.count(f"ask for exactly ogm/v1/hall/{write}") == 1 for write in WRITES)
    assert (cross.status()["epoch"], cross.status()["revision"]) == (before, 3)


@pytest.mark.parametrize("pattern", ["reset/**", "rese$*", "**/reset"])
def test_any_other_get_that_matches_reset_is_refused(cross, pattern):
    (reply,) = cross.ask(pattern)
    assert told(reply) == "bad-parameter"
    assert cross.status()["revision"] == 3


def test_reset(mapper):
    before = mapper.draw_cross()
    reply = mapper.answer("reset")
    assert str(reply.key_expr) == "ogm/v1/hall/reset"
    after = json.loads(reply.payload.to_bytes())
    assert after["epoch"] not in ("", before["epoch"])
    assert (after["revision"], after["stamp"], after["scans"]) == (0, None, before["scans"])
    assert mapper.status()["epoch"] == after["epoch"]
    assert mapper.draw_cross(revision=3)["revision"] == 3


def test_a_reset_comes_after_every_message_that_was_put_before_it(mapper):
    for seq in range(200):
        mapper.scan([1.0], pose=[0, 0, 0], run="a", seq=seq)
    after = json.loads(mapper.answer("reset").payload.to_bytes())
    assert (after["revision"], after["scans"]["integrated"], after["scans"]["pending"]) == (0, 200, 0)


def test_keys_that_are_neither_pose_nor_scan_and_deletes_are_ignored(mapper, fields):
    pose = msgpack.packb(fields.pose())
    keys = [
        "r",
        "r/odometry",
        "r/pose/x",
        "r/scan",
        "r/scan/s/t",
        "r/SCAN/s",
        "r:2/pose",
        "r/scan/a b",
        "x" * 65 + "/pose",
    ]
    for key in keys:
        mapper.put(f"robots/{key}", pose)
    mapper.session.delete(mapper.keys.pose("r"))
    mapper.session.delete(mapper.keys.scan("r", "s"))
    mapper.scan([1.0], pose=[0, 0, 0], robot="x" * 64, sensor="A-z_0.9")
    status = mapper.settle(received=1)
    assert status["other"] == {"ignored": len(keys) + 2}
    assert status["poses"]["received"] == 0
    assert set(status["robots"]) == {"x" * 64}


def test_what_is_put_elsewhere_is_not_heard(mapper, fields):
    for root in ("ogm/v1/other", "ogm/v2/hall", "ogm/v1/hall/hall"):
        mapper.session.put(f"{root}/robots/r/pose", msgpack.packb(fields.pose()))
    mapper.put("map", b"")
    mapper.scan([1.0], pose=[0, 0, 0])
    status = mapper.settle(received=1)
    assert (status["poses"]["received"], status["other"]) == (0, {"ignored": 0})


def test_a_running_mapper_is_alive_and_a_stopped_one_is_not(start_mapper, listener, endpoint, eventually):
    meet = {"connect": [endpoint], "listen": []}
    tokens = []
    for _ in range(2):
        with start_mapper(network=meet) as mapper:
            (token,) = alive(listener)
            assert re.fullmatch(r"ogm/v1/hall/alive/mapper/[\w.-]{1,64}/[0-9a-f]{32}", token)
            assert token.rpartition("/")[2] == mapper.status()["run"]
            tokens.append(token.rsplit("/", 1))
        eventually(lambda: alive(listener) == set())
    (first, run), (second, other_run) = tokens
    assert first == second  # the id outlives a restart, the run does not
    assert run != other_run


def test_a_second_mapper_of_the_same_map_is_refused(mapper, start_mapper, eventually):
    mapper.draw_cross()
    beside = {"connect": [mapper.endpoint], "listen": []}
    (token,) = alive(mapper.session)
    with pytest.raises(AlreadyMapped, match="another mapper of map 'hall' is alive") as error:
        start_mapper(network=beside).__enter__()
    assert token in str(error.value)
    assert "--map" in str(error.value)
    eventually(lambda: alive(mapper.session) == {token})
    assert mapper.draw_cross(revision=3)["revision"] == 6


def test_mappers_of_other_maps_live_side_by_side(mapper, start_mapper):
    mapper.draw_cross()
    beside = {"connect": [mapper.endpoint], "listen": [], "map_name": "hall2"}
    with start_mapper(network=beside) as other:
        other.scan([1.0], pose=[0, 0, 0])
        assert other.settle(received=1)["map"] == "hall2"
        assert len(alive(mapper.session)) == 2
        assert len(alive(mapper.session, "ogm/v1/hall/alive/mapper/*/*")) == 1
        keys = {str(r.ok.key_expr) for r in mapper.session.get("ogm/v1/*/status", timeout=30.0)}
        assert keys == {"ogm/v1/hall/status", "ogm/v1/hall2/status"}
    assert mapper.settle(received=3)["revision"] == 3


@pytest.mark.parametrize(
    ("parameters", "besides", "named"),
    [
        (";".join(f"a{n}" for n in range(1_000_000)), {}, "parameters: at most 4096 characters"),
        ("a" * 4097, {}, "parameters: at most 4096 characters"),
        ("", {"payload": bytes(1025)}, "payload: at most 1024 bytes"),
        ("", {"attachment": bytes(1025)}, "attachment: at most 1024 bytes"),
    ],
)
def test_a_query_longer_than_any_of_use_takes_no_turn(cross, monkeypatch, parameters, besides, named):
    def take(*_):
        raise AssertionError("it has a turn")

    monkeypatch.setattr(Turns, "take", take)
    (reply,) = cross.ask("status", parameters, **besides)
    problem = json.loads(reply.err.payload.to_bytes())
    assert (problem["status"], problem["type"]) == (400, "bad-parameter")
    assert problem["detail"].startswith(named)


def test_a_query_as_long_as_is_read_is_answered(cross):
    (reply,) = cross.ask("status", "t=" + "a" * 4094, payload=bytes(1024), attachment=bytes(1024))
    assert json.loads(reply.ok.payload.to_bytes())["map"] == "hall"


LONG = "a" * 2000


@pytest.mark.parametrize(
    ("key", "given"),
    [
        *(("map", f"format={form}") for form in (LONG, f"png;palette={LONG}", f"png;max_size={LONG}")),
        *(("map", f"{name}={LONG}") for name in ("region", "values", LONG)),
        ("map", f"region={LONG},1,1,1"),
        *(("cell", f"{x}={LONG};{y}=1") for x, y in ("xy", "yx")),
        *((name, f"{LONG}=1") for name in ("status", "quality", "reset")),
        ("status", f"{LONG[:1500]};{LONG[:1500]}"),
    ],
)
def test_an_error_repeats_little_of_what_was_given(cross, key, given):
    over_zenoh = cross.problem(key, given)["detail"]
    assert "a" * 100 + "..." in over_zenoh
    assert len(over_zenoh) < 250


@pytest.mark.parametrize(
    "path",
    [
        *(f"/map.png?{name}={LONG}" for name in ("region", "palette", "max_size", LONG)),
        f"/map.json?values={LONG}",
        f"/cell?x={LONG}&y=1",
        f"/status?{LONG}=1&{LONG}=1",
    ],
)
def test_so_do_errors_over_http(cross, path):
    detail = cross.http.get(path).json()["detail"]
    assert "a" * 100 + "..." in detail
    assert len(detail) < 250


def test_queryables_do_not_claim_to_be_complete(cross):
    replies = list(
        cross.session.get("ogm/v1/hall/status", target=zenoh.QueryTarget.ALL_COMPLETE, timeout=30.0)
    )
    assert replies == []


def test_bugs_are_logged_and_told_without_their_innards(mapper, monkeypatch, caplog):
    def fail(_):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(mapper.service.live_map, "quality", fail)
    problem = mapper.problem("quality")
    assert (problem["status"], problem["type"]) == (500, "internal")
    assert "bug" not in problem["detail"]
    assert mapper.answer("status")
    (record,) = caplog.records
    assert record.exc_info[0] is ZeroDivisionError
    caplog.clear()
