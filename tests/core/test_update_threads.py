"""Update threads: whoever updates the cells of a scan, they are those that one thread makes, bit for bit."""

import math
import threading
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from counts_model import Counts
from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.rate import Rate
from ogm_core.errors import LimitReached, OutsideBounds
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Clip, Region
from ogm_core.sensor_models import bresenham, dda, passing, spans, update_threads
from ogm_core.sensor_models.evidence import observe
from ogm_core.sensor_models.strip_work import even_cuts
from ogm_core.sensor_models.update_threads import UpdateThreads
from ogm_core.separate_grid import grid_of as map_of
from ogm_core.tiles.store import TileStore
from ogm_core.types import PlacedScan, Pose, Scan, Sweep

SECOND = 10**9
KINDS = {
    "bresenham": {},
    "bresenham float64": {"cell_model": LogOdds("float64")},
    "dda": {"traversal": "dda"},
    "dda float64": {"traversal": "dda", "cell_model": LogOdds("float64")},
    "sector": {"sensor_model": "sector"},
    "sector float64": {"sensor_model": "sector", "cell_model": LogOdds("float64")},
    "rate": {"cell_model": Rate()},
    "planes of its own": {"cell_model": Counts()},
    "robots apart": {"cell_model": Rate(), "separate_robots": True},
    "half-life": {"half_life": 20.0},
    "rate, half-life": {"cell_model": Rate(), "half_life": 5.0},
    "clip": {"clip": Clip(-64, None, 64, None)},
    "bounds": {"bounds": Region(-20.0, -15.0, 30.0, 20.0)},
    "bounds drop": {"bounds": Region(-20.0, -15.0, 30.0, 20.0), "outside": "drop", "cell_model": Rate()},
}


def scans(count, seed=5, beams=90):
    """Of a robot that strays over many tiles on both sides of the anchor; some were taken while it drove."""
    rng = np.random.default_rng(seed)
    x, y = 0.013, 0.007
    for k in range(count):
        x, y = (0.8 * x, 0.8 * y) if rng.random() < 0.2 else (x + rng.normal(0, 5), y + rng.normal(0, 4))
        ranges = rng.uniform(0.5, 25.0, beams).astype(np.float32)
        pose = Pose(x, y, rng.uniform(-4, 4))
        scan = Scan(k * SECOND, -math.pi, math.tau / beams, 0.1, 24.0, ranges)
        driven = np.array([pose]) + np.linspace(0.0, 0.3, beams)[:, None] * (1.0, 0.5, 0.2)
        yield PlacedScan(scan, pose, Sweep(pose, driven) if k % 5 == 4 else None)


def grid_of(**changes):
    """A map into which every scan goes the long way; those that go in one call: see test_team."""
    grid = map_of(GridSettings(**{"resolution": 0.25, "alpha": 0.5, **changes}), "e", "r")
    grid._one_call = None
    return grid


def map_scans(grid, placed_scans):
    """Which scans the map took."""
    taken = []
    for placed in placed_scans:
        try:
            grid.integrate(*placed)
        except OutsideBounds:
            taken.append(False)
        else:
            taken.append(True)
    return taken


def contents(grid):
    """All that a map holds and tells of itself, bit for bit."""
    tiles = {
        (tile.tx, tile.ty): (tile.revision, {name: cells.tobytes() for name, cells in tile.planes.items()})
        for tile in grid.checkpoint().tiles_since(0)
    }
    return tiles, grid.rect, grid.revision, grid.stamp, grid.cell_updates, grid.nbytes


@pytest.fixture
def shared(monkeypatch):
    """How many parts each scan had that was shared; every one that can be is."""
    monkeypatch.setattr(update_threads, "_LONGEST_REST", 0)
    parts, scan = [], update_threads._Scan

    def noted(*arguments):
        parts.append(len(arguments[-1]) - 1)
        return scan(*arguments)

    monkeypatch.setattr(update_threads, "_Scan", noted)
    return parts


def update_threads_alive():
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("ogm-update-")]


@pytest.mark.parametrize("count", [1, 2, 3, 5])
@pytest.mark.parametrize("kind", KINDS)
def test_the_map_is_that_of_one_thread(kind, count, shared):
    one, many = grid_of(**KINDS[kind]), grid_of(**KINDS[kind])
    number = 6 if kind == "planes of its own" else 40
    taken = map_scans(one, scans(number))
    assert sum(taken) > number / 3
    with UpdateThreads(count, least_cells=1) as many.threads:
        assert map_scans(many, scans(number)) == taken
    assert contents(many) == contents(one)
    if count > 1:
        assert max(shared) >= min(count, 3)
        assert len(shared) >= sum(taken) * 0.8
    else:
        assert not shared


