"""MapClient.follow and watch against a mapper: at every revision they tell the copy is the mapper's map."""

import gc
import hashlib
import math
import subprocess
import sys
import threading
import time
import weakref

import numpy as np
import pytest

from ogm_client import ClientError, MapClient, NobodyAnswered
from ogm_client import follower as follower_module
from ogm_client.map_copy import MapCopy
from ogm_client.zenoh_transport import ZenohTransport
from ogm_core.cells.log_odds import PLANE
from ogm_services.mapper.serving import update_publisher

PATIENCE = 30.0
OVER = pytest.mark.parametrize("over", ["http", "zenoh"])


def address(mapper, over):
    return str(mapper.http.base_url) if over == "http" else mapper.endpoint


def client_of(mapper, over):
    return MapClient(address(mapper, over), map_name="hall", timeout=PATIENCE)


def checksum(planes):
    return hashlib.blake2b(planes[PLANE].tobytes()).hexdigest()


class Recorder:
    """The checksum of the mapper's cells at every revision, taken in the mapper after each change."""

    def __init__(self, mapper):
        self.sums = {}
        live_map = mapper.service.live_map
        for name in ("integrate", "reset", "erase", "become"):
            setattr(live_map, name, self._noting(getattr(live_map, name), live_map))
        self._note(live_map)

    def _noting(self, change, live_map):
        def changed(*given, **named):
            done = change(*given, **named)
            self._note(live_map)
            return done

        return changed

    def _note(self, live_map):
        snapshot = live_map.snapshot()  # the worker itself takes it: nothing changes meanwhile
        key = snapshot.epoch, snapshot.run, snapshot.revision
        self.sums[key] = snapshot.rect, checksum(snapshot.stored.planes())

    def assert_equal(self, follower):
        """That the follower's copy is what the mapper's map was at that revision; the revision."""
        with follower._news:
            copy, newest = follower._copy, follower._copy.newest
            extent = newest.extent
            cells = np.zeros((extent.height, extent.width), newest.planes[0].dtype)
            padded = np.zeros((extent.height + 128, extent.width + 128), cells.dtype)
            for (tx, ty), planes in copy.tiles.items():
                x, y = 64 * tx - extent.ix + 64, 64 * ty - extent.iy + 64
                if 0 <= x <= extent.width + 64 and 0 <= y <= extent.height + 64:
                    padded[y : y + 64, x : x + 64] = planes[PLANE].reshape(64, 64)
            cells[:] = padded[64 : 64 + extent.height, 64 : 64 + extent.width]
            deadline = time.monotonic() + PATIENCE
            while tuple(copy.version) not in self.sums:  # it is told before it is noted
                assert time.monotonic() < deadline
                time.sleep(0.002)
            assert self.sums[tuple(copy.version)] == (extent, checksum({PLANE: cells}))
            return copy.version


def drive(mapper, rng, count, begin):
    """Scans all over the place, also to the west and the south; returns how many there were."""
    for k in range(count):
        x, y = rng.normal(0, 25, 2).tolist()
        at = (begin + k) * 10**9
        mapper.scan(
            rng.uniform(1.0, 7.0, 40), at=at, pose=[x, y, 0.0], angle_increment=math.tau / 40, seq=begin + k
        )
    return begin + count


def until(follower, revision, recorder):
    """Wait until the follower is there; check it at every revision that it tells."""
    change = None
    deadline = time.monotonic() + PATIENCE
    while follower.version.revision != revision:
        change = follower.wait(after=follower.version, timeout=PATIENCE)
        assert change is not None
        recorder.assert_equal(follower)
        assert time.monotonic() < deadline
    recorder.assert_equal(follower)
    return change


SETTINGS = {
    "int16": {},
    "float64": {"cells": "float64"},
    "half_life": {"half_life": 4.0},
}


