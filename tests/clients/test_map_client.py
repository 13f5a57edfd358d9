"""Asking a mapper: the same questions and answers over Zenoh and HTTP."""

import json
import math
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from ogm_client import (
    BadReply,
    CannotConnect,
    ClientError,
    MapClient,
    MapperError,
    NobodyAnswered,
    SnapshotInfo,
)
from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import BadParameter, BadSetting
from status_json import STATUS

STEP = 8.0 / 16383
MAP_NAME = "hall"


def test_a_map_arrives_as_it_was_served(mapper, client):
    grid = client.get_map()
    expected = np.array([[np.nan, 10000], [-10001, 0], [-3001, 1000]]) * STEP
    np.testing.assert_array_equal(grid.log_odds, expected.astype(np.float32))
    assert grid.log_odds.dtype == np.float32
    assert (grid.resolution, grid.anchor, grid.offset) == (0.1, (0.5, -0.25), (-5, 10))
    assert (grid.epoch, grid.run, grid.revision, grid.stamp) == ("first", "one", 7, 1_700_000_000_000_000_001)
    assert mapper.asked == [("map.npz", {})]


def test_a_map_without_scans_has_no_stamp_and_no_cells(mapper, client):
    cells = np.empty((0, 0), np.int16)
    mapper.snapshot = replace(mapper.snapshot, stored=CellArrays.of(LogOdds(), cells), revision=0, stamp=None)
    grid = client.get_map()
    assert (grid.width, grid.height, grid.revision, grid.stamp) == (0, 0, 0, None)


@pytest.mark.parametrize("region", [(-1, -2.5, 3.0, 1e-7), np.array([-1, -2.5, 3, 1e-7])])
def test_a_region_is_asked_for_in_full_precision(mapper, client, region):
    client.get_map(region)
    [(name, parameters)] = mapper.asked
    assert name == "map.npz"
    assert [float(part) for part in parameters.pop("region").split(",")] == [-1.0, -2.5, 3.0, 1e-7]
    assert parameters == {}


@pytest.mark.parametrize("name", ["map.png", "map.json", "map.pgm", "map.yaml", "quality", "cell"])
def test_fetch_gives_the_bytes_and_passes_parameters_on(mapper, client, name):
    assert client.fetch(name, palette="probability", max_size=500, region=None) == f"{name} as asked".encode()
    assert mapper.asked == [(name, {"palette": "probability", "max_size": "500"})]


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("reset", {}, "'reset' cannot be fetched, only map.png, "),
        ("map.bmp", {}, "'map.bmp'"),
        ("map.png", {"palette": "ros;format=json"}, "palette: .*';'"),
        ("map.png", {"region": ["west"]}, "region: .* got \\['west'\\]"),
        ("map.png", {"max_size": object()}, "max_size: "),
    ],
)
def test_what_cannot_be_asked_is_refused_here(mapper, client, name, parameters, message):
    with pytest.raises(BadParameter, match=message):
        client.fetch(name, **parameters)
    assert mapper.asked == []


def test_figures_are_dictionaries(mapper, client):
    mapper.bodies["quality"] = b'{"known_m2": 3.5, "consistency": {"hits": 1.0}, "truth": null}'
    assert client.quality() == {"known_m2": 3.5, "consistency": {"hits": 1.0}, "truth": None}
    assert mapper.asked == [("quality", {})]


def test_the_status_has_types(mapper, client):
    status = client.status()
    assert status == replace(STATUS, epoch="first", run="one", revision=7)
    assert status.robots["r2"].sources["front"].dropped == {"no_pose": 5}
    assert mapper.asked == [("status", {})]


def test_a_map_of_another_name_is_refused(mapper):
    """Over HTTP an address has one map, and nothing else tells which one."""
    mapper.name = "cellar"
    asks = [
        MapClient.get_map,
        MapClient.status,
        MapClient.reset,
        lambda client: client.cell(0.0, 0.0),
        lambda client: next(client.watch()),
    ]
    name = "attic" if mapper.over == "zenoh" else MAP_NAME
    for ask in asks:
        with MapClient(mapper.address, map_name=name, timeout=30.0) as client:
            for _ in range(2):
                with pytest.raises(NobodyAnswered, match=f"{name}"):
                    ask(client)
    assert {name for name, _ in mapper.asked} <= {"status"}
    if mapper.over == "http":
        said = pytest.raises(NobodyAnswered, match="serves map 'cellar', and not 'hall'")
        with MapClient(mapper.address, map_name=MAP_NAME) as client, said:
            client.get_map()
        with MapClient(mapper.address) as client:
            assert client.get_map().revision == 7