@pytest.mark.parametrize("kind", ["bresenham", "dda", "sector", "rate", "planes of its own"])
def test_every_tile_that_few_beams_meet_is_marked_and_counted_once(kind, shared):
    """In a new map every tile is fresh, and both sides of a cut find it so."""
    for seed in range(20):
        one, many = grid_of(resolution=0.1, **KINDS[kind]), grid_of(resolution=0.1, **KINDS[kind])
        placed = list(scans(2, seed, beams=15))
        map_scans(one, placed)
        with UpdateThreads(3, least_cells=1) as many.threads:
            map_scans(many, placed)
        assert contents(many) == contents(one)
    assert min(shared) >= 2


@pytest.mark.parametrize("settings", [{}, {"traversal": "dda"}, {"sensor_model": "sector"}])
def test_small_scans_start_no_thread(settings):
    grid = grid_of(resolution=0.05, **settings)
    with UpdateThreads(2) as grid.threads:
        map_scans(grid, scans(5))
        assert grid.cell_updates > 5 * 1000
        assert not update_threads_alive()


def test_scans_that_are_large_enough_start_threads_and_close_ends_them(shared):
    grid = grid_of(resolution=0.02)
    with UpdateThreads(2) as grid.threads:
        map_scans(grid, scans(3, beams=600))
        assert shared == [2, 2, 2]
        assert update_threads_alive() == ["ogm-update-1"]
        grid.threads.close()
        assert not update_threads_alive()
        map_scans(grid, scans(1, beams=600))
        assert update_threads_alive() == ["ogm-update-1"]
    assert not update_threads_alive()


class Failing(LogOdds):
    """A model whose update first asks whether it may."""

    ask = staticmethod(lambda *_: None)

    def update(self, evidence, store, window, revision):
        self.ask(window, revision)
        return super().update(evidence, store, window, revision)


@pytest.fixture
def asking(monkeypatch):
    """Says what updates ask from now on; without it, nothing."""
    return lambda ask=lambda *_: None: monkeypatch.setattr(Failing, "ask", staticmethod(ask))


def test_a_part_that_failed_is_updated_after_all(shared, asking):
    asked = []

    def once(window, revision):
        asked.append((window, revision))
        if asked.count((window, revision)) == 1 and len(asked) % 2:
            raise MemoryError

    one, many = grid_of(), grid_of(cell_model=Failing())
    asking(once)
    with UpdateThreads(3, least_cells=1) as many.threads:
        map_scans(one, scans(10))
        map_scans(many, scans(10))
    assert shared == [3] * 10
    assert len(asked) > 30
    assert contents(many) == contents(one)


def test_a_scan_that_is_in_a_part_of_the_map_only_is_no_silent_matter(shared, asking):
    grid, windows = grid_of(cell_model=Failing()), set()
    (placed,) = scans(1)

    def last(window, _):
        if window.ix == max(windows):
            raise MemoryError

    asking(lambda window, _: windows.add(window.ix))
    with UpdateThreads(2, least_cells=1) as grid.threads:
        grid.integrate(*placed)
        asking(last)
        with pytest.raises(RuntimeError, match="in a part of the map only"):
            grid.integrate(*placed)
        assert not update_threads_alive()
    assert shared == [2, 2]


def test_a_scan_of_which_every_part_fails_is_refused_and_changes_nothing(shared, asking):
    one, many = grid_of(), grid_of(cell_model=Failing())
    placed = list(scans(3))

    def never(*_):
        raise MemoryError

    with UpdateThreads(3, least_cells=1) as many.threads:
        map_scans(many, placed[:1])
        asking(never)
        with pytest.raises(LimitReached, match="no memory left for the map"):
            many.integrate(*placed[1])
        asking()
        map_scans(many, placed[2:])
    map_scans(one, [placed[0], placed[2]])
    assert contents(many)[0] == contents(one)[0]
    assert many.cell_updates == one.cell_updates
    assert shared == [3, 3, 3]


def test_an_interrupt_leaves_nobody_at_work(shared, asking):
    caller = threading.current_thread()
    grid = grid_of(cell_model=Failing())

    def interrupted(*_):
        if threading.current_thread() is caller:
            raise KeyboardInterrupt

    placed = list(scans(2))
    with UpdateThreads(2, least_cells=1) as grid.threads:
        grid.integrate(*placed[0])
        assert update_threads_alive()
        asking(interrupted)
        with pytest.raises(KeyboardInterrupt):
            grid.integrate(*placed[1])
        assert not update_threads_alive()
    assert shared == [2, 2]


