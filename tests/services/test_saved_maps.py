"""Maps that are saved under names, over HTTP and Zenoh alike: saved, listed, looked at, restored, deleted."""

import io
import json
import math
import re
import shutil
import threading
import tracemalloc
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from types import SimpleNamespace

import msgpack
import numpy as np
import pytest
from PIL import Image

from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.types import Pose, Scan
from ogm_services.mapper.serving import large_answers as large_module
from ogm_services.mapper.serving.answer_memory import AnswerMemory
from ogm_services.mapper.serving.map_formats import MAP_FORMATS, map_format
from ogm_services.mapper.serving.saved_maps import SavedMaps
from ogm_services.mapper.storage.map_store import MapStore
from ogm_services.mapper.storage.snapshots import SavedMap
from ogm_services.replies.answer import Busy
from ogm_services.replies.in_flight import InFlight
from stored_maps import Story, fingerprint

IDENTITY = ("epoch", "run", "revision", "stamp")
ROUTES = {
    "snapshots": ("GET", "/snapshots"),
    "save": ("POST", "/save"),
    "restore": ("POST", "/restore"),
    "delete": ("DELETE", "/snapshots/"),
}


@dataclass
class Refused:
    """What an error reply says, whichever way it came."""

    type: str
    status: int
    detail: str
    title: str = ""


class OverHttp:
    """Asks over HTTP; what is refused is a `Refused`."""

    def __init__(self, mapper):
        self.mapper = mapper

    def ask(self, what, **given):
        method, path = ROUTES[what]
        if path.endswith("/"):
            path += given.pop("name").replace(".", "%2E")
        response = self.mapper.http.request(method, path, params=given)
        body = response.json()
        assert response.headers["cache-control"] == "no-store"
        return body if response.is_success else Refused(**body)

    def map(self, form="npz", **given):
        """The bytes of a map, and its identity."""
        as_it_is = {"Accept-Encoding": "identity"}  # else the validator says how it is packed
        response = self.mapper.http.get(f"/map.{form}", params=given, headers=as_it_is)
        if not response.is_success:
            return Refused(**response.json())
        told = [response.headers[f"ogm-{name}"] for name in IDENTITY]
        assert response.headers["etag"] == f'"{told[0]}-{told[1]}-{told[2]}"'
        return response.content, (*told[:2], *map(json.loads, told[2:]))


class OverZenoh:
    """The same over Zenoh."""

    def __init__(self, mapper):
        self.mapper = mapper

    def _get(self, key, given):
        (reply,) = self.mapper.ask(key, ";".join(f"{name}={value}" for name, value in given.items()))
        return reply

    def ask(self, what, **given):
        reply = self._get(what, given)
        if reply.ok is None:
            return Refused(**json.loads(reply.err.payload.to_bytes()))
        assert str(reply.ok.key_expr) == f"ogm/v1/hall/{what}"
        return json.loads(reply.ok.payload.to_bytes())

    def map(self, form="npz", **given):
        reply = self._get("map", {"format": form, **given})
        if reply.ok is None:
            return Refused(**json.loads(reply.err.payload.to_bytes()))
        meta = msgpack.unpackb(reply.ok.attachment.to_bytes())
        return reply.ok.payload.to_bytes(), tuple(meta[name] for name in IDENTITY)


OVER = pytest.mark.parametrize("over", [OverHttp, OverZenoh])


@pytest.fixture
def keeping(start_mapper, no_errors, tmp_path):
    """A mapper of cells of 0.5 m that stores its map, with the cross in it."""
    sections = {"map": {"resolution": 0.5}, "mapper": {"data": str(tmp_path / "data"), "pose_wait": 60.0}}
    with start_mapper(**sections) as mapper:
        mapper.draw_cross()
        yield mapper


def pixels(png):
    """They may be packed in two ways, as they are kept up to date or made anew."""
    return np.asarray(Image.open(io.BytesIO(png))).tolist()


def log_odds(npz):
    with np.load(io.BytesIO(npz)) as arrays:
        return arrays["log_odds"]


