"""Maps that forget, stored, and read while they are written: they go on as if nothing had been."""

import threading
import weakref
from types import SimpleNamespace

import pytest

from counts_model import scans
from ogm_core.cells.log_odds import PLANE, LogOdds
from ogm_core.cells.rate import Rate
from ogm_core.tiles.copies import CopyAhead
from ogm_services.mapper.live import live_map as live_map_module
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.storage.checkpoints import Checkpoints
from ogm_services.mapper.storage.map_saver import MapSaver
from ogm_services.mapper.storage.map_store import MapStore
from ogm_services.mapper.storage.repair import repair
from stored_maps import Story, fingerprint, grid_of, in_time, restored, saved

CELLS = pytest.mark.parametrize("cells", ["int16", "float64", "rate"])
HALF_LIFE = 6.0


def forgetting(cells="int16", **changes):
    """A map with 30 scans, a second apart, in five half-lives of log odds, or 15 of counts."""
    counts = cells == "rate"
    model, half_life = (Rate(), HALF_LIFE / 3) if counts else (LogOdds(cells), HALF_LIFE)
    return grid_of(model, resolution=0.1, half_life=half_life, **changes)


def read_whole(snapshot):
    """Where its cells lie, and every number of them."""
    return snapshot.offset, *(plane.tobytes() for plane in snapshot.stored.planes().values())


def without_interruption(count, cells="int16"):
    story = Story(None, forgetting(cells))
    story.integrate(count)
    return story


@CELLS
def test_a_restored_map_goes_on_as_if_nothing_had_been(tmp_path, cells):
    """Of a store that holds tiles of all ages, each with the ticks that it has had."""
    with MapStore(tmp_path) as store:
        story = Story(store, forgetting(cells))
        for _ in range(30):
            story.integrate()
            story.grid.snapshot()
            story.commit()
            after = store.restore(story.grid.settings).grid
            assert fingerprint(after) == fingerprint(story.grid)
            if story.grid.revision % 3 == 0:
                story.grid = after
    twin = without_interruption(30, cells)
    assert len(twin.grid.time.ticks) > 12
    assert story.now == twin.now


@CELLS
def test_a_map_that_nobody_reads_is_stored_as_well(tmp_path, cells):
    """Its copies are those of checkpoints, which leave tiles that have missed ticks as they are."""
    with MapStore(tmp_path) as store:
        story = Story(store, forgetting(cells))
        for _ in range(30):
            story.integrate()
            checkpoint = story.grid.checkpoint()
            store.commit(checkpoint, story.grid.settings, "run1", story.placing)
        found = store.restore(story.grid.settings)
        assert fingerprint(found.grid) == fingerprint(without_interruption(30, cells).grid)


def test_a_snapshot_is_of_its_own_time_and_goes_on_from_there(tmp_path):
    with MapStore(tmp_path) as store:
        story = Story(store, forgetting())
        story.integrate(9)
        story.commit()
        store.save("then")
        story.integrate(9)
        story.commit()
        again = saved(store, "then", story.grid.settings)
        assert restored(store, story.grid.settings) == story.now
    twin = without_interruption(9)
    assert again.time == twin.grid.time != story.grid.time
    for placed in list(scans())[9:]:
        for grid in (again, twin.grid):
            grid.integrate(*in_time(placed, grid))
        assert fingerprint(again) == fingerprint(twin.grid)


def test_what_is_repaired_keeps_its_time(tmp_path):
    with MapStore(tmp_path / "map") as store:
        story = Story(store, forgetting())
        story.integrate(12)
        story.commit()
    assert repair(tmp_path / "map", tmp_path / "new").exact
    with MapStore(tmp_path / "new") as store:
        found = store.restore(story.grid.settings).grid
    assert fingerprint(found, epoch=False) == fingerprint(story.grid, epoch=False)


@pytest.mark.parametrize("scarce", [False, True], ids=["plenty of memory", "scarce memory"])
def test_a_copy_is_let_go_before_all_is_copied_anew_if_both_are_too_much(monkeypatch, scarce):
    monkeypatch.setattr(live_map_module, "_MUCH", 0)
    live, held, made = LiveMap(forgetting()), [], CopyAhead.made
    left = 0 if scarce else 10**9
    placed = iter(scans())
    live.integrate(*in_time(next(placed), live._grid))
    cells = weakref.ref(live.snapshot().stored.tiles.blocks[0].planes[PLANE])
    for _ in range(2):
        live.integrate(*in_time(next(placed), live._grid))
    assert live._grid.time.ticks

    def look(ahead):
        held.append(cells() is not None)
        return made(ahead)

    monkeypatch.setattr(CopyAhead, "made", look)
    live._memory = SimpleNamespace(left=lambda: left, make_room=lambda: None)
    assert live.snapshot().cells.tobytes() == live._grid.snapshot().cells.tobytes()
    assert held == [not scarce]


@pytest.mark.parametrize("scarce", [False, True], ids=["plenty of memory", "scarce memory"])
@CELLS
def test_readers_and_the_store_get_whole_maps_while_it_is_written(
    tmp_path, monkeypatch, in_background, eventually, cells, scarce
):
    """What has missed ticks is copied beside the writer, with the copy of before or in its place."""
    monkeypatch.setattr(live_map_module, "_MUCH", 0)
    twin, served, states = Story(None, forgetting(cells)), {}, {}
    for _ in range(60):
        twin.integrate()
        snapshot = twin.grid.snapshot()
        served[twin.grid.revision] = read_whole(snapshot)
        states[twin.grid.revision] = fingerprint(twin.grid)
    live, seen, wrong, done = LiveMap(forgetting(cells)), set(), [], threading.Event()
    grid, writer = live._grid, threading.current_thread()
    if scarce:
        live._memory = SimpleNamespace(
            left=lambda: 10**9 if threading.current_thread() is writer else 0,
            limit=10**9,
            make_room=lambda: None,
        )

    def read():
        while not done.is_set():
            snapshot = live.snapshot()
            if snapshot.revision:
                seen.add(snapshot.revision)
                if read_whole(snapshot) != served[snapshot.revision]:
                    wrong.append(snapshot.revision)

    checkpoints = Checkpoints(live, grid.settings, "run1", lambda: dict)
    readers = [threading.Thread(target=read) for _ in range(2)]
    with MapSaver(tmp_path, period=1000.0) as saver:
        saver.keep(checkpoints.take)
        for reader in readers:
            reader.start()
        try:
            for k, placed in enumerate(list(scans()) * 5):
                live.integrate(*in_time(placed, grid))
                checkpoints.offer()
                if k % 6 == 5:
                    eventually(lambda k=k: checkpoints.offer() or wrong or (k + 1 in seen))
                    storing = in_background(saver.store_now)
                    eventually(lambda storing=storing: checkpoints.offer() or storing.done())
                    storing.result()
                    found = saver.do(lambda store: store.restore(grid.settings)).grid
                    assert fingerprint(found) == states[grid.revision]
        finally:
            done.set()
            for reader in readers:
                reader.join()
            checkpoints.worker_stopped()
    assert wrong == []
    assert len(seen) >= 10