@OVER
@pytest.mark.parametrize("settings", ["int16", "float64", "half_life"])
def test_the_copy_is_the_map_at_every_revision_that_is_told(start_mapper, over, settings):
    rng = np.random.default_rng(1)
    with start_mapper(map={"resolution": 0.5, **SETTINGS[settings]}) as mapper:
        recorder = Recorder(mapper)
        with client_of(mapper, over) as client, client.follow(interval=0.02) as follower:
            recorder.assert_equal(follower)
            sent = drive(mapper, rng, 25, 0)
            until(follower, sent, recorder)
            for _ in range(5):
                sent = drive(mapper, rng, 1, sent)
                until(follower, sent, recorder)
            mapper.http.post("/erase", params={"region": "-9,-9,9,9"}).raise_for_status()
            until(follower, sent + 1, recorder)
            served, grid = client.get_map(), follower.grid()
            assert np.array_equal(grid.log_odds, served.log_odds, equal_nan=True)
            assert (grid.offset, grid.stamp, grid.run) == (served.offset, served.stamp, served.run)
            assert min(grid.offset) < -20
            seen = follower.version
            mapper.http.post("/reset").raise_for_status()
            change = follower.wait(after=seen, timeout=PATIENCE)
            assert (change.revision, change.whole, change.reset, change.region) == (0, True, True, None)
            recorder.assert_equal(follower)
            drive(mapper, rng, 3, sent)
            until(follower, 3, recorder)


