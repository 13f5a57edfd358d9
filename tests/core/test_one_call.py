"""Scans that go into a map in one compiled call make the same map as those that go the long way."""

import math
from contextlib import suppress

import numpy as np
import pytest

from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.rate import Rate
from ogm_core.errors import LimitReached, OutsideBounds
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Clip, Region
from ogm_core.tiles.polygon import Polygon
from ogm_core.types import Pose, Scan, Sweep

SOME = Region(-6.0, -5.0, 6.0, 5.0)
MAPS = {
    "usual": {},
    "float64": {"cell_model": LogOdds("float64")},
    "true lines": {"traversal": "dda"},
    "bounds that clip": {"bounds": SOME},
    "bounds that drop": {"bounds": SOME, "outside": "drop"},
    "bounds that drop, true lines": {"bounds": SOME, "outside": "drop", "traversal": "dda"},
    "within a clip": {"clip": Clip(xmin=-64, ymin=-64, xmax=64, ymax=None)},
    "bounds and a clip": {"bounds": SOME, "clip": Clip(xmin=64, ymin=None, xmax=128, ymax=None)},
    "short reach": {"reach": 2.0, "clear_range": 1.0},
    "areas": {"sensor_model": "sector"},
    "areas, bounds that clip": {"sensor_model": "sector", "bounds": SOME},
    "areas, bounds and a clip": {"sensor_model": "sector", "bounds": SOME, "clip": Clip(xmin=64, xmax=128)},
    "areas, short reach": {"sensor_model": "sector", "reach": 2.0, "clear_range": 1.0},
    "counts": {"cell_model": Rate()},
    "counts, short reach": {"cell_model": Rate(), "reach": 2.0, "clear_range": 1.0},
    "counts, bounds that drop": {"cell_model": Rate(), "bounds": SOME, "outside": "drop"},
    "counts, bounds and a clip": {"cell_model": Rate(), "bounds": SOME, "clip": Clip(xmin=64, xmax=128)},
}


def scans(count, seed=1):
    """Scans of two sensors around the origin, some far out, with readings of every kind."""
    rng = np.random.default_rng(seed)
    for n in range(count):
        beams = (90, 61)[n % 2]
        ranges = rng.uniform(0.0, 4.0 if n % 7 else 9.0, beams).astype(np.float32)
        ranges[rng.random(beams) < 0.1] = rng.choice([np.inf, np.nan, 0.0, -1.0, 8.0])
        scan = Scan(n, -1.5, 0.06, 0.1, 8.0, ranges, reach=None if n % 5 else 3.0)
        yield scan, Pose(*rng.uniform(-2.0, 2.0, 2).tolist(), rng.uniform(-4.0, 4.0))