def test_a_map_of_the_right_name_is_looked_at_once(http_mapper):
    with MapClient(http_mapper.address, map_name=MAP_NAME) as client:
        client.get_map()
        http_mapper.bodies["cell"] = b"{}"
        client.cell(0.0, 0.0)
        client.fetch("map.png")
    assert [name for name, _ in http_mapper.asked] == ["status", "map.npz", "cell", "map.png"]


def test_a_mapper_that_takes_the_place_of_another_is_looked_at(http_mapper):
    with MapClient(http_mapper.address, map_name=MAP_NAME) as client:
        client.get_map()
        http_mapper.snapshot = replace(http_mapper.snapshot, epoch="second")
        client.get_map()  # emptied: the same name
        for another in ({"epoch": "third"}, {"run": "two"}):
            http_mapper.name = MAP_NAME
            client.get_map()
            http_mapper.snapshot = replace(http_mapper.snapshot, **another)
            http_mapper.name = "cellar"
            with pytest.raises(NobodyAnswered, match="serves map 'cellar'"):
                client.get_map()


def test_a_bad_name_of_a_map_is_refused(mapper):
    with pytest.raises(BadSetting, match="map name 'a b'"):
        MapClient(mapper.address, map_name="a b")


def test_a_cell_is_asked_for_by_its_point(mapper, client):
    mapper.bodies["cell"] = b'{"known": false, "log_odds": null}'
    assert client.cell(0.1, np.float64(-2.0)) == {"known": False, "log_odds": None}
    assert mapper.asked == [("cell", {"x": "0.1", "y": "-2.0"})]


def test_reset_is_one_plain_request(mapper, client):
    client.reset()
    assert mapper.asked == [("reset", {})]


SNAPSHOT = {
    "name": "a.b",
    "epoch": "e",
    "run": "r",
    "revision": 7,
    "stamp": None,
    "saved": 10**18,
    "bytes": 4096,
}


def test_maps_are_saved_listed_restored_and_deleted_by_plain_requests(mapper, client):
    mapper.bodies["save"] = json.dumps({**SNAPSHOT, "damage": None}).encode()
    mapper.bodies["snapshots"] = json.dumps({"snapshots": [SNAPSHOT, {**SNAPSHOT, "damage": "cut"}]}).encode()
    assert client.save_snapshot("a.b") == SnapshotInfo(**SNAPSHOT)
    assert client.snapshots() == [SnapshotInfo(**SNAPSHOT), SnapshotInfo(**SNAPSHOT, damage="cut")]
    client.restore_snapshot("..")
    client.delete_snapshot("..")
    named = {"name": ".."}
    asked = [("save", {"name": "a.b"}), ("snapshots", {}), ("restore", named), ("delete", named)]
    assert mapper.asked == asked


def test_a_map_as_it_was_saved(mapper, client):
    grid = client.get_map(at="monday")
    assert (grid.epoch, grid.run, grid.revision) == ("first", "one", 7)
    client.get_map((0, 0, 1, 1), at="monday")
    client.fetch("map.png", at="monday")
    assert mapper.asked == [
        ("map.npz", {"at": "monday"}),
        ("map.npz", {"region": "0,0,1,1", "at": "monday"}),
        ("map.png", {"at": "monday"}),
    ]


@pytest.mark.parametrize("name", ["", "a/b", "../x", "a;b", "x" * 65, "a\n", None, 7])
def test_what_is_no_name_of_a_saved_map_is_not_asked(mapper, client, name):
    for ask in (client.save_snapshot, client.restore_snapshot, client.delete_snapshot):
        with pytest.raises(BadParameter, match="a name is 1 to 64 of A-Z"):
            ask(name)
    assert mapper.asked == []


@pytest.mark.parametrize(
    ("snapshots", "said"),
    [
        ([], "snapshots: snapshots: missing"),
        ({"snapshots": {}}, "snapshots: snapshots: "),
        ({"snapshots": [{**SNAPSHOT, "revision": "7"}]}, "revision: a whole number is needed"),
        ({"snapshots": [{**SNAPSHOT, "name": "\033[2J"}]}, "characters that cannot be shown"),
        ({"snapshots": [{**SNAPSHOT, "bytes": 2**64}]}, "bytes: a number below"),
    ],
)
def test_a_list_of_saved_maps_that_is_none_is_a_bad_reply(mapper, client, snapshots, said):
    mapper.bodies["snapshots"] = json.dumps(snapshots or {}).encode()
    with pytest.raises(BadReply, match=said):
        client.snapshots()


