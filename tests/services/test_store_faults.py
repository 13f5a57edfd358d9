"""A disk that is full or fails: the store says so, goes on when it can, and has forgotten nothing.

Faults are real: a file system of 2 MB that is full (root only), and a disk that fails by a library that
stands between SQLite and the system (where there is a C compiler).
"""

import errno
import json
import os
import re
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from full_disk import room_for
from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.rate import Rate
from ogm_core.errors import DiskFull
from ogm_services.mapper.storage.failures import StoreFails
from ogm_services.mapper.storage.map_saver import MapSaver, Taken
from ogm_services.mapper.storage.map_store import MapStore
from stored_maps import RUN, Story, fingerprint, grid_of, restored

TESTS = Path(__file__).parents[1]
CANNOT = r".*map\.sqlite: cannot be written: "
FAULTS = {
    "no room": ("write", errno.ENOSPC, f"DiskFull: {CANNOT}database or disk is full"),
    "write": (
        "write",
        errno.EIO,
        f"StoreFails: {CANNOT}disk I/O error .SQLITE_IOERR_WRITE",
    ),
    "fsync": (
        "sync",
        errno.EIO,
        f"StoreFails: {CANNOT}disk I/O error .SQLITE_IOERR_",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_disk_that_fails_costs_nothing_but_time(tmp_path, failing_disk, fault):
    """At every write, or every fsync, of a commit and of what follows it."""
    kind, number, said = FAULTS[fault]
    run = subprocess.run(
        [sys.executable, TESTS / "store_on_failing_disk.py", tmp_path, kind, str(number)],
        env={**os.environ, "LD_PRELOAD": str(failing_disk), "FAILING_DISK": str(tmp_path / "control")},
        capture_output=True,
        text=True,
        timeout=250,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-3000:]
    lines = [json.loads(line) for line in run.stdout.splitlines()]
    assert len(lines) == 19
    assert all(line["after_fault"] and line["after_next"] for line in lines), lines
    failures = [text for line in lines for text in line["said"]]
    assert len(failures) > (4 if kind == "sync" else 20)
    for text in failures:
        assert re.match(said, text), text


@contextmanager
def small_disk(folder):
    """A file system of 2 MB."""
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", folder],
        capture_output=True,
        text=True,
        check=False,
    )
    if mounted.returncode:
        pytest.skip(f"a file system of 2 MB is mounted by root only: {mounted.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


@pytest.fixture
def disk(tmp_path):
    with small_disk(tmp_path / "disk") as folder:
        yield folder


def fill(disk):
    """Leave no room."""
    with suppress(OSError), (disk / "filler").open("wb", buffering=0) as file:
        while file.write(bytes(4096)):
            pass
    assert os.statvfs(disk).f_bavail == 0


def test_a_disk_that_is_full_is_named_and_all_is_stored_when_it_has_room_again(disk):
    with MapStore(disk / "map") as store:
        story = Story(store, grid_of())
        story.integrate(2)
        story.commit()
        fill(disk)
        for _ in range(20):
            story.integrate(1)
            with pytest.raises(DiskFull, match=f"{disk}/map/map.sqlite: cannot be written: .* disk is full"):
                story.commit()
        (disk / "filler").unlink()
        story.commit()
        assert restored(store, story.grid.settings) == story.now
    with MapStore(disk / "map") as store:
        assert restored(store, story.grid.settings) == story.now


def test_no_store_begins_on_a_disk_that_is_full(disk):
    fill(disk)
    with pytest.raises(DiskFull, match=f"{disk}/map/map.sqlite: cannot be written: "):
        MapStore(disk / "map")
    (disk / "filler").unlink()
    with MapStore(disk / "map") as store:
        assert store.empty


def test_a_store_is_restored_on_a_disk_that_is_full(disk):
    """It is read without a byte written; the next commit says what is the matter."""
    with MapStore(disk / "map") as store:
        story = Story(store, grid_of())
        story.integrate(4)
        story.commit()
    fill(disk)
    with MapStore(disk / "map") as store:
        found = store.restore(story.grid.settings)
        assert fingerprint(found.grid, found.placing) == story.now
        story.store = store
        story.integrate(3)
        with pytest.raises(DiskFull):
            story.commit()
        (disk / "filler").unlink()
        story.commit()
        assert restored(store, story.grid.settings) == story.now


def test_a_snapshot_that_has_no_room_is_not_there(disk):
    with MapStore(disk / "map") as store:
        story = Story(store, grid_of())
        story.integrate(4)
        story.commit()
        fill(disk)
        with pytest.raises(DiskFull, match=r"snapshots/one\.sqlite: cannot be written"):
            store.save("one")
        assert store.snapshots.list() == []
        (disk / "filler").unlink()
        store.save("one")
        assert [snapshot.name for snapshot in store.snapshots.list()] == ["one"]
    assert [path.name for path in (disk / "map" / "snapshots").iterdir()] == ["one.sqlite"]


def test_a_disk_that_is_full_is_told_to_who_saves_and_who_restores(disk, start_mapper, eventually):
    """What is restored is the map all the same, and is stored once there is room."""
    with start_mapper(mapper={"data": str(disk / "map")}) as mapper:
        mapper.draw_cross()
        mapper.http.post("/save?name=one").raise_for_status()
        then = mapper.http.get("/map.npz").content
        mapper.draw_cross(revision=3)
        eventually(lambda: mapper.status()["store"]["revision"] == 6)
        fill(disk)
        for path, said in (
            ("/save?name=two", "snapshots/two.sqlite: cannot be written"),
            ("/restore?name=one", "the map is one now, but is not stored yet, which is tried again: "),
        ):
            response = mapper.http.post(path)
            problem = response.json()
            assert (response.status_code, problem["type"]) == (507, "disk-full")
            assert said in problem["detail"]
        assert [saved["name"] for saved in mapper.http.get("/snapshots").json()["snapshots"]] == ["one"]
        assert mapper.http.get("/map.npz").content == then == mapper.http.get("/map.npz?at=one").content
        eventually(lambda: mapper.status()["store"]["failing"])
        (disk / "filler").unlink()
        eventually(lambda: mapper.status()["store"]["failing"] is None)
        status = mapper.status()
        assert (status["revision"], status["store"]["revision"]) == (3, 3)
    with MapStore(disk / "map") as store:
        found = store.restore(mapper.service.parts.grid_settings)
        assert (found.grid.epoch, found.grid.revision) == (status["epoch"], 3)


def test_a_disk_that_is_full_is_told_to_who_erases(disk, start_mapper, eventually):
    """What is erased is so all the same, and is stored once there is room."""
    with start_mapper(mapper={"data": str(disk / "map")}) as mapper:
        mapper.draw_cross()
        eventually(lambda: mapper.status()["store"]["revision"] == 3)
        fill(disk)
        response = mapper.http.post("/erase", params={"region": "0.5,-9,9,9"})
        problem = response.json()
        assert (response.status_code, problem["type"]) == (507, "disk-full")
        assert "the map is erased there, but is not stored yet, which is tried again: " in problem["detail"]
        assert mapper.status()["revision"] == 4
        erased = fingerprint(mapper.service.live_map._grid)
        (disk / "filler").unlink()
        eventually(lambda: mapper.status()["store"]["revision"] == 4)
    with MapStore(disk / "map") as store:
        found = store.restore(mapper.service.parts.grid_settings)
        assert (fingerprint(found.grid), found.grid.erasures) == (erased, 1)


def test_a_disk_that_fails_is_told_to_who_resets(disk, start_mapper, eventually):
    """The map is empty all the same, and is stored so once there is room."""
    with start_mapper(mapper={"data": str(disk / "map")}) as mapper:
        mapper.draw_cross()
        eventually(lambda: mapper.status()["store"]["revision"] == 3)
        fill(disk)
        response = mapper.http.post("/reset")
        assert (response.status_code, response.json()["type"]) == (507, "disk-full")
        assert "the map is empty, but is not stored yet" in response.json()["detail"]
        assert mapper.status()["revision"] == 0
        (disk / "filler").unlink()
        eventually(lambda: mapper.status()["store"]["revision"] == 0)


def test_a_saver_says_that_it_fails_and_why_until_all_is_stored(tmp_path, eventually, caplog):
    story = Story(None, grid_of())
    settings = story.grid.settings

    def take():
        story.integrate(1)
        changed, story._changed = story._changed, {}
        story.states[story.now] = story.grid.revision
        return Taken(story.grid.checkpoint(), settings, RUN, changed)

    with MapSaver(tmp_path, period=0.01) as saver:
        assert saver.do(lambda store: store.restore(settings)) is None
        saver.keep(take)
        eventually(lambda: saver.do(lambda store: store.empty) is False)
        assert saver.failing is None
        with room_for(1):
            reason = eventually(lambda: saver.failing)
            assert f"{tmp_path}/map.sqlite: cannot be written: " in reason
            failed = story.grid.revision
            eventually(lambda: story.grid.revision > failed + 2)
            with pytest.raises(StoreFails):
                saver.save("now")
        eventually(lambda: saver.failing is None)
        saver.save("now")
    assert "the map goes on in memory; storing it is tried again" in caplog.text
    with MapStore(tmp_path) as store:
        found = store.restore(settings)
        assert fingerprint(found.grid, found.placing) == story.now
        assert [snapshot.name for snapshot in store.snapshots.list()] == ["now"]


@pytest.mark.parametrize(
    ("name", "half_life"),
    [("log_odds", None), ("log_odds", 6.0), ("rate", None), ("rate", 6.0), ("robots", None)],
)
def test_a_map_that_is_stored_when_the_process_is_killed_is_exact(tmp_path, name, half_life):
    """Three kills at moments of their own, each in the middle of commits; the next process goes on."""
    code = (TESTS / "store_till_killed.py").as_posix()
    model, robots, revision, states = LogOdds() if name == "log_odds" else Rate(), name == "robots", 0, {}
    for k in range(3):
        with subprocess.Popen(
            [sys.executable, code, tmp_path / "map", name, *(() if half_life is None else [str(half_life)])],
            stdout=subprocess.PIPE,
            text=True,
        ) as process:
            lines = [process.stdout.readline()]
            end = time.monotonic() + 0.05 + 0.03 * k
            while time.monotonic() < end or len(lines) < 10:
                lines.append(process.stdout.readline())
            process.kill()
            lines += process.stdout.read().splitlines()
        committed = 0
        for line in filter(None, map(str.strip, lines)):
            said = line.split()
            if len(said) == 3:
                states[said[1]] = int(said[2])
                committed = max(committed, int(said[2]) if said[0] == "stored" else 0)
        grid = grid_of(model, half_life=half_life, separate_robots=robots)
        with MapStore(tmp_path / "map") as store:
            found = store.restore(grid.settings)
        revision = found.state.map.revision
        assert states[fingerprint(found.grid, found.placing)] == revision
        assert revision >= committed
    assert revision > 10
    assert bool(found.grid.time.ticks) == (half_life is not None)


@pytest.mark.parametrize("replaced", [False, True], ids=["moved", "replaced"])
@pytest.mark.parametrize("name", ["map.sqlite", "map.sqlite-wal", ""], ids=["file", "log", "folder"])
def test_a_store_that_is_moved_away_is_missed_and_goes_on_when_it_is_back(tmp_path, name, replaced):
    """SQLite alone would go on into files that nobody finds again."""
    folder = tmp_path / "map"
    with MapStore(folder) as store:
        story = Story(store, grid_of())
        story.integrate(2)
        story.commit()
        place, away = folder / name, tmp_path / "away"
        place.rename(away)
        if replaced:
            (shutil.copytree if away.is_dir() else shutil.copy)(away, place)
        assert not store.holds(story.grid.checkpoint())
        for _ in range(2):
            story.integrate(1)
            with pytest.raises(StoreFails, match=r"map\.sqlite(-wal)?: it was moved, deleted or replaced"):
                story.commit()
        if replaced:
            (shutil.rmtree if place.is_dir() else Path.unlink)(place)
        away.rename(place)
        story.integrate(1)
        story.commit()
        assert store.holds(story.grid.checkpoint())
    with MapStore(folder) as store:
        assert restored(store, story.grid.settings) == story.now