def test_messages_that_are_lost_repeated_and_late_do_no_harm(start_mapper, monkeypatch):
    """Between the mapper and the follower stands somebody who has 1 of 3 messages, and remembers old ones."""
    rng, trouble, counts = np.random.default_rng(1), np.random.default_rng(2), {"asked": 0, "lost": 0}
    hear_updates, fetch = ZenohTransport.hear_updates, ZenohTransport.fetch

    def hear_badly(self, heard):
        seen = []

        def pass_on(payload):
            seen.append(payload)
            now = [payload] if trouble.random() < 0.4 else []
            counts["lost"] += not now
            now += [seen[int(trouble.integers(len(seen)))] for _ in range(int(trouble.integers(3)))]
            if trouble.random() < 0.1:
                now.append(payload[: len(payload) // 2])
            trouble.shuffle(now)
            for each in now:
                heard(each)

        return hear_updates(self, pass_on)

    def counted(self, name, parameters):
        counts["asked"] += name == "map.tiles"
        return fetch(self, name, parameters)

    monkeypatch.setattr(update_publisher, "HEARTBEAT", 0.1)  # after a loss a follower waits for the next word
    monkeypatch.setattr(ZenohTransport, "hear_updates", hear_badly)
    monkeypatch.setattr(ZenohTransport, "fetch", counted)
    with start_mapper(map={"resolution": 0.5, "half_life": 8.0}) as mapper:
        recorder = Recorder(mapper)
        with client_of(mapper, "zenoh") as client, client.follow() as follower:
            sent = 0
            for epoch in range(3):
                for revision in range(1, 8):
                    sent = drive(mapper, rng, 1, sent)
                    mapper.settle(received=sent)
                    until(follower, revision, recorder)
                if epoch < 2:
                    mapper.http.post("/reset").raise_for_status()
                    until(follower, 0, recorder)
    assert counts["lost"] > 5
    assert counts["asked"] > 3


@OVER
def test_a_change_says_where(start_mapper, over):
    with start_mapper(map={"resolution": 0.5}) as mapper, client_of(mapper, over) as client:
        mapper.draw_cross()
        with client.follow(interval=0.02) as follower:
            first = follower.wait(timeout=PATIENCE)
            assert (first.revision, first.whole, first.reset) == (3, True, False)
            assert first.region == (-32.0, -32.0, 32.0, 32.0)
            assert follower.wait(after=first.version, timeout=0.05) is None
            mapper.scan([1.0], at=9, pose=[300.25, 0.25, 0.0], range_max=2.5)
            change = follower.wait(after=first.version, timeout=PATIENCE)
            assert (change.epoch, change.run, change.revision) == (first.epoch, first.run, 4)
            assert (change.whole, change.reset) == (False, False)
            assert change.region == (288.0, 0.0, 320.0, 32.0)
            assert change.tiles.tolist() == [[9, 0]]


@OVER
def test_a_map_that_starts_with_cells_is_followed_from_there(start_mapper, over, tmp_path):
    start, rng = tmp_path / "start.npz", np.random.default_rng(5)
    with start_mapper(map={"resolution": 0.5}) as mapper:
        drive(mapper, rng, 3, 0)
        mapper.settle(received=3)
        start.write_bytes(mapper.http.get("/map.npz").content)
    with start_mapper(map={"resolution": 0.5}, mapper={"start_map": str(start)}) as mapper:
        recorder = Recorder(mapper)
        with client_of(mapper, over) as client, client.follow(interval=0.02) as follower:
            assert follower.version.revision == 0
            recorder.assert_equal(follower)
            assert follower.grid().known.sum() == client.get_map().known.sum() > 100
            until(follower, drive(mapper, rng, 3, 0), recorder)
            mapper.http.post("/reset").raise_for_status()
            follower.wait(after=follower.version, timeout=PATIENCE)
            recorder.assert_equal(follower)


@OVER
def test_a_restored_map_is_another_life(start_mapper, over, tmp_path):
    rng = np.random.default_rng(5)
    with start_mapper(map={"resolution": 0.5}, mapper={"data": str(tmp_path / "data")}) as mapper:
        recorder = Recorder(mapper)
        with client_of(mapper, over) as client, client.follow(interval=0.02) as follower:
            sent = drive(mapper, rng, 3, 0)
            until(follower, 3, recorder)
            client.save_snapshot("then")
            drive(mapper, rng, 3, sent)
            until(follower, 6, recorder)
            seen = follower.version
            client.restore_snapshot("then")
            change = follower.wait(after=seen, timeout=PATIENCE)
            until(follower, 3, recorder)
            assert (change.reset, change.whole) == (True, True)


@OVER
def test_it_rides_out_a_restart(start_mapper, over, tmp_path):
    rng, place = np.random.default_rng(5), {}
    settings = {"map": {"resolution": 0.5}, "mapper": {"data": str(tmp_path / "data")}}
    with start_mapper(**settings) as mapper:
        place["network"] = {"listen": [mapper.endpoint]}
        place["http"] = {"port": mapper.http.base_url.port}
        client = client_of(mapper, over)
        drive(mapper, rng, 3, 0)
        mapper.settle(received=3)
        follower = client.follow(interval=0.02)
        before = follower.wait(timeout=PATIENCE)
        assert (before.revision, follower.connected) == (3, True)
    with client, follower:
        deadline = time.monotonic() + PATIENCE
        while follower.connected:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        assert follower.grid().revision == 3
        with start_mapper(**settings, **place) as mapper:
            recorder = Recorder(mapper)
            change = follower.wait(after=before.version, timeout=PATIENCE)
            assert (change.epoch, change.revision, change.reset) == (before.epoch, 3, True)
            assert change.run != before.run
            assert follower.connected
            recorder.assert_equal(follower)
            drive(mapper, rng, 2, 3)
            until(follower, 5, recorder)


def test_over_zenoh_changes_come_without_being_asked_for(start_mapper, monkeypatch):
    """Asked for by itself it would be after 1000 s, or when it hears that it has missed something."""
    asked, fetch = [], ZenohTransport.fetch

    def counted(self, name, parameters):
        asked.append(parameters)
        return fetch(self, name, parameters)

    monkeypatch.setattr(ZenohTransport, "fetch", counted)
    monkeypatch.setattr(follower_module, "SILENCE", 1000.0)
    rng = np.random.default_rng(5)
    with start_mapper(map={"resolution": 0.5}) as mapper:
        recorder = Recorder(mapper)
        with client_of(mapper, "zenoh") as client, client.follow(interval=1000.0) as follower:
            for sent in range(9):
                drive(mapper, rng, 1, sent)
                until(follower, sent + 1, recorder)
    assert asked[0] == {}
    assert len(asked) < 6  # seldom, if the mapper's first word came after a scan, or one was lost


@OVER
def test_a_closed_follower_tells_nothing_more(start_mapper, over):
    with start_mapper(map={"resolution": 0.5}) as mapper, client_of(mapper, over) as client:
        follower = client.follow(interval=0.02)
        thread = follower._thread
        follower.close()
        follower.close()
        assert not thread.is_alive()
        assert not follower.connected
        assert follower.wait(after=follower.version) is None
        with pytest.raises(ClientError, match="the follower is closed"):
            follower.next_grid(follower.version, math.inf)


FORGETFUL = """
import atexit, sys
from ogm_client import MapClient
atexit.register(lambda: print([follower.connected for follower in followers]))
client = MapClient(sys.argv[1], map_name="hall", timeout=30.0)
followers = [client.follow() for _ in range(2)]
"""


@OVER
def test_a_program_that_closes_nothing_closes_its_followers_at_its_end(start_mapper, over):
    """Else Zenoh may call into a Python that has ended, and prints how that fails."""
    with start_mapper(map={"resolution": 0.5}) as mapper:
        command = [sys.executable, "-c", FORGETFUL, address(mapper, over)]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=2 * PATIENCE, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "[False, False]\n", "")


@OVER
def test_a_follower_that_has_ended_keeps_nothing(start_mapper, over):
    """Neither its copy nor its subscription, whether somebody closes it or not."""
    with start_mapper(map={"resolution": 0.5}) as mapper:
        with client_of(mapper, over) as client:
            follower = client.follow(interval=0.02)
        with pytest.raises(ClientError):
            follower.wait(after=follower.version, timeout=PATIENCE)
        follower._thread.join(PATIENCE)
        left = weakref.ref(follower)
        del follower
        gc.collect()
        assert left() is None


@OVER
def test_a_client_that_is_closed_ends_its_followers(start_mapper, over):
    with start_mapper(map={"resolution": 0.5}) as mapper:
        with client_of(mapper, over) as client:
            follower = client.follow(interval=0.02)
        seen = follower.version
        with pytest.raises(ClientError):
            follower.wait(after=seen, timeout=PATIENCE)
        follower.close()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_bug_of_ours_keeps_nobody_waiting(start_mapper, monkeypatch):
    def fail(self, update, *, asked=False):
        raise ZeroDivisionError

    with (
        start_mapper(map={"resolution": 0.5}) as mapper,
        client_of(mapper, "http") as client,
        client.follow(interval=0.02) as follower,
    ):
        monkeypatch.setattr(MapCopy, "take", fail)
        with pytest.raises(ClientError, match="the thread that follows the map has failed"):
            follower.wait(after=follower.version, timeout=PATIENCE)
        assert not follower.connected


@OVER
def test_a_loop_that_is_left_leaves_no_thread(start_mapper, over):
    with start_mapper(map={"resolution": 0.5}) as mapper, client_of(mapper, over) as client:
        for grid in client.watch(0.02):
            assert grid.revision == 0
            break
        deadline = time.monotonic() + PATIENCE
        while any(thread.name == "ogm-follower" for thread in threading.enumerate()):
            assert time.monotonic() < deadline
            time.sleep(0.01)


@OVER
def test_watch_gives_up_after_its_patience(start_mapper, over):
    with start_mapper(map={"resolution": 0.5}) as mapper:
        client = client_of(mapper, over)
        maps = client.watch(interval=0.02, patience=0.5)
        assert next(maps).revision == 0
    with client, pytest.raises((NobodyAnswered, ClientError)):
        next(maps)
