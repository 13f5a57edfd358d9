"""Robots that see each other while their mapper is killed: the cells are those of a mapper that never was.

Where a robot is skipped, what it does depends on the poses of all; what was missed comes robot by robot.
"""

import math
import signal
import threading
from contextlib import ExitStack

import numpy as np

from ogm_client import RobotPublisher
from ogm_client.session import NetworkConfig, open_session, resolve_listen
from ogm_core.files.map_files import encode_npz, read_npz
from ogm_core.grid import OccupancyGrid
from ogm_core.placing.other_robots import OtherRobots
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.robot_rules import RobotRule, RobotRules
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.sensor_models.hits import hits_at_robots
from ogm_core.types import Pose, PoseStamped, Scan
from ogm_services.settings.settings import Settings
from tests.soak.services import Mapper

T0 = 1_700_000_000_000_000_000
PERIOD = 0.05
ROBOTS = 3
RADIUS = 0.5
AWAY = 3.0
"""s; what robots are skipped by is not older than half a second."""
ALONE = 40
"""Scans of each robot before it sees another one: each must have said where it is."""
SWEEP = {"angle_min": 0.0, "angle_increment": math.pi / 2, "range_min": 0.1, "range_max": 8.0}


def stamp(number):
    return T0 + round(number * PERIOD * 1e9)


def place(robot):
    """Robots stand in a row, 2 m apart."""
    return Pose(2.0 * robot, 0.0, 0.0)


def ranges(robot, number):
    """To the east and the west a robot sees its neighbours, to the north a wall."""
    sees = number >= ALONE
    east, west = sees and robot < ROBOTS - 1, sees and robot > 0
    return [1.8 if east else math.inf, 3.0, 1.8 if west else math.inf]


class Fleet:
    """Robots that publish until `stop`, from a thread."""

    def __init__(self, endpoint, opening):
        session = opening.enter_context(
            open_session(NetworkConfig(connect=(endpoint,), connect_timeout=60.0))
        )
        self.sent = 0
        """Scans of each."""
        self._robots = [
            opening.enter_context(RobotPublisher(f"robot{n}", session=session, run="a", cache_samples=10_000))
            for n in range(ROBOTS)
        ]
        self._robots[0].wait_for_mapper(60.0)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._drive)
        opening.callback(self.stop)
        self._thread.start()

    def stop(self):
        self._stopping.set()
        self._thread.join()

    def _drive(self):
        while not self._stopping.wait(PERIOD):
            at = stamp(self.sent)
            for n, robot in enumerate(self._robots):
                robot.publish_pose(*place(n), stamp=at)
            for n, robot in enumerate(self._robots):
                robot.publish_scan(ranges(n, self.sent), **SWEEP, sensor="laser", stamp=at)
            self.sent += 1


def uninterrupted(count):
    """The map of so many scans of each robot."""
    settings = Settings()
    grid = OccupancyGrid(settings.grid_settings(), "again")
    others = OtherRobots(RobotRules([RobotRule("*", RADIUS)]), hits_at_robots(grid.settings))
    placer = ScanPlacer(grid, Receipts(), lambda *_: None, settings.placing_rules(), other_robots=others)
    for number in range(count):
        for n in range(ROBOTS):
            placer.add_pose(f"robot{n}", PoseStamped(stamp(number), place(n), number, "a"))
        for n in range(ROBOTS):
            measured = np.array(ranges(n, number), np.float32)
            placer.add_scan(
                f"robot{n}", "laser", Scan(stamp(number), ranges=measured, **SWEEP, seq=number, run="a")
            )
    return read_npz(encode_npz(grid.snapshot()))


def test_a_mapper_that_is_killed_again_and_again_has_the_cells_of_one_that_never_was(tmp_path, eventually):
    endpoint = resolve_listen("tcp/127.0.0.1:0")
    mapper = Mapper(endpoint, tmp_path / "data", "listen", {"robot": f"robot*:radius={RADIUS}"})
    with ExitStack() as opening:
        opening.enter_context(mapper).wait_until_ready()
        fleet = Fleet(endpoint, opening)
        for _ in range(2):
            begun = fleet.sent
            eventually(lambda begun=begun: mapper.status()["revision"] > ROBOTS * (begun + ALONE), 120.0)
            killed = fleet.sent
            mapper.end(signal.SIGKILL)
            eventually(lambda killed=killed: fleet.sent > killed + AWAY / PERIOD, 120.0)
            mapper.start()
            mapper.wait_until_ready()
        begun = fleet.sent
        eventually(lambda: fleet.sent > begun + ALONE, 120.0)
        fleet.stop()
        eventually(lambda: mapper.status()["revision"] >= ROBOTS * fleet.sent, 120.0)
        status, (served, revision) = mapper.status(), mapper.map()
        assert revision == ROBOTS * fleet.sent
        assert status["scans"]["beams_on_robots"] > 0
        found, wanted = read_npz(served), uninterrupted(fleet.sent)
        assert found.offset == wanted.offset
        np.testing.assert_array_equal(found.log_odds, wanted.log_odds)
        assert np.count_nonzero(wanted.log_odds > 0.0) == ROBOTS  # the walls
