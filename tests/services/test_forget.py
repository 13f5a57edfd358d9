"""A robot that is left out of a running mapper's map, over HTTP, Zenoh, by a client and by a command."""

import io
import json
import math
import shutil

import httpx
import numpy as np
import pytest
from typer.testing import CliRunner

from ogm_client import BadParameter, MapClient, MapperError
from ogm_services.cli import app
from ogm_services.mapper.storage.map_store import MapStore

COUNTS = {"resolution": 0.5, "cell_model": "rate"}
TOKEN = "0123456789abcdef" * 2
PLACES = {"a": (0.25, 0.25), "b.1": (1.25, 0.75), "c": (-9.75, 4.25)}
"""Where the robots stand; the second one has a name that looks like a file's."""


class OverHttp:
    def __init__(self, mapper):
        self.mapper = mapper

    def forget(self, robot):
        """What is answered, and 200, or what is refused and its code."""
        response = self.mapper.http.delete(f"/robots/{robot}")
        assert response.headers["cache-control"] == "no-store"
        return response.json(), response.status_code


class OverZenoh:
    def __init__(self, mapper):
        self.mapper = mapper

    def forget(self, robot):
        (reply,) = self.mapper.ask("forget", f"robot={robot}")
        if reply.ok is not None:
            assert str(reply.ok.key_expr) == "ogm/v1/hall/forget"
            return json.loads(reply.ok.payload.to_bytes()), 200
        problem = json.loads(reply.err.payload.to_bytes())
        return problem, problem["status"]


OVER = pytest.mark.parametrize("over", [OverHttp, OverZenoh])


def look_around(mapper, *robots, received=0, seq=0):
    """Two scans of each robot from its place, of walls of its own; wait until they have come."""
    for turn in (seq, seq + 1):
        for robot in robots:
            x, y = PLACES[robot]
            ranges = [1.0 + 0.25 * ((ord(robot[0]) + beam + turn) % 7) for beam in range(24)]
            place = {"pose": [x, y, 0.1 * turn], "angle_increment": math.tau / 28, "range_max": 4.0}
            mapper.scan(ranges + [math.inf] * 4, robot=robot, run="run", seq=turn, at=turn, **place)
    return mapper.settle(received=received + 2 * len(robots))


@pytest.fixture
def start(start_mapper, no_errors):
    """`start(**mapper_settings)`: a mapper that keeps robots apart, until the test ends."""
    return lambda http=None, **settings: start_mapper(
        map=COUNTS, mapper={"separate_robots": True, **settings}, http=http or {}
    )


@pytest.fixture
def apart(start):
    """A mapper that keeps three robots apart."""
    with start() as mapper:
        look_around(mapper, *PLACES)
        yield mapper


def served(mapper):
    """What every route of the map answers, but for the map's identity."""
    bodies = {}
    for path in ("map.png", "map.png?palette=cividis&transparent=1", "map.pgm", "map.npz", "map.yaml"):
        bodies[path] = mapper.http.get(f"/{path}").raise_for_status().content
    bodies["map.yaml"] = [line for line in bodies["map.yaml"].splitlines() if b"crc32" not in line]
    for path in ("map.json", "map.json?resolution=coarse&values=trinary", "cell?x=1.1&y=0.6"):
        told = mapper.http.get(f"/{path}").raise_for_status().json()
        bodies[path] = {k: v for k, v in told.items() if k not in ("epoch", "run", "revision", "stamp")}
    for z, x, y in ((16, 0, 0), (16, -1, -1), (16, 0, -1), (14, 0, -1), (13, -1, -1)):
        bodies[z, x, y] = mapper.http.get(f"/tiles/{z}/{x}/{y}.png").content
    return bodies