@OVER
def test_a_map_is_saved_looked_at_and_restored(keeping, over):
    asks = over(keeping)
    then = asks.map()
    saved = asks.ask("save", name="before.lunch")
    assert (saved["name"], saved["damage"]) == ("before.lunch", None)
    assert tuple(saved[name] for name in IDENTITY) == then[1]
    assert saved["revision"] == 3
    keeping.draw_cross(revision=3)
    assert asks.map()[1][2] == 6

    assert asks.map(at="before.lunch") == then
    assert asks.ask("snapshots") == {"snapshots": [saved]}
    status = asks.ask("restore", name="before.lunch")
    assert status["epoch"] not in ("", then[1][0])
    assert (status["run"], status["revision"], status["stamp"]) == then[1][1:]
    assert (status["scans"]["received"], status["scans"]["integrated"]) == (6, 6)
    restored = asks.map()
    assert restored == (then[0], (status["epoch"], *then[1][1:]))
    assert keeping.status()["map_info"]["known_cells"] == np.isfinite(log_odds(then[0])).sum()
    quality = keeping.http.get("/quality").json()
    assert (quality["scans"], quality["judged"]["scans"]) == (3, 0)

    keeping.scan([1.0], pose=[0.25, 0.25, 0.0], at=7)
    assert keeping.settle(received=7)["revision"] == 4
    assert asks.map(at="before.lunch") == then
    assert asks.ask("delete", name="before.lunch") == {"snapshots": []}
    assert asks.map(at="before.lunch").type == "unknown-snapshot"
    assert asks.map()[1][2] == 4


@OVER
def test_every_format_shows_a_saved_map_as_it_showed_the_map_then(keeping, over):
    asks, parts = over(keeping), ({}, {"region": "-1,-1,1,1"})
    then = {(form, k): asks.map(form, **part) for form in MAP_FORMATS for k, part in enumerate(parts)}
    asks.ask("save", name="a")
    keeping.draw_cross(revision=3)
    keeping.scan([1.0], pose=[9.25, 9.25, 0.0], at=9)
    keeping.settle(received=7)
    for (form, k), before in then.items():
        now = asks.map(form, at="a", **parts[k])
        alike = (pixels(now[0]), now[1]) == (pixels(before[0]), before[1]) if form == "png" else now == before
        assert alike, (form, k)
        assert asks.map(form, **parts[k]) != before


def test_validators_are_those_of_the_saved_map(keeping):
    keeping.http.post("/save?name=a").raise_for_status()
    etag = keeping.http.get("/map.png?at=a").headers["etag"]
    keeping.draw_cross(revision=3)
    assert keeping.http.get("/map.png?at=a", headers={"If-None-Match": etag}).status_code == 304
    assert keeping.http.get("/map.png", headers={"If-None-Match": etag}).status_code == 200
    assert keeping.http.get("/map.pgm?at=a", headers={"If-Match": etag}).status_code == 200
    assert keeping.http.get("/map.pgm", headers={"If-Match": etag}).status_code == 412


def test_a_map_that_is_deleted_is_not_sent_again(keeping):
    """Though it is the live one's twin, which is kept ready."""
    keeping.http.post("/save?name=a").raise_for_status()
    for _ in range(3):
        for query in ("", "?at=a"):
            assert keeping.http.get(f"/map.png{query}").status_code == 200
    keeping.http.delete("/snapshots/a").raise_for_status()
    assert keeping.http.get("/map.png?at=a").status_code == 404
    assert keeping.http.get("/map.png").status_code == 200


@OVER
def test_what_cannot_be_done_is_told_and_changes_nothing(keeping, over):
    asks = over(keeping)
    asks.ask("save", name="a")
    before = asks.map(), asks.ask("snapshots")
    named, all_three = ("restore", "delete"), ("save", "restore", "delete")
    unknown = 404, "unknown-snapshot", "^name b: there is no such snapshot; there are: a$"
    refusals = [
        *((asks.ask(what, name="b"), *unknown) for what in named),
        (asks.map(at="b"), *unknown),
        (asks.ask("save", name="a"), 409, "name-taken", "^name a: there is a snapshot of this name"),
        *((asks.ask(what, name="a b"), 400, "bad-parameter", "A-Z a-z 0-9") for what in all_three),
        (asks.map(at="a b"), 400, "bad-parameter", "A-Z a-z 0-9"),
        *((asks.ask(what), 400, "bad-parameter", "^name: missing") for what in ("save", "restore")),
        *((asks.ask(what, name="c", x=1), 400, "bad-parameter", "^x: unknown") for what in all_three),
        (asks.ask("snapshots", name="a"), 400, "bad-parameter", "^name: unknown"),
        (asks.map(at="a", region="1,1,0,0"), 400, "bad-parameter", "region"),
        (asks.map(at="a", palette="ros"), 400, "bad-parameter", "^palette: unknown"),
        (asks.map("png", at="a", max_size="0"), 400, "bad-parameter", "^max_size"),
    ]
    for refused, status, kind, text in refusals:
        assert (refused.status, refused.type) == (status, kind), refused
        assert re.search(text, refused.detail), refused
    assert (asks.map(), asks.ask("snapshots")) == before