def moving(pose, beams):
    """The sweep of a sensor that drives 0.3 m, and turns, from this pose on."""
    way = np.linspace(0.0, 1.0, beams)[:, None] * (0.3, -0.1, 0.5)
    poses = np.array(pose) + way
    return Sweep(Pose(*poses[beams // 2].tolist()), poses)


def grids(**settings):
    """A map, and its twin, into which every scan goes the long way."""
    settings = GridSettings(**{"resolution": 0.05, "alpha": 0.1, **settings})
    grid, twin = OccupancyGrid(settings, "epoch"), OccupancyGrid(settings, "epoch")
    twin._one_call = None
    return grid, twin


def state(grid):
    """All that a scan changes."""
    snapshot = grid.snapshot()
    cells = {name: cells.tobytes() for name, cells in snapshot.stored.planes().items()}
    identity = grid.revision, grid.stamp, grid.cell_updates, grid.rect, grid.nbytes
    return identity, cells, grid._store.touched.tobytes()


@pytest.fixture
def taken(monkeypatch):
    """What one call made of each scan that was offered to it: the number of updates, or None."""
    found = []

    def spied(grid, placed):
        found.append(add(grid, placed))
        return found[-1]

    add = OccupancyGrid._add_at_once
    monkeypatch.setattr(OccupancyGrid, "_add_at_once", spied)
    return found


@pytest.mark.parametrize("name", MAPS)
def test_it_makes_the_map_of_the_long_way(name, taken):
    """Of sensors that stood still, and that moved."""
    grid, twin = grids(**MAPS[name])
    for number, (scan, pose) in enumerate(scans(60)):
        sweep = moving(pose, scan.ranges.size) if number % 3 == 0 else None
        assert grid.integrate(scan, pose, sweep) == twin.integrate(scan, pose, sweep)
    assert state(grid) == state(twin)
    assert sum(1 for updates in taken[::2] if updates) >= 30
    assert set(taken[1::2]) == {None}


def test_scans_that_tell_of_no_cell_within_a_clip_stretch_what_limits_count(taken):
    grid, twin = grids(clip=Clip(xmin=640))
    for scan, pose in scans(60):
        assert grid.integrate(scan, pose) == twin.integrate(scan, pose) == 0
        assert grid._extent.stretched == twin._extent.stretched
    assert (grid._extent.known, state(grid)) == (None, state(twin))
    assert taken[::2].count(0) > 40


def test_what_is_known_grows_in_one_call(taken):
    """From the second scan on: the first one finds no store."""
    grid, twin = grids()
    scan = Scan(0, 0.0, 0.1, 0.0, 8.0, np.array([3.0, 3.0], np.float32))
    for x in (0.0, 0.0, 0.2, -7.5, -7.5):
        for one in (grid, twin):
            one.integrate(scan, Pose(x, 0.0, 0.0))
        assert grid.rect == twin.rect
    assert [updates is not None for updates in taken[::2]] == [False, True, True, True, True]
    assert grid.rect.width == round((7.7 + 3.0) / 0.05)
    assert state(grid) == state(twin)


def test_a_store_that_is_too_small_grows_the_long_way(taken):
    grid, twin = grids()
    scan = Scan(0, 0.0, 0.1, 0.0, 8.0, np.array([3.0, 3.0], np.float32))
    for x in (0.0, 1000.0, 1000.0):
        for one in (grid, twin):
            one.integrate(scan, Pose(x, 0.0, 0.0))
    assert [updates is not None for updates in taken[::2]] == [False, False, True]
    assert state(grid) == state(twin)


def test_what_limits_count_grows_by_scans_of_which_a_clip_keeps_nothing():
    grid, twin = grids(clip=Clip(xmin=-64, ymin=-64, xmax=64, ymax=64))
    scan = Scan(0, 0.0, 0.1, 0.0, 8.0, np.array([3.0, 3.0], np.float32))
    for x in (0.0, 3.5, -3.5, -9.0):
        for one in (grid, twin):
            one.integrate(scan, Pose(x, 0.0, 0.0))
        assert (grid._extent.stretched, grid._extent.known) == (twin._extent.stretched, twin._extent.known)
    assert state(grid) == state(twin)


def test_a_scan_that_would_make_the_map_too_large_is_refused_as_ever():
    grid, twin = grids(max_cells=100_000)
    scan = Scan(0, 0.0, 0.05, 0.0, 8.0, np.full(120, 4.0, np.float32))
    for one in (grid, twin):
        one.integrate(scan, Pose(0.0, 0.0, 0.0))
        with pytest.raises(LimitReached, match=r"more than mapper\.max_cells = 100000"):
            one.integrate(scan, Pose(25.0, 0.0, 0.0))
    assert state(grid) == state(twin)


@pytest.mark.parametrize("changes", [{}, {"sensor_model": "sector"}, {"cell_model": Rate()}])
def test_a_pose_so_far_away_that_cells_cannot_be_counted_in_64_bits_is_refused_beside_a_clip(changes):
    grid, twin = grids(clip=Clip(xmin=-64, ymin=-64, xmax=64, ymax=64), **changes)
    scan = Scan(0, 0.0, 0.1, 0.0, 8.0, np.array([3.0, 3.0], np.float32))
    for one in (grid, twin):
        one.integrate(scan, Pose(0.0, 0.0, 0.0))
        with pytest.raises(LimitReached, match=r"more than mapper\.max_cells"):
            one.integrate(scan, Pose(2e8, 2e8, 0.0))
    assert grid._extent.stretched == twin._extent.stretched
    assert state(grid) == state(twin)


def test_beams_that_all_leave_bounds_are_refused_as_ever():
    grid, twin = grids(bounds=SOME, outside="drop")
    inside = Scan(0, -3.0, 0.1, 0.0, 20.0, np.full(60, 4.0, np.float32))
    outside = Scan(1, -3.0, 0.1, 0.0, 20.0, np.full(60, 15.0, np.float32))
    for one in (grid, twin):
        one.integrate(inside, Pose(0.0, 0.0, 0.0))
        with pytest.raises(OutsideBounds, match="all 60 beams"):
            one.integrate(outside, Pose(0.0, 0.0, 0.0))
    assert state(grid) == state(twin)


def test_memory_is_limited_as_ever(taken):
    """A map that has bytes for a few tiles takes what fits, refuses the rest, and is the same."""
    grid, twin = grids()
    for one in (grid, twin):
        one.integrate(Scan(0, 0.0, math.pi / 2, 0.0, 30.0, np.full(4, 20.0, np.float32)), Pose(0.0, 0.0, 0.0))
        one.max_bytes = one.nbytes + 3 * one._store.tile_bytes
    refused = []
    for scan, pose in scans(40):
        for one in (grid, twin):
            refused.append(True)
            with suppress(LimitReached):
                one.integrate(scan, pose)
                refused[-1] = False
    assert refused[::2] == refused[1::2]
    assert True in refused
    assert False in refused
    assert state(grid) == state(twin)


def test_a_scan_that_may_be_too_large_is_counted_the_long_way(taken):
    grid, _ = grids(max_scan_cells=1000)
    few, many = (Scan(0, 0.0, 0.01, 0.0, 30.0, np.full(n, 4.0, np.float32)) for n in (1, 20))
    for scan in (few, few, many):
        with suppress(LimitReached):
            grid.integrate(scan, Pose(0.0, 0.0, 0.0))
    assert [updates is not None for updates in taken] == [False, True, False]
    assert grid.revision == 2


def test_what_was_erased_stretches_the_map_again(taken):
    grid, twin = grids()
    scan = Scan(0, 0.0, 0.05, 0.0, 8.0, np.full(60, 3.0, np.float32))
    for one in (grid, twin):
        one.integrate(scan, Pose(0.0, 0.0, 0.0))
        one.erase(Polygon([(-9.0, 1.0), (9.0, 1.0), (9.0, 9.0), (-9.0, 9.0)], one.lattice))
        one.integrate(scan, Pose(0.0, 0.0, 0.0))
    assert state(grid) == state(twin)
    assert grid.rect.height > 40


@pytest.mark.parametrize(
    "changes",
    [
        {"sensor_model": "sector", "cell_model": LogOdds("float64")},
        {"sensor_model": "sector", "bounds": SOME, "outside": "drop"},
        {"half_life": 60.0},
        {"cell_model": Rate(), "separate_robots": True},
    ],
    ids=",".join,
)
def test_other_maps_have_no_such_way(changes):
    grid, _ = grids(**changes)
    assert grid._one_call is None


def test_a_sweep_that_leaves_what_can_be_addressed_is_refused_as_ever():
    grid, twin = grids()
    scan = Scan(0, 0.0, 0.05, 0.0, 8.0, np.full(60, 3.0, np.float32))
    away = moving(Pose(0.0, 0.0, 0.0), 60)
    away.beams[30, 0] = 1e18
    for one in (grid, twin):
        one.integrate(scan, Pose(0.0, 0.0, 0.0))
        with pytest.raises(LimitReached, match="farther away"):
            one.integrate(scan, Pose(0.0, 0.0, 0.0), away)
    assert state(grid) == state(twin)


def test_more_kinds_of_scan_than_are_remembered(taken):
    grid, twin = grids()
    for n in range(200):
        scan = Scan(n, 0.0, 0.05, 0.0, 8.0 + n, np.full(60, 3.0, np.float32))
        assert grid.integrate(scan, Pose(0.0, 0.0, 0.0)) == twin.integrate(scan, Pose(0.0, 0.0, 0.0))
    assert len(grid._one_call._sensors) <= 64
    assert sum(1 for updates in taken[::2] if updates) == 199
    assert state(grid) == state(twin)