def test_a_refusal_is_raised_with_its_parts(mapper, client):
    mapper.problem = {
        "type": "bad-parameter",
        "title": "Bad parameter",
        "status": 400,
        "detail": "region: inverted",
    }
    asks = [
        client.get_map,
        client.status,
        client.reset,
        lambda: client.fetch("map.png"),
        lambda: client.cell(0, 0),
    ]
    for ask in asks:
        with pytest.raises(MapperError, match="region: inverted") as caught:
            ask()
        assert (caught.value.type, caught.value.status, caught.value.detail) == (
            "bad-parameter",
            400,
            "region: inverted",
        )
    assert len(mapper.asked) == len(asks)


@pytest.mark.parametrize("problem", [b"oops", b"[]", b'{"type": 3, "status": 400}'])
def test_an_error_that_is_no_problem_json_is_a_bad_reply(mapper, client, problem):
    mapper.problem = problem
    with pytest.raises(BadReply):
        client.status()


@pytest.mark.parametrize("body", [b"", b"not json", b"[1]", b"\xff"])
def test_a_status_that_is_no_object_is_a_bad_reply(mapper, client, body):
    mapper.bodies["status"] = body
    with pytest.raises(BadReply, match="status: "):
        client.status()


def test_a_map_that_cannot_be_read_is_a_bad_reply(mapper, client):
    mapper.bodies["map.npz"] = b"PK not really"
    with pytest.raises(BadReply, match=r"map\.npz"):
        client.get_map()


@pytest.mark.parametrize("name", ["epoch", "revision", "stamp"])
def test_a_map_without_its_version_is_a_bad_reply(mapper, client, name):
    mapper.meta[name] = ...
    if (mapper.over, name) == ("zenoh", "stamp"):
        mapper.meta[name] = 1.5  # over Zenoh, null and nothing are the same
    with pytest.raises(BadReply, match=name.capitalize() if mapper.over == "http" else name):
        client.get_map()


@pytest.mark.parametrize("change", [{"revision": 8}, {"epoch": "second"}, {"run": "two"}])
def test_watch_yields_at_once_and_on_each_change_only(mapper, client, change):
    mapper.later[4] = replace(mapper.snapshot, **change)
    maps = client.watch(interval=0.001)
    first, second = next(maps), next(maps)
    of_first = {"epoch": "first", "run": "one", "revision": 7}
    assert {name: getattr(first, name) for name in of_first} == of_first
    assert {name: getattr(second, name) for name in of_first} == of_first | change
    seen = {"since": "first-one-7"}
    assert mapper.asked[:5] == [("map.tiles", {}), *[("map.tiles", seen)] * 4]
    assert {name for name, _ in mapper.asked} == {"map.tiles"}
    maps.close()
    asked = len(mapper.asked)
    client.status()
    assert mapper.asked[asked:] == [("status", {})]


def test_watch_ends_with_the_mapper_s_refusal(mapper, client):
    maps = client.watch(interval=0.001)
    next(maps)
    mapper.problem = {"type": "internal", "status": 500, "title": "Internal error"}
    with pytest.raises(MapperError, match="Internal error"):
        next(maps)
    with pytest.raises(StopIteration):
        next(maps)


STARTING = {"type": "starting", "status": 503, "title": "Unavailable", "detail": "the mapper is starting"}


def test_watch_waits_for_a_mapper_that_starts(mapper, client):
    maps = client.watch(interval=0.001)
    first, mapper.problem = next(maps), STARTING
    with ThreadPoolExecutor(1) as pool:
        waiting, asked = pool.submit(next, maps), len(mapper.asked)
        eventually_more(mapper, asked + 3)
        mapper.snapshot, mapper.problem = replace(mapper.snapshot, run="two"), None
        second = waiting.result(timeout=30.0)
    assert (first.run, second.run) == ("one", "two")
    assert (first.epoch, first.revision) == (second.epoch, second.revision)


def eventually_more(mapper, count):
    deadline = time.monotonic() + 30.0
    while len(mapper.asked) < count:
        assert time.monotonic() < deadline
        time.sleep(0.001)


def test_watch_waits_as_long_as_its_patience(mapper, client):
    for patience, more in ((0.0, range(1, 60)), (0.05, range(2, 200))):
        mapper.problem = None
        maps = client.watch(interval=0.001, patience=patience)
        next(maps)
        mapper.problem, asked = STARTING, len(mapper.asked)
        with pytest.raises(MapperError, match="the mapper is starting"):
            next(maps)
        assert len(mapper.asked) - asked in more


@pytest.mark.parametrize("status", [502, 503, 504])
def test_a_proxy_without_a_mapper_is_nobody(http_mapper, status):
    http_mapper.problem, http_mapper.garbled = b"<h1>Bad gateway</h1>", status
    said = pytest.raises(NobodyAnswered, match=f"a proxy answered /map.npz with {status}")
    with MapClient(http_mapper.address) as client, said:
        client.get_map()