@OVER
@pytest.mark.parametrize("name", [".", "..", "-x", "x" * 64])
def test_names_that_look_odd_are_names(keeping, over, name):
    asks = over(keeping)
    assert asks.ask("save", name=name)["name"] == name
    assert asks.map(at=name) == asks.map()
    assert asks.ask("restore", name=name)["revision"] == 3
    assert asks.ask("delete", name=name) == {"snapshots": []}


@OVER
def test_a_mapper_that_stores_no_map_says_so(cross, over):
    asks = over(cross)
    answers = [asks.ask("snapshots"), asks.map(at="a")]
    answers += [asks.ask(write, name="a") for write in ("save", "restore", "delete")]
    for refused in answers:
        assert (refused.status, refused.type) == (503, "not-stored")
        assert "--data DIR" in refused.detail
    assert "retry-after" not in cross.http.get("/snapshots").headers


@OVER
def test_a_damaged_snapshot_is_listed_and_refused(keeping, over, tmp_path):
    asks = over(keeping)
    asks.ask("save", name="a")
    asks.ask("save", name="b")
    file = tmp_path / "data" / "snapshots" / "b.sqlite"
    file.write_bytes(file.read_bytes()[:5000])
    before = asks.map()
    for refused in (asks.map(at="b"), asks.ask("restore", name="b")):
        assert (refused.status, refused.type) == (500, "bad-store")
        assert "b.sqlite is damaged" in refused.detail
    assert asks.map() == before
    good, bad = asks.ask("snapshots")["snapshots"]
    assert (good["name"], good["damage"], good["revision"]) == ("a", None, 3)
    assert (bad["name"], bad["epoch"]) == ("b", "")
    assert "is damaged" in bad["damage"]
    assert [left["name"] for left in asks.ask("delete", name="b")["snapshots"]] == ["a"]


def test_a_map_on_another_lattice_is_looked_at_and_not_restored(keeping, tmp_path):
    """As where it began with another start map; this one's store would be wrong with it."""
    settings = keeping.service.parts.grid_settings
    with MapStore(tmp_path / "other") as store:
        story = Story(store, OccupancyGrid(GridSettings(resolution=0.5, anchor=(0.25, 0.0)), "e"))
        assert story.grid.lattice != settings.lattice
        story.integrate(2)
        story.commit()
        store.save("moved")
    shutil.copytree(tmp_path / "other" / "snapshots", tmp_path / "data" / "snapshots")
    asks = OverHttp(keeping)
    before = asks.map()
    assert asks.map("json", at="moved")[1][2] == 2
    refused = asks.ask("restore", name="moved")
    assert (refused.status, refused.type) == (400, "bad-setting")
    assert "another lattice, anchored at (0.25, 0.0)" in refused.detail
    assert asks.map() == before


def test_the_restored_map_is_on_the_disk_when_that_is_answered(keeping, tmp_path):
    """Whatever ends the mapper then: a store of this moment's files is the restored map."""
    asks = OverHttp(keeping)
    asks.ask("save", name="a")
    keeping.draw_cross(revision=3)
    for k in range(3):
        status = asks.ask("restore", name="a")
        shutil.copytree(tmp_path / "data", tmp_path / f"crashed{k}")
        with MapStore(tmp_path / f"crashed{k}") as store:
            found = store.restore(keeping.service.parts.grid_settings)
        assert (found.grid.epoch, found.grid.revision) == (status["epoch"], 3)
        assert fingerprint(found.grid) == fingerprint(keeping.service.live_map._grid)


def test_scans_that_wait_and_what_is_known_of_robots_outlive_a_restore(keeping, eventually):
    asks = OverHttp(keeping)
    asks.ask("save", name="a")
    keeping.pose(at=0)
    keeping.scan([1.0], run="a", seq=0, at=10)
    keeping.scan([1.0], run="a", seq=1, at=60, pose=[0, 0, 0])
    eventually(lambda: keeping.status()["scans"]["received"] == 5)
    asks.ask("restore", name="a")
    keeping.pose(at=100)
    assert keeping.settle(received=5)["revision"] == 4
    keeping.scan([1.0], run="a", seq=1, at=60, pose=[0, 0, 0])
    after = keeping.settle(received=6)
    assert (after["scans"]["dropped"]["duplicate"], after["revision"]) == (1, 4)


