"""A map that is saved under a name outlives what comes after it: mapping, a restore, a kill, a new start."""

import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from ogm_client import MapClient, RobotPublisher
from ogm_core.grid import OccupancyGrid
from ogm_core.tiles.polygon import Polygon
from ogm_core.types import Pose, Scan
from ogm_services.settings.settings import Settings

SWEEP = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.0, "range_max": 9.0}
STAMP = 10**18
RATE = 40.0


def scan_of(k):
    """Ranges, pose and stamp of scan k."""
    ranges = np.random.default_rng(k).uniform(0.5, 8.5, 63).astype(np.float32)
    return ranges, (0.11 * k, 0.05 * k, 0.3 * k), STAMP + int(k * 1e9 / RATE)


def drive(mapper, eventually, first, last, run):
    """Publish scans first to last, and wait until they are in the map."""
    before = mapper.status()["scans"]["integrated"]
    with RobotPublisher("r1", address=mapper.endpoint, run=run, reliable=True) as robot:
        robot.wait_for_mapper(30.0)
        for k in range(first, last):
            ranges, pose, stamp = scan_of(k)
            robot.publish_scan(ranges, **SWEEP, pose=pose, stamp=stamp)
        eventually(lambda: mapper.status()["scans"]["integrated"] == before + last - first)


def map_of(scans):
    """The map that these scans make."""
    grid = OccupancyGrid(Settings().grid_settings(), "e")
    for k in scans:
        add(grid, k)
    return grid


def add(grid, k):
    """Integrate scan k."""
    ranges, pose, stamp = scan_of(k)
    grid.integrate(Scan(ranges=ranges, stamp=stamp, **SWEEP), Pose(*pose))


def same(grid, expected):
    """A served map is this one, value for value."""
    snapshot = expected.snapshot()
    _, known = snapshot.published()
    cells = np.where(known, snapshot.log_odds(), np.nan).astype(np.float32)
    np.testing.assert_array_equal(grid.log_odds, cells)
    assert (grid.offset, grid.revision, grid.stamp) == (snapshot.offset, snapshot.revision, snapshot.stamp)


@pytest.mark.parametrize("over", ["zenoh", "http"])
def test_what_is_erased_stays_so_after_a_kill_right_after_the_answer(ogm, eventually, tmp_path, over):
    """Equal cells, and scans of a robot that goes on fall where they would have fallen."""
    data = tmp_path / "data"
    mapper = ogm.ready(ogm.mapper("--data", data))
    corners = [(-3.0, -2.5), (5.0, -1.0), (0.5, 6.0), (1.0, 1.0)]

    def client():
        return MapClient(mapper.endpoint if over == "zenoh" else mapper.url, timeout=60.0)

    drive(mapper, eventually, 0, 20, "first")
    expected = map_of(range(20))
    erased = expected.erase(Polygon(corners, expected.lattice))
    with client() as asks:
        first = asks.get_map()
        assert asks.erase(polygon=corners) == erased > 1000
        mapper.command.process.send_signal(signal.SIGKILL)
    mapper.command.process.wait()

    mapper = ogm.ready(ogm.mapper("--data", data))
    with client() as asks:
        again = asks.get_map()
        same(again, expected)
        assert (again.epoch, again.revision, again.run != first.run) == (first.epoch, 21, True)
        drive(mapper, eventually, 20, 30, "second")
        for k in range(20, 30):
            add(expected, k)
        same(asks.get_map(), expected)
        assert asks.quality()["scans"] == 30
    assert mapper.command.stop().code == 0


@pytest.mark.parametrize("over", ["zenoh", "http"])
def test_a_restored_map_is_there_after_a_kill_right_after_the_answer(ogm, eventually, tmp_path, over):
    data = tmp_path / "data"
    mapper = ogm.ready(ogm.mapper("--data", data))

    def client():
        return MapClient(mapper.endpoint if over == "zenoh" else mapper.url, timeout=60.0)

    drive(mapper, eventually, 0, 20, "first")
    with client() as asks:
        first = asks.get_map()
        same(first, map_of(range(20)))
        saved = asks.save_snapshot("noon")
        assert (saved.epoch, saved.run, saved.revision) == (first.epoch, first.run, 20)
        drive(mapper, eventually, 20, 35, "second")
        same(asks.get_map(), map_of(range(35)))
        then = asks.get_map(at="noon")
        same(then, map_of(range(20)))
        assert (then.epoch, then.run) == (first.epoch, first.run)
        asks.restore_snapshot("noon")
    mapper.command.process.send_signal(signal.SIGKILL)
    mapper.command.process.wait()

    mapper = ogm.ready(ogm.mapper("--data", data))
    with client() as asks:
        again = asks.get_map()
        same(again, map_of(range(20)))
        assert again.epoch != first.epoch
        assert again.run != first.run
        drive(mapper, eventually, 40, 50, "third")
        same(asks.get_map(), map_of([*range(20), *range(40, 50)]))
        then = asks.get_map(at="noon")
        same(then, map_of(range(20)))
        assert (then.epoch, then.run) == (first.epoch, first.run)
        # What was decided before the restore is not asked for again, nor taken twice.
        before = mapper.status()["scans"]["integrated"]
        with RobotPublisher("r1", address=mapper.endpoint, run="second", reliable=True) as robot:
            robot.wait_for_mapper(30.0)
            robot.publish_scan(scan_of(20)[0], **SWEEP, pose=scan_of(20)[1], stamp=scan_of(20)[2])
            eventually(lambda: mapper.status()["scans"]["dropped"]["duplicate"] == 1)
        assert mapper.status()["scans"]["integrated"] == before
        asks.delete_snapshot("noon")
        assert asks.snapshots() == []
    assert mapper.command.stop().code == 0