@pytest.mark.parametrize(
    ("pays", "expected"), [(True, list(range(16))), (False, [*range(4), *range(5, 9), *range(12, 16)])]
)
def test_where_sharing_does_not_pay_one_thread_goes_on_alone(pays, expected, monkeypatch):
    """It is tried four times, and again after 1 scan, 3, 7 and so on."""
    now = 0.0

    def thread_time():
        nonlocal now
        now += 1.0 if pays else 0.0
        return now

    monkeypatch.setattr(
        update_threads, "time", SimpleNamespace(perf_counter=lambda: 0.0, thread_time=thread_time)
    )
    grid, shared = grid_of(), []
    scan = update_threads._Scan
    monkeypatch.setattr(update_threads, "_Scan", lambda *a: (shared.append(grid.revision), scan(*a))[1])
    with UpdateThreads(2, least_cells=1) as grid.threads:
        map_scans(grid, scans(16))
    assert shared == expected


@pytest.mark.parametrize("seed", range(30))
def test_cuts_are_even(seed):
    rng = np.random.default_rng(seed)
    work = rng.exponential(1.0, 40) * (rng.random(40) < 0.7)
    most, least = int(rng.integers(1, 6)), float(rng.uniform(0.1, 20.0))
    cuts = even_cuts(work, most, least, 0.0)
    assert cuts[0] == 0
    assert cuts[-1] == 40
    parts = [work[a:b].sum() for a, b in pairwise(cuts)]
    assert len(parts) <= most
    assert len(parts) == 1 or min(parts) >= least / 2
    if len(parts) == min(most, int(work.sum() / least)) > 1 and least < work.sum() / 10:
        assert max(parts) <= work.sum() / len(parts) + work.max()


def test_the_first_part_gets_more_by_what_the_caller_is_ahead():
    work = np.ones(100)
    assert even_cuts(work, 2, 1.0, 0.0).tolist() == [0, 50, 100]
    assert even_cuts(work, 2, 1.0, 20.0).tolist() == [0, 60, 100]
    assert even_cuts(work, 3, 1.0, 10.0).tolist() == [0, 40, 70, 100]
    assert even_cuts(work, 3, 40.0, 0.0).tolist() == [0, 50, 100]
    assert even_cuts(work, 3, 200.0, 0.0).tolist() == [0, 100]
    assert even_cuts(np.zeros(7), 3, 1.0, 0.0).tolist() == [0, 7]


@pytest.mark.parametrize(
    ("kernels", "settings"),
    [
        (bresenham, {}),
        (dda, {"traversal": "dda"}),
        (passing, {"cell_model": Rate()}),
        (spans, {"sensor_model": "sector"}),
    ],
)
def test_work_is_about_how_many_cells_of_each_columns_are_updated(kernels, settings):
    grid = grid_of(resolution=0.1, **settings)
    rng = np.random.default_rng(3)
    ranges = (8.0 + 6.0 * np.sin(np.linspace(0, math.tau, 720)) + rng.normal(0, 0.1, 720)).astype(np.float32)
    scan = Scan(0, 0.0, math.tau / 720, 0.1, 30.0, ranges)
    grid.integrate(scan, Pose(3.3, -2.1, 0.4))
    evidence = observe(PlacedScan(scan, Pose(3.3, -2.1, 0.4)), grid.settings)
    assert evidence.kernels is kernels
    rect = evidence.extent()
    window = CellRect(rect.ix - evidence.base[0], rect.iy - evidence.base[1], rect.width, rect.height)
    work = np.zeros(-(-rect.width // kernels.CUT))
    kernels.strip_work(*evidence.arrays, tuple(window), work)
    counted = []
    for first in range(0, rect.width, kernels.CUT):
        width = min(kernels.CUT, rect.width - first)
        counted.append(cells_in(grid, evidence, CellRect(window.ix + first, window.iy, width, rect.height)))
    assert sum(counted) == grid.cell_updates
    assert np.abs(work / work.sum() - np.array(counted) / sum(counted)).max() < 0.03
    assert 0.6 * sum(counted) < work.sum() < 1.1 * sum(counted)


def cells_in(grid, evidence, columns):
    """How many updates a scan makes in some columns, in a map that begins there."""
    store = TileStore(CellRect(0, 0, columns.width, columns.height), grid.model.planes)
    return grid.model.update(evidence, store, columns, 1)