def test_a_restore_amid_mapping_is_the_saved_map_and_the_scans_after_it(keeping, in_background, eventually):
    """Cell for cell: no scan of before it, none twice, none missing."""
    asks, go_on, sent = OverHttp(keeping), threading.Event(), []
    rng = np.random.default_rng(3)

    def drive():
        while not go_on.is_set() or len(sent) % 50:
            ranges, x = rng.uniform(0.5, 7.5, 90), 0.01 * len(sent)
            keeping.scan(ranges, pose=[x, 0.1, x], run="drive", seq=len(sent), at=1000 + len(sent))
            sent.append((ranges.astype(np.float32), x))

    driving = in_background(drive)
    eventually(lambda: keeping.status()["revision"] > 30)
    saved = asks.ask("save", name="a")
    eventually(lambda: keeping.status()["revision"] > saved["revision"] + 100)
    with keeping.service.parts.kept_map.snapshots.opened("a") as snapshot:
        expected = snapshot.grid(keeping.service.parts.grid_settings)
    for _ in range(3):
        epoch = asks.ask("restore", name="a")["epoch"]
        eventually(lambda: keeping.status()["revision"] > saved["revision"] + 40)
    go_on.set()
    driving.result(60.0)
    status = keeping.settle(received=3 + len(sent))
    assert status["scans"]["integrated"] == 3 + len(sent)
    after = status["revision"] - saved["revision"]
    assert 40 < after < len(sent)
    for k in range(len(sent) - after, len(sent)):
        ranges, x = sent[k]
        scan = Scan(1_700_000_000_000_000_000 + 1000 + k, 0.0, 0.1, 0.0, 8.0, ranges)
        expected.integrate(scan, Pose(x, 0.1, x))
    expected.epoch = epoch
    assert fingerprint(keeping.service.live_map._grid) == fingerprint(expected)


@contextmanager
def held_up(do, in_background):
    """A thread that `do` hands a job to has its hands full inside."""
    at_it, go_on = threading.Event(), threading.Event()

    def job(*_):
        at_it.set()
        assert go_on.wait(60.0)

    working = in_background(do, job)
    try:
        assert at_it.wait(30.0)
        yield
    finally:
        go_on.set()
        working.result(30.0)


def test_a_restore_comes_after_every_message_before_it(keeping, in_background, eventually, monkeypatch):
    asks, parts, asked = OverHttp(keeping), keeping.service.parts, threading.Event()
    asks.ask("save", name="a")
    with held_up(parts.worker.do, in_background):
        keeping.scan([1.0], pose=[0.25, 0.25, 0.0], at=7)
        eventually(lambda: keeping.status()["scans"]["received"] == 4)
        put = parts.queue.put
        monkeypatch.setattr(parts.queue, "put", lambda item: (put(item), asked.set())[0])
        restoring = in_background(asks.ask, "restore", name="a")
        assert asked.wait(30.0)
        keeping.scan([1.5], pose=[0.25, 0.25, 0.0], at=8)
        eventually(lambda: keeping.status()["scans"]["received"] == 5)
        assert keeping.status()["revision"] == 3
    restoring.result(30.0)
    status = keeping.settle(received=5)
    assert (status["revision"], status["stamp"]) == (4, 1_700_000_000_000_000_008)


def test_what_is_saved_has_every_message_that_came_before(keeping, in_background, eventually, monkeypatch):
    asks, parts, asked = OverHttp(keeping), keeping.service.parts, threading.Event()
    with held_up(parts.worker.do, in_background):
        for k in range(5):
            keeping.scan([1.0], pose=[0.25, 0.25, 0.0], at=7 + k)
        eventually(lambda: keeping.status()["scans"]["received"] == 8)
        put = parts.queue.put
        monkeypatch.setattr(parts.queue, "put", lambda item: (put(item), asked.set())[0])
        saving = in_background(asks.ask, "save", name="a")
        assert asked.wait(30.0)
    assert saving.result(30.0)["revision"] == 8


