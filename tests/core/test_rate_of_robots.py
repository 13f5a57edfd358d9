"""Counts of several sensors and robots: by the settings of their sensors, and in any order of arrival."""

import math
from dataclasses import replace

import numpy as np
import pytest

import naive_rate
from naive_rate import assert_planes
from ogm_core.cells.rate import Rate
from ogm_core.files.map_files import encode_npz
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.placing.sensor_rules import SensorRule, SensorRules
from ogm_core.types import Pose, PoseStamped, Scan

SECOND = 10**9
SETTINGS = GridSettings(resolution=0.1, cell_model=Rate(), reach=7.0)
BEAMS = 120


def scan_of(rng, stamp, **fields):
    ranges = rng.uniform(0.05, 10.0, BEAMS).astype(np.float32)
    ranges[rng.random(BEAMS) < 0.2] = math.inf
    ranges[rng.random(BEAMS) < 0.05] = math.nan
    return Scan(stamp, -math.pi, math.tau / BEAMS, 0.1, 8.0, ranges, **fields)


def with_ranges(scan, change, **fields):
    """A scan each of whose ranges, as a float, is changed, and other fields."""
    changed = np.array([change(r) for r in scan.ranges.tolist()], np.float32)
    return replace(scan, ranges=changed, **fields)


RULES = {
    "beyond": ({"beyond": "clear"}, lambda s: with_ranges(s, lambda r: math.inf if r > 8.0 else r)),
    "range_max": ({"range_max": 5.0}, lambda s: replace(s, range_max=5.0)),
    "range_max, beyond": (
        {"range_max": 5.0, "beyond": "clear"},
        lambda s: with_ranges(s, lambda r: math.inf if r > 5.0 else r, range_max=5.0),
    ),
    "range_min": ({"range_min": 2.0}, lambda s: with_ranges(s, lambda r: math.nan if r < 2.0 else r)),
    "ignore_no_return": (
        {"ignore_no_return": True},
        lambda s: with_ranges(s, lambda r: math.nan if r >= 8.0 else r),
    ),
    "reach": ({"reach": 3.0}, lambda s: replace(s, reach=3.0)),
    "clear_range": ({"clear_range": 2.0}, lambda s: replace(s, clear_range=2.0)),
    "upside_down": (
        {"upside_down": True},
        lambda s: replace(s, angle_min=math.pi, angle_increment=-math.tau / BEAMS),
    ),
}


@pytest.mark.parametrize(("rule", "meant"), RULES.values(), ids=RULES)
def test_a_sensors_settings_are_those_of_its_beams(rule, meant):
    """The other sensor's scans are as they say; the reach of a sensor comes before that of the map."""
    rules = SensorRules([SensorRule("r1/front", **rule)])
    rng, grid, twin = np.random.default_rng(3), OccupancyGrid(SETTINGS, "e"), naive_rate.Counts(SETTINGS)
    for k in range(3):
        for sensor in ("front", "rear"):
            scan, pose = scan_of(rng, k), Pose(*rng.uniform(-3.0, 3.0, 3))
            grid.integrate(rules.read(f"r1/{sensor}", scan), pose)
            said = meant(scan) if sensor == "front" else scan
            twin.integrate(said, pose)
            assert said is scan or sum(1 for _ in naive_rate.beams(said, pose, SETTINGS)) > 20
    assert_planes(grid, twin)


def drive(rng, robot, start):
    """Messages of a robot that drives and turns, whose scans are taken beam by beam, in order."""
    found = []
    for k in range(12):
        stamp = 1_000 * SECOND + k * SECOND // 10
        pose = Pose(start + 0.13 * k, 0.2 * start - 0.07 * k, 0.1 * start + 0.05 * k)
        found.append((robot, PoseStamped(stamp, pose, seq=k, run="run")))
        if k < 10:
            fields = {"seq": k, "run": "run", "time_increment": 0.0005, "mount": Pose(0.2, 0.1, 0.3)}
            found.append((robot, scan_of(rng, stamp + SECOND // 50, **fields)))
    return found


def interleaved(rng, drives):
    """Messages of all robots, each robot's in its order."""
    left = [list(messages) for messages in drives]
    while any(left):
        messages = left[rng.choice([n for n, messages in enumerate(left) if messages])]
        yield messages.pop(0)


def mapped(settings, messages):
    grid = OccupancyGrid(settings, "e")
    placer = ScanPlacer(grid, Receipts(), lambda *_: None)
    for robot, message in messages:
        if isinstance(message, Scan):
            placer.add_scan(robot, "laser", message)
        else:
            placer.add_pose(robot, message)
    placer.finish()
    return grid


@pytest.mark.parametrize(
    "changes", [{}, {"bounds": Region(-4.0, -5.0, 6.0, 4.5)}], ids=["unbounded", "bounded"]
)
def test_the_order_between_robots_does_not_matter(changes):
    settings, rng = replace(SETTINGS, **changes), np.random.default_rng(5)
    drives = [drive(rng, f"r{n}", start) for n, start in enumerate((-3.0, 0.0, 2.5))]
    one_by_one = mapped(settings, [message for messages in drives for message in messages])
    wanted = encode_npz(one_by_one.snapshot().finest())
    assert one_by_one.revision == 30
    for _ in range(4):
        grid = mapped(settings, interleaved(rng, drives))
        assert encode_npz(grid.snapshot().finest()) == wanted
    alone = mapped(settings, [message for messages in drives[1:] for message in messages])
    assert encode_npz(alone.snapshot().finest()) != wanted
