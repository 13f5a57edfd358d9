"""A robot is left out while others map, and the mapper is killed: the map is that of what is left."""

import json
import signal
import threading
import urllib.request
from contextlib import suppress

import numpy as np

from ogm_client import MapClient, RobotPublisher
from ogm_core.grid import OccupancyGrid
from ogm_core.types import Pose, Scan
from ogm_services.settings.settings import Settings

SWEEP = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.0, "range_max": 9.0}
STAMP = 10**18
PERIOD = 0.025
FLAGS = ("--cell-model", "rate", "--separate-robots")


def scan_of(robot, k):
    """Ranges, pose and stamp of a robot's scan k: both drive through the same place."""
    ranges = np.random.default_rng([ord(robot), k]).uniform(0.5, 4.5, 63).astype(np.float32)
    return ranges, (np.cos(k / 9), np.sin(k / 9), 0.3 * k), STAMP + int(k * PERIOD * 1e9)


class Driving:
    """A robot that publishes a scan every PERIOD while it is not paused, whatever becomes of the mapper.

    Its publisher remembers its messages, and is there until it is closed.
    """

    def __init__(self, endpoint, name):
        self.published = 0
        self.name = name
        self._ending = threading.Event()
        self._going, self._publishing = True, threading.Lock()
        self._thread = threading.Thread(target=self._run, args=(endpoint,))
        self._thread.start()

    def _run(self, endpoint):
        with RobotPublisher(self.name, address=endpoint, run="first", reliable=True) as robot:
            robot.wait_for_mapper(60.0)
            while not self._ending.wait(PERIOD):
                with self._publishing:
                    if self._going:
                        ranges, pose, stamp = scan_of(self.name, self.published)
                        robot.publish_scan(ranges, **SWEEP, pose=pose, stamp=stamp)
                        self.published += 1

    def pause(self, eventually, mapper):
        """Have it stand still, and its last scan decided; how many it has published."""
        with self._publishing:
            self._going = False

        def last_seq():
            source = mapper.status()["robots"].get(self.name, {}).get("sources", {}).get("laser", {})
            return source.get("last_seq")

        eventually(lambda: last_seq() == self.published - 1)
        return self.published

    def go_on(self):
        self._going = True

    def stop(self):
        self._ending.set()
        self._thread.join(60.0)


def forget(mapper, robot):
    """Leave a robot out; what is answered."""
    request = urllib.request.Request(f"{mapper.url}robots/{robot}", method="DELETE")
    with urllib.request.urlopen(request, timeout=60) as response:
        return json.loads(response.read())


def kill(mapper):
    mapper.command.process.send_signal(signal.SIGKILL)
    mapper.command.process.wait()


def assert_map_of(endpoint, scans):
    """The map is that of these scans, (robot, k), cell for cell."""
    grid = OccupancyGrid(Settings(map={"cell_model": "rate"}).grid_settings(), "e")
    for robot, k in scans:
        ranges, pose, stamp = scan_of(robot, k)
        grid.integrate(Scan(ranges=ranges, stamp=stamp, **SWEEP), Pose(*pose))
    expected = grid.snapshot().finest()
    _, known = expected.published()
    cells = np.where(known, expected.log_odds(), np.nan).astype(np.float32)
    with MapClient(endpoint, timeout=60.0) as client:
        found = client.get_map()
    assert found.offset == expected.offset
    np.testing.assert_array_equal(np.isnan(found.log_odds), ~known)
    np.testing.assert_allclose(found.log_odds, cells, rtol=1e-6)


def test_it_is_the_map_of_the_others_and_of_what_the_robot_has_seen_since(
    ogm, endpoint, eventually, tmp_path
):
    flags = ["--data", tmp_path / "data", "--listen", endpoint, *FLAGS]
    mapper = ogm.ready(ogm.mapper(*flags))
    a, b = Driving(endpoint, "a"), Driving(endpoint, "b")
    try:
        eventually(lambda: mapper.status()["revision"] >= 60)
        since = b.pause(eventually, mapper)
        forgotten = forget(mapper, "b")
        assert forgotten["robots"] == ["a"]
        kill(mapper)
        mapper = ogm.ready(ogm.mapper(*flags))
        assert mapper.status()["map_info"]["robots"] == ["a"]
        eventually(lambda: mapper.status()["revision"] >= forgotten["revision"] + 20)
        count = a.pause(eventually, mapper)
        eventually(lambda: mapper.status()["revision"] == count + since + 1)
        # What b's publisher remembers was decided: none of it has come back.
        assert_map_of(endpoint, [("a", k) for k in range(count)])
        b.go_on()
        eventually(lambda: b.published >= since + 20)
        until = b.pause(eventually, mapper)
        eventually(lambda: mapper.status()["revision"] == count + until + 1)
        left = [("a", k) for k in range(count)]
        seen = [("b", k) for k in range(since, until)]
        assert_map_of(endpoint, left + seen)
        with suppress(OSError):  # whatever comes first: the map's robots say which it was
            threading.Timer(0.002, kill, [mapper]).start()
            forget(mapper, "b")
        mapper.command.process.wait()
        mapper = ogm.ready(ogm.mapper(*flags))
        # Before the map was stored, or after: what it lacks of b's scans comes from b's publisher.
        eventually(lambda: mapper.status()["revision"] >= count + until + 1)
        there, revision = mapper.status()["map_info"]["robots"], mapper.status()["revision"]
        assert (there, revision) in ((["a"], count + until + 2), (["a", "b"], count + until + 1))
        assert_map_of(endpoint, left + seen * ("b" in there))
    finally:
        a.stop()
        b.stop()
    assert mapper.command.stop().code == 0