@pytest.mark.parametrize("over", ["zenoh", "http"])
def test_a_watch_sees_a_restore_and_a_new_start_of_a_mapper_that_stores_its_map(
    ogm, endpoint, eventually, tmp_path, over
):
    """Epoch and revision are those of before then: the run alone tells that it may be another map."""
    flags = ["--data", tmp_path / "data", "--listen", endpoint]
    first = ogm.ready(ogm.mapper(*flags))
    port = first.url.rstrip("/").rpartition(":")[2]
    drive(first, eventually, 0, 5, "first")
    with MapClient(endpoint if over == "zenoh" else first.url) as client, ThreadPoolExecutor(1) as pool:
        client.save_snapshot("noon")
        maps = client.watch(interval=0.02)
        seen = next(maps)
        waiting = pool.submit(next, maps)
        client.restore_snapshot("noon")
        restored = waiting.result(timeout=60.0)
        assert (restored.run, restored.revision) == (seen.run, 5)
        assert restored.epoch != seen.epoch
        waiting = pool.submit(next, maps)
        first.command.process.send_signal(signal.SIGKILL)
        first.command.process.wait()
        ogm.ready(ogm.mapper(*flags, "--http-port", port))
        again = waiting.result(timeout=60.0)
    assert (again.epoch, again.revision) == (restored.epoch, 5)
    assert again.run != restored.run
    for grid in (restored, again):
        np.testing.assert_array_equal(grid.log_odds, seen.log_odds)


class Drive(threading.Thread):
    """A robot at 40 Hz, poses and scans on keys of their own, that keeps all it has published."""

    def __init__(self, endpoint, scans):
        super().__init__()
        self._robot = RobotPublisher("r1", address=endpoint, run="drive", cache_samples=5000)
        self._scans = scans
        self.sent = 0
        self.finish = threading.Event()

    def run(self):
        began = time.monotonic()
        for k in range(self._scans):
            ranges, pose, stamp = scan_of(k)
            self._robot.publish_pose(*pose, stamp=stamp)
            self._robot.publish_scan(ranges, **SWEEP, stamp=stamp)
            self.sent += 1
            time.sleep(max(0.0, began + (k + 1) / RATE - time.monotonic()))
        self.finish.wait(120.0)
        self._robot.close()


def test_a_restore_and_a_kill_amid_a_drive_lose_and_double_nothing(ogm, endpoint, eventually, tmp_path):
    """The map is the one that was saved, and all scans after the restore: those while it was away, too."""
    scans, flags = 240, ["--listen", endpoint, "--data", tmp_path / "data"]
    mapper = ogm.ready(ogm.mapper(*flags))
    drive = Drive(endpoint, scans)
    drive.start()
    try:
        with MapClient(mapper.url, timeout=60.0) as client:
            eventually(lambda: mapper.status()["revision"] >= 50, 60.0)
            saved = client.save_snapshot("a")
            eventually(lambda: mapper.status()["revision"] >= saved.revision + 50, 60.0)
            before = mapper.status()["scans"]["integrated"]
            client.restore_snapshot("a")
            sent = drive.sent
        mapper.command.process.send_signal(signal.SIGKILL)
        mapper.command.process.wait()
        mapper = ogm.ready(ogm.mapper(*flags))

        def done():
            source = mapper.status()["robots"].get("r1", {}).get("sources", {}).get("laser")
            return source and source["last_seq"] == scans - 1 and not source["pending"]

        eventually(done, 60.0)
        status = mapper.status()
        with MapClient(mapper.url, timeout=60.0) as client:
            served = client.get_map()
    finally:
        drive.finish.set()
        drive.join()
    after = status["revision"] - saved.revision
    assert scans - sent - 1 <= after <= scans - before
    assert (status["scans"]["lost"], status["scans"]["dropped"]["no_pose"]) == (0, 0)
    same(served, map_of([*range(saved.revision), *range(scans - after, scans)]))