def test_writes_say_in_the_log_who_asked(keeping, caplog):
    caplog.set_level("INFO")
    for asks, way in (
        (OverHttp(keeping), "127.0.0.1 over HTTP"),
        (OverZenoh(keeping), "somebody over Zenoh"),
    ):
        caplog.clear()
        asks.ask("save", name="a")
        asks.ask("restore", name="a")
        asks.ask("delete", name="a")
        said = [text for text in caplog.messages if way in text]
        assert [text.split(" has ")[1].split(":")[0] for text in said] == [
            "saved the map as a",
            "restored the map a",
            "deleted the saved map a",
        ]


def test_many_who_ask_for_large_saved_maps_keep_nobody_from_the_status(
    keeping, monkeypatch, in_background, eventually
):
    asks = OverHttp(keeping)
    asks.ask("save", name="a")
    monkeypatch.setattr(large_module, "LARGE", 10)
    begun, go_on, read = [], threading.Event(), SavedMap.grid

    def slowly(*given):
        begun.append(1)
        assert go_on.wait(30.0)
        return read(*given)

    monkeypatch.setattr(SavedMap, "grid", slowly)
    try:
        asked = [in_background(asks.map, "json", at="a") for _ in range(12)]
        eventually(lambda: sum(one.done() for one in asked) == 8)
        assert len(begun) == 4
        assert {one.result().type for one in asked if one.done()} == {"busy"}
        assert keeping.status()["revision"] == 3
        assert keeping.http.get("/cell?x=0&y=0").status_code == 200
        assert keeping.http.get("/livez").status_code == 200
        keeping.scan([1.0], pose=[0, 0, 0], at=9)
        assert keeping.settle(received=4)["revision"] == 4
        eventually(lambda: keeping.status()["store"]["revision"] == 4)
    finally:
        go_on.set()
    assert [one.result().status if isinstance(one.result(), Refused) else 200 for one in asked].count(
        200
    ) == 4
    assert keeping.service.parts.in_flight.held == 0


def test_what_is_saved_is_shown_while_the_disk_takes_its_time(keeping, in_background):
    """Whoever looks at saved maps waits neither for the store's thread nor for the worker."""
    asks, parts = OverHttp(keeping), keeping.service.parts
    saved = asks.ask("save", name="a")
    then = asks.map()
    for do in (parts.kept_map._saver.do, parts.worker.do):
        with held_up(do, in_background):
            assert asks.map(at="a") == then
            assert asks.ask("snapshots") == {"snapshots": [saved]}
    with held_up(parts.worker.do, in_background):
        assert asks.ask("delete", name="a") == {"snapshots": []}


@pytest.fixture
def fine(tmp_path):
    """Saved maps of a store in which `a` is a room of 16 million cells of 1 cm."""
    settings, in_flight = GridSettings(resolution=0.01), InFlight(2**40)
    with MapStore(tmp_path) as store:
        grid = OccupancyGrid(settings, "e")
        scan = Scan(1, 0.0, math.tau / 720, 0.0, 30.0, np.full(720, 20.0, np.float32))
        grid.integrate(scan, Pose(0.0, 0.0, 0.0))
        store.commit(grid.checkpoint(), settings, "run", {})
        store.save("a")
        saved = SavedMaps(store.snapshots, settings, "hall", AnswerMemory(in_flight=in_flight))
        yield SimpleNamespace(saved=saved, in_flight=in_flight, tiles=grid.nbytes)


@pytest.mark.parametrize("form", MAP_FORMATS)
@pytest.mark.parametrize("given", [{}, {"region": "0,0,1,1"}])
def test_no_saved_map_takes_more_to_show_than_is_held_for_it(fine, form, given, monkeypatch):
    wanted, sizes = map_format(form, given), []
    fine.saved.map("a", wanted, {"region": "0,0,0.5,0.5"})  # tables are made once
    monkeypatch.setattr(fine.in_flight, "making", lambda size: sizes.append(size) or ExitStack())
    tracemalloc.start()
    try:
        fine.saved.map("a", wanted, given)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    (held,) = sizes
    written = 0.95 * fine.tiles  # the map that is read: no memory of Python's, and so not traced
    assert peak + written <= held + 8 * 1024**2
    assert held > 2 * written > 32 * 1024**2


def test_a_saved_map_that_has_no_room_is_not_even_read(fine, monkeypatch):
    monkeypatch.setattr(SavedMap, "grid", None)
    fine.in_flight.limit = 1024**2
    with fine.in_flight.making(1024**2), pytest.raises(Busy, match="making this one takes"):
        fine.saved.map("a", map_format("yaml", {}), {"region": "0,0,1,1"})
    assert fine.in_flight.held == 0
