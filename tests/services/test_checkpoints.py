"""Checkpoints of a map that is being written: each is the map, and the placing state, after an exact scan."""

import threading

import numpy as np
import pytest

from counts_model import scans
from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import BadStore
from ogm_core.tiles import store as store_module
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.storage import checkpoints as module
from ogm_services.mapper.storage.checkpoints import LITTLE, MUCH, Checkpoints
from ogm_services.mapper.storage.failures import StoreFails
from ogm_services.mapper.storage.map_saver import PERIOD, MapSaver
from ogm_services.mapper.storage.map_store import MapStore
from stored_maps import fingerprint, grid_of


class Writer:
    """A live map, and what a worker does with it: a scan, then a part of the placing state, then an offer."""

    def __init__(self, **changes):
        self.grid = grid_of(**changes)
        self.live = LiveMap(self.grid)
        self.placing, self.changed, self.states = {}, {}, {}
        self.checkpoints = Checkpoints(self.live, self.grid.settings, "run1", self.take_changed)
        self.states[self.now] = 0

    @property
    def now(self):
        return fingerprint(self.grid, self.placing)

    def take_changed(self):
        changed, self.changed = self.changed, {}
        return lambda: dict(changed)

    def integrate(self, scan, pose):
        self.live.integrate(scan, pose)
        robot = f"robot{self.grid.revision % 4}"
        self.placing[robot] = self.changed[robot] = b"%d" % self.grid.revision

    def work(self, done):
        while not done.is_set():
            for scan, pose in scans():
                self.integrate(scan, pose)
                with self.live._writing:  # no reader's copy, which other threads replace, is in the way
                    twin = grid_of()
                    twin.restore(self.grid.checkpoint().state, self.grid.checkpoint().tiles_since(0))
                self.states[fingerprint(twin, self.placing)] = self.grid.revision
                self.checkpoints.offer()


@pytest.mark.parametrize("first_room", [4096, 0], ids=["with room", "growing"])
def test_what_is_stored_while_the_map_is_written_is_exact(tmp_path, monkeypatch, first_room, eventually):
    """The saver stores as often as it can; a reader takes snapshots all the while; the store is looked at."""
    monkeypatch.setattr(store_module, "_FIRST_ROOM", first_room)
    writer, stored, done = Writer(), [], threading.Event()

    def read():
        while not done.is_set():
            writer.live.snapshot()

    reading = threading.Thread(target=read)
    with MapSaver(tmp_path, period=0.0) as saver:
        saver.keep(writer.checkpoints.take)
        reading.start()
        working = threading.Thread(target=writer.work, args=(done,))
        working.start()

        def looked():
            found = saver.do(lambda store: store.restore(writer.grid.settings))
            if found is not None:
                stored.append((fingerprint(found.grid, found.placing), found.grid.revision))
            return len({revision for _, revision in stored}) > 8

        try:
            eventually(looked)
        finally:
            done.set()
            working.join()
            reading.join()
        writer.checkpoints.worker_stopped()
        assert saver.failing is None
    assert all(writer.states[state] == revision for state, revision in stored)
    with MapStore(tmp_path) as store:
        found = store.restore(writer.grid.settings)
    assert found.grid.revision == writer.grid.revision
    assert fingerprint(found.grid, found.placing) == writer.now


def test_what_changes_within_a_period_is_stored_at_its_end(tmp_path):
    """Once a second at most, however many scans there are; what is new at the end is stored then."""
    assert PERIOD == 1.0
    writer, taken = Writer(), []
    writer.checkpoints.worker_stopped()
    with MapSaver(tmp_path, period=1000.0) as saver:
        saver.keep(lambda: taken.append(writer.grid.revision) or writer.checkpoints.take())
        for scan, pose in scans():
            writer.integrate(scan, pose)
            saver.do(lambda store: None)  # it has looked at what it is asked, and not stored
        assert (taken, saver.revision) == ([], None)
    assert (taken, saver.revision) == ([12], 12)


def test_a_worker_that_has_stopped_leaves_the_last_checkpoint_to_the_saver():
    writer = Writer()
    for scan, pose in scans():
        writer.integrate(scan, pose)
    writer.checkpoints.worker_stopped()
    taken = writer.checkpoints.take()
    assert (taken.checkpoint.state.revision, taken.run) == (12, "run1")
    assert taken.placing == {"robot0": b"12", "robot1": b"9", "robot2": b"10", "robot3": b"11"}
    assert writer.checkpoints.take().placing == {}


def test_a_worker_that_does_not_come_to_it_is_named_and_nothing_is_lost(monkeypatch):
    monkeypatch.setattr(module, "PATIENCE", 0.05)
    monkeypatch.setattr(module, "LOOK_PERIOD", 0.02)
    writer = Writer()
    writer.integrate(*next(scans()))
    with pytest.raises(StoreFails, match=r"the mapper has been at one message for 0\.05 s"):
        writer.checkpoints.take()
    writer.checkpoints.offer()  # nobody waits for it any more
    writer.checkpoints.worker_stopped()
    assert writer.checkpoints.take().placing == {"robot1": b"1"}