@pytest.mark.parametrize("patience", [-1.0, math.nan])
def test_watch_refuses_a_patience_that_is_none(client, patience):
    with pytest.raises(BadParameter, match="patience"):
        client.watch(patience=patience)


@pytest.mark.parametrize("interval", [0, -1.0, math.nan, math.inf])
def test_watch_refuses_an_interval_that_is_none(client, interval):
    with pytest.raises(BadParameter, match="interval"):
        client.watch(interval)


def test_a_closed_client_says_so(mapper, client):
    client.close()
    client.close()
    with pytest.raises(ClientError, match="closed"):
        client.status()
    assert mapper.asked == []


@pytest.mark.parametrize(
    "address", ["", "localhost", "127.0.0.1:8000", "ftp://localhost/", "http://host:port"]
)
def test_an_ill_formed_address_is_refused(address):
    with pytest.raises(BadSetting, match="address"):
        MapClient(address)


@pytest.mark.parametrize("timeout", [0.0, -1.0, math.nan, math.inf])
def test_a_timeout_that_is_none_is_refused(timeout):
    with pytest.raises(BadSetting, match="timeout: a positive number"):
        MapClient("http://127.0.0.1:9", timeout=timeout)


def test_the_format_is_in_the_name(mapper, client):
    with pytest.raises(BadParameter, match=r"the name says it, map\.png"):
        client.fetch("map.png", format="json")
    assert mapper.asked == []


def test_a_proxy_of_the_environment_is_not_asked(monkeypatch, endpoint):
    for name in ("http_proxy", "ALL_PROXY"):
        monkeypatch.setenv(name, "socks5://127.0.0.1:9")
    address = endpoint.removeprefix("tcp/")
    with MapClient(f"http://{address}") as client, pytest.raises(CannotConnect, match=address):
        client.status()


def test_no_mapper_of_that_map(zenoh_mapper):
    with MapClient(zenoh_mapper.address, map_name="other", timeout=60.0) as client:
        start = time.monotonic()
        with pytest.raises(NobodyAnswered) as caught:
            client.get_map()
        assert time.monotonic() - start < 20.0  # it does not wait for all of its time
    assert "'other'" in str(caught.value)
    assert zenoh_mapper.address in str(caught.value)
    assert "--map other" in str(caught.value)


def test_a_mapper_that_does_not_answer_over_zenoh(listener, endpoint, eventually):
    kept = []
    listener.declare_queryable("ogm/v1/default/status", kept.append)
    with MapClient(endpoint, timeout=0.2) as client, pytest.raises(NobodyAnswered, match=r"within 0\.2 s"):
        client.status()
    eventually(lambda: len(kept) == 1)
    kept.clear()


def test_a_mapper_that_does_not_answer_over_http():
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"http://127.0.0.1:{server.getsockname()[1]}"
        with MapClient(url, timeout=0.2) as client, pytest.raises(NobodyAnswered, match=r"within 0\.2 s"):
            client.status()


@pytest.mark.parametrize(("end", "error"), [(b"", NobodyAnswered), (b"\r\n", BadReply)])
def test_something_else_than_http_answers(end, error):
    """Half an answer may be a mapper's that has just ended; a whole one that is none is not."""

    def greet(server):
        connection, _ = server.accept()
        with connection:
            connection.recv(4096)
            connection.sendall(b"SSH-2.0-other\r\n" + end)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=greet, args=(server,))
        thread.start()
        url = f"http://127.0.0.1:{server.getsockname()[1]}"
        with MapClient(url, timeout=30.0) as client, pytest.raises(error, match=url):
            client.status()
        thread.join()


def test_nothing_at_an_http_address(endpoint):
    url = endpoint.replace("tcp/", "http://")
    with MapClient(url) as client, pytest.raises(CannotConnect, match=f"{url}.*ogm mapper"):
        client.status()


def test_a_session_that_was_given_stays_open(listener, zenoh_mapper):
    with MapClient(map_name="hall", session=listener) as client:
        assert client.get_map().revision == 7
    with MapClient(map_name="hall", session=listener) as client:
        assert client.status().revision == 7
    assert not listener.is_closed()


def test_a_field_of_the_status_that_we_do_not_know_is_fetched(mapper, client):
    status = {"epoch": "first", "revision": 7, "later": {"added": [1, 2]}}
    mapper.bodies["status"] = json.dumps(status).encode()
    assert json.loads(client.fetch("status")) == status