@OVER
@pytest.mark.parametrize("gone", PLACES)
def test_the_map_is_that_of_the_other_robots_byte_for_byte(apart, start, over, gone):
    then = apart.status()
    assert then["map_info"]["robots"] == sorted(PLACES)
    answer, code = over(apart).forget(gone)
    others = sorted(PLACES.keys() - {gone})
    identity = {"epoch": then["epoch"], "run": then["run"], "revision": 7}
    assert (answer, code) == ({**identity, "robots": others}, 200)
    after = apart.status()
    assert {name: after[name] for name in identity} == identity
    assert (after["stamp"], after["scans"], list(after["robots"])) == (
        then["stamp"],
        then["scans"],
        list(then["robots"]),
    )
    assert after["map_info"]["robots"] == others
    with start() as mapper:
        look_around(mapper, *reversed(others))
        assert served(apart) == served(mapper)


def test_who_follows_the_map_gets_it_too(apart, eventually):
    with MapClient(apart.endpoint, map_name="hall", timeout=30.0) as client, client.follow() as follower:
        eventually(lambda: follower.grid().revision == 6)
        OverHttp(apart).forget("a")
        eventually(lambda: follower.grid().revision == 7)
        with np.load(io.BytesIO(apart.http.get("/map.npz").content)) as whole:
            np.testing.assert_array_equal(follower.grid().log_odds, whole["log_odds"])


@OVER
def test_seqs_that_were_decided_stay_decided_and_new_scans_are_a_new_robots(apart, over):
    over(apart).forget("a")
    less = served(apart)
    scans = look_around(apart, "a", received=6)["scans"]  # as its cache would send them again
    assert scans["dropped"]["duplicate"] == 2
    assert served(apart) == less
    scans = look_around(apart, "a", received=8, seq=2)["scans"]
    assert scans["integrated"] == 8
    status = apart.status()
    assert (status["revision"], status["map_info"]["robots"]) == (9, sorted(PLACES))


def test_it_comes_after_every_message_that_was_put_before_it(start):
    with start() as mapper:
        for seq in range(100):
            mapper.scan([1.0], pose=[0, 0, 0], run="x", seq=seq)
        assert json.loads(mapper.answer("forget", "robot=r").payload.to_bytes())["revision"] == 101
        assert mapper.http.get("/map.png").status_code == 404


@OVER
def test_it_is_on_the_disk_when_that_is_answered(start, over, tmp_path):
    """Whatever ends the mapper then: a store of this moment's files is the map without the robot."""
    with start(data=str(tmp_path / "data")) as mapper:
        look_around(mapper, *PLACES)
        for k, robot in enumerate(("b.1", "a")):
            answer, _ = over(mapper).forget(robot)
            shutil.copytree(tmp_path / "data", tmp_path / f"crashed{k}")
            with MapStore(tmp_path / f"crashed{k}") as store:
                found = store.restore(mapper.service.parts.grid_settings).grid
            assert (found.epoch, found.revision) == (answer["epoch"], 7 + k)
            assert list(found.robots) == answer["robots"]
            expected = mapper.service.live_map.snapshot()
            planes = found.snapshot().stored.planes()
            for name, cells in expected.stored.planes().items():
                assert cells.tobytes() == planes[name].tobytes()


def test_a_restored_snapshot_brings_a_robot_back(start, tmp_path):
    with start(data=str(tmp_path / "data")) as mapper:
        look_around(mapper, *PLACES)
        before = served(mapper)
        mapper.http.post("/save?name=all").raise_for_status()
        mapper.http.delete("/robots/a").raise_for_status()
        assert mapper.http.get("/map.npz?at=all").content == before["map.npz"]
        mapper.http.post("/restore?name=all").raise_for_status()
        assert served(mapper) == before
        assert mapper.http.delete("/robots/c").json()["robots"] == ["a", "b.1"]


@OVER
def test_a_robot_that_is_not_in_the_map_is_refused_with_the_names_of_those_that_are(apart, over):
    problem, code = over(apart).forget("d")
    assert (code, problem["type"]) == (404, "unknown-robot")
    assert problem["detail"] == "robot d: it is not in the map; there are: a, b.1, c"
    over(apart).forget("a")
    assert over(apart).forget("a")[1] == 404
    for name in ("x" * 65, "a*"):
        problem, code = over(apart).forget(name)
        assert (code, problem["type"]) == (400, "bad-parameter")
        assert problem["detail"].startswith("robot: a name of 1 to 64 of A-Z a-z 0-9 _ - . is needed, got '")
    assert apart.status()["revision"] == 7