def test_an_offer_that_nobody_wants_takes_nothing():
    writer = Writer()
    writer.integrate(*next(scans()))
    writer.checkpoints.offer()
    assert writer.changed == {"robot1": b"1"}


@pytest.mark.parametrize("cells", ["int16", "float64"])
def test_however_much_has_changed_the_worker_copies_little(cells, monkeypatch):
    """1,200 tiles change, and again while they are copied; and a scan comes before the worker looks."""
    writer = Writer(model=LogOdds(cells))
    tile = np.dtype(cells).itemsize * 64 * 64
    planes = {"log_odds": np.ones((64 * 30, 64 * 40), cells)}
    writer.grid.begin_with(planes)
    writer.live.snapshot()
    copied, copy = [], writer.grid.checkpoint

    def counted(room):
        copied.append(writer.grid.uncopied_bytes)
        return copy(room)

    monkeypatch.setattr(writer.grid, "checkpoint", counted)
    passes = 3

    def write_meanwhile():
        """What the worker does while the saver copies."""
        nonlocal passes
        passes -= 1
        store = writer.grid._store
        writer.grid.revision += 1
        store.touched[store.touched > 0] = writer.grid.revision
        if passes < 0:
            return
        writer.integrate(*next(scans()))

    ahead = writer.live.copy_ahead

    def copy_ahead():
        if passes > 0:
            write_meanwhile()
        room = ahead()
        if passes > 0:
            write_meanwhile()
        return room

    monkeypatch.setattr(writer.live, "copy_ahead", copy_ahead)
    working = threading.Event()

    def offers():
        while not working.wait(0.001):
            writer.checkpoints.offer()

    worker = threading.Thread(target=offers)
    worker.start()
    try:
        taken = writer.checkpoints.take()
    finally:
        working.set()
        worker.join()
    assert taken.checkpoint.state.revision == writer.grid.revision
    assert 1200 * tile > MUCH
    assert max(copied) <= LITTLE
    twin = grid_of(LogOdds(cells))
    twin.restore(taken.checkpoint.state, taken.checkpoint.tiles_since(0))
    assert fingerprint(twin) == fingerprint(writer.grid)


def test_a_map_that_changes_too_fast_is_stored_all_the_same(monkeypatch):
    """The last try takes whatever there is to copy."""
    writer = Writer()
    writer.integrate(*next(scans()))
    monkeypatch.setattr(module, "LITTLE", -1)
    writer.checkpoints.worker_stopped()
    assert writer.checkpoints.take().checkpoint.state.revision == 1


def test_a_map_that_began_with_cells_is_stored_once_until_a_scan_comes(tmp_path):
    """Poses come, and no scan: its tiles are not written again and again."""
    writer = Writer()
    writer.grid.begin_with({"log_odds": np.ones((64 * 30, 64 * 40), np.int16)})
    writer.checkpoints.worker_stopped()
    with MapSaver(tmp_path, period=1000.0) as saver:
        saver.keep(writer.checkpoints.take)
        writes = []
        saver.do(lambda store: store._connection.set_trace_callback(writes.append))

        def tiles_written(name):
            before = len(writes)
            writer.changed = writer.placing = {"robot1": name.encode()}
            saver.save(name)
            found = saver.do(lambda store: store.restore(writer.grid.settings))
            assert fingerprint(found.grid, found.placing) == writer.now
            return sum("INSERT INTO tiles" in text for text in writes[before:])

        assert [tiles_written(name) for name in "abc"] == [1200, 0, 0]
        writer.integrate(*next(scans()))
        assert tiles_written("d") >= 1200  # once more, whatever it has changed
        writer.integrate(*next(scans()))
        assert 0 < tiles_written("e") < 100


def test_who_asks_a_store_that_is_closed_is_told(tmp_path):
    saver = MapSaver(tmp_path)
    with saver:
        assert saver.do(lambda store: store.empty)
    with pytest.raises(StoreFails, match="the mapper is stopping, and the store is closed"):
        saver.do(lambda store: store.empty)


def test_what_a_job_raises_is_raised_where_it_was_asked_for_and_the_store_goes_on(tmp_path):
    with MapSaver(tmp_path) as saver:
        with pytest.raises(ZeroDivisionError):
            saver.do(lambda _store: 1 / 0)
        assert saver.do(lambda store: store.empty)


def test_a_store_that_cannot_be_opened_says_so_where_it_is_opened(tmp_path):
    (tmp_path / "map.sqlite").write_bytes(b"")
    with pytest.raises(BadStore, match="it is empty"), MapSaver(tmp_path):
        pass
    assert not [thread for thread in threading.enumerate() if thread.name == "ogm-store"]