@OVER
@pytest.mark.parametrize("model", ["rate", "log_odds"])
def test_a_map_that_does_not_keep_robots_apart_says_which_setting_does(start_mapper, over, model):
    with start_mapper(map={"cell_model": model}) as mapper:
        mapper.scan([1.0], pose=[0, 0, 0])
        assert "robots" not in mapper.settle(received=1)["map_info"]
        problem, code = over(mapper).forget("r")
        assert (code, problem["type"]) == (409, "not-separate")
        assert "--separate-robots (mapper.separate_robots)" in problem["detail"]
        assert mapper.status()["revision"] == 1


@pytest.mark.parametrize("way", ["http", "zenoh"])
def test_a_client_leaves_a_robot_out(apart, way):
    address = str(apart.http.base_url) if way == "http" else apart.endpoint
    with MapClient(address, map_name="hall", timeout=30.0) as client:
        assert client.status().map_info.robots == ["a", "b.1", "c"]
        assert client.forget("b.1") == ["a", "c"]
        assert client.status().map_info.robots == ["a", "c"]
        with pytest.raises(MapperError) as refused:
            client.forget("b.1")
        assert (refused.value.type, refused.value.status) == ("unknown-robot", 404)
        for name in ("", "a/b", "..%2f", 7):
            with pytest.raises(BadParameter, match=r"robot .*: a name is 1 to 64 of"):
                client.forget(name)


def test_a_page_that_may_write_hears_of_it_where_robots_are_kept_apart(apart, mapper):
    assert "forget" in apart.http.get("/login").json()["writes"]
    assert "forget" not in mapper.http.get("/login").json()["writes"]


def test_the_command_says_who_is_left_and_what_is_refused(start, tmp_path):
    token = tmp_path / "token"
    token.write_text(TOKEN)
    with start(http={"token_file": str(token)}) as mapper:
        look_around(mapper, *PLACES)
        over_http = "--url", str(mapper.http.base_url), "--token-file", str(token)
        over_zenoh = "--url", mapper.endpoint, "--map", "hall"

        def ogm(*given):
            return CliRunner().invoke(app, ["forget", *given], prog_name="ogm")

        result = ogm("a", "--url", str(mapper.http.base_url))
        assert (result.exit_code, "token" in result.stderr) == (1, True)
        result = ogm("b.1", *over_http)
        assert (result.exit_code, result.stdout) == (0, "b.1 is left out of the map; still in it: a, c\n")
        shown = CliRunner().invoke(app, ["status", "--url", str(mapper.http.base_url)], prog_name="ogm")
        assert "robots in it a, c" in " ".join(shown.stdout.split())
        result = ogm("a", "--json", *over_zenoh)
        assert (result.exit_code, json.loads(result.stdout)) == (0, {"robots": ["c"]})
        result = ogm("a", *over_zenoh)
        assert result.exit_code == 1
        assert "robot a: it is not in the map; there are: c" in result.stderr
        assert len(result.stderr.splitlines()) == 1
        assert ogm("c", *over_zenoh).stdout == "c is left out of the map; still in it: nobody\n"
        foreign = httpx.delete(
            f"{mapper.http.base_url}/robots/a",
            headers={"Authorization": f"Bearer {TOKEN}", "Sec-Fetch-Site": "cross-site"},
        )
        assert foreign.status_code == 403


@OVER
def test_the_log_says_who_has_left_whom_out(apart, over, caplog):
    caplog.set_level("INFO")
    over(apart).forget("c")
    (said,) = [text for text in caplog.messages if " left " in text]
    who = "127.0.0.1 over HTTP" if over is OverHttp else "somebody over Zenoh"
    assert said == f"{who} has left robot c out of the map: revision 7"
