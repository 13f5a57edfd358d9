"""Quality figures at a bounded cost: of the whole map where that can be had, else of a share of it."""

import math
from itertools import pairwise

import numpy as np
import pytest

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.log_odds import LogOdds
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Lattice
from ogm_core.quality import truth as truth_module
from ogm_core.quality.bounded import VISITS, bounded_figures
from ogm_core.quality.figures import Consistency, map_figures, map_figures_within
from ogm_core.quality.truth import truth_figures, truth_figures_within
from ogm_core.simulation.worlds import lab, load_world
from ogm_core.snapshot import MapSnapshot
from ogm_core.types import PlacedScan, Pose, Scan

PATH = "path: {circle: [0, 0, 1], poses: 4}"


def fan(count, distance, *, angle=math.tau, range_max=1000.0):
    """A scan of so many beams that all hit at that distance, m."""
    return Scan(0, 0.0, angle / count, 0.0, range_max, np.full(count, distance, np.float32))


def random_map(height, width, seed=1, resolution=0.1):
    """A map of random cells, half of them unknown; its settings."""
    settings = GridSettings(resolution=resolution)
    rng = np.random.default_rng(seed)
    cells = rng.integers(-9000, 9000, (height, width), np.int16) * rng.integers(
        0, 2, (height, width), np.int16
    )
    model = settings.cell_model
    return MapSnapshot(CellArrays.of(model, cells), model, Lattice(resolution), (0, 0), "e", 1, 1), settings


@pytest.fixture(scope="module")
def driven():
    """A map that a robot has driven through, its settings and scans."""
    settings = GridSettings(resolution=0.1)
    grid, scans = OccupancyGrid(settings, "e"), []
    for k in range(30):
        placed = PlacedScan(fan(90, 2.0 + k % 3, range_max=8.0), Pose(0.3 * k - 4.0, 0.1 * k, 0.2 * k), None)
        grid.integrate(placed.scan, placed.pose)
        scans.append(placed)
    return grid.snapshot(), settings, scans


@pytest.mark.parametrize("world", [None, lab()], ids=["no world", "a world"])
def test_where_all_can_be_judged_they_are_the_figures_of_all(driven, world):
    snapshot, settings, scans = driven
    figures = bounded_figures(snapshot, settings, scans, world)
    consistency = Consistency(snapshot, settings)
    for placed in scans:
        consistency.add(placed)
    judged = figures.pop("judged")
    truth = None if world is None else truth_figures(snapshot, world)
    assert figures == map_figures(snapshot) | {"consistency": consistency.figures(), "truth": truth}
    assert 0 < judged.pop("visits") < VISITS
    assert judged == {"map": 1.0, "scans": 30, "consistency": 1.0, "truth": None if world is None else 1.0}
    assert 0.0 < figures["consistency"]["free"] <= 1.0


def test_an_empty_map_has_figures(driven):
    _, settings, _ = driven
    figures = bounded_figures(OccupancyGrid(settings, "e").snapshot(), settings, [], lab())
    assert figures["consistency"] == {"hits": None, "free": None}
    assert figures["judged"] == {"map": 1.0, "scans": 0, "consistency": 1.0, "truth": 1.0, "visits": 0}


@pytest.fixture(scope="module")
def vast():
    """A map of 25 million cells, and 100 scans that visit a thousand million of them."""
    snapshot, settings = random_map(5000, 5000)
    scan = fan(2400, 490.0, angle=math.pi / 2)
    return snapshot, settings, [PlacedScan(scan, Pose(0.05, 0.05, 0.0), None)] * 100


def test_a_thousand_million_visits_are_not_made(vast, monkeypatch):
    snapshot, settings, scans = vast
    one = Consistency(snapshot, settings)
    one.add(scans[0])
    assert 100 * one.visited > 0.98e9
    visited, add = [], Consistency.add

    def counted(self, *rest):
        add(self, *rest)
        visited.append(self.visited)

    monkeypatch.setattr(Consistency, "add", counted)
    figures = bounded_figures(snapshot, settings, scans, None)
    judged = figures["judged"]
    assert VISITS == 2e8
    assert 25_000_000 + 4900**2 + visited[-1] <= judged["visits"] <= VISITS
    assert judged["scans"] == len(visited) == 14
    assert judged["consistency"] == pytest.approx(0.14)
    assert figures["consistency"] == one.figures()
    assert bounded_figures(snapshot, settings, scans, None) == figures


def test_the_newest_scans_are_judged(driven):
    snapshot, settings, scans = driven
    figures = bounded_figures(snapshot, settings, scans, None, visits=20_000)
    judged = figures["judged"]
    newest = Consistency(snapshot, settings)
    for placed in scans[-judged["scans"] :]:
        newest.add(placed)
    assert 1 <= judged["scans"] < 30
    assert figures["consistency"] == newest.figures()
    assert judged["visits"] <= 20_000


def test_of_one_scan_that_costs_too_much_some_beams_are_judged(vast):
    snapshot, settings, scans = vast
    figures = bounded_figures(snapshot, settings, scans[:1], None, visits=2_000_000)
    judged = figures["judged"]
    assert judged["scans"] == 1
    assert 0.0 < judged["consistency"] < 0.2
    assert judged["visits"] <= 2_000_000
    assert 0.0 < figures["consistency"]["free"] < 1.0


def test_a_map_that_is_too_large_is_judged_by_rows_spread_over_it():
    snapshot, _ = random_map(1000, 100)
    figures, share, visits = map_figures_within(snapshot, 30_000)
    rows = [slice(row, row + 64) for row in range(0, 1000 - 63, 4 * 64)]
    parts = [map_figures(_rows_of(snapshot, rows_)) for rows_ in rows]
    assert share == len(rows) * 64 / 1000
    assert visits == len(rows) * 64 * 100 <= 30_000
    for name in ("entropy_bits", "known_m2", "free_m2", "occupied_m2"):
        assert figures[name] == pytest.approx(sum(part[name] for part in parts) / share)
    whole = map_figures(snapshot)
    assert figures == {name: pytest.approx(value, rel=0.05) for name, value in whole.items()}
    assert map_figures_within(snapshot, 100_000) == (whole, 1.0, 100_000)


def _rows_of(snapshot, rows):
    part = snapshot.stored.part(rows, slice(None))
    return MapSnapshot(part, snapshot.model, snapshot.lattice, (0, rows.start), "e", 1, 1)


def test_bands_of_rows_together_count_what_the_whole_map_counts():
    snapshot, _ = random_map(37, 50)
    world = load_world(f"{{boxes: [[-1, -1, 3, 2], [1.05, 0.5, 9, 3.71]], circles: [[2, 2, 1]], {PATH}}}")
    whole = truth_module._counts_of(snapshot, world, 0, 37)
    for edges in ([0, 1, 2, 20, 36, 37], list(range(38))):
        parts = [truth_module._counts_of(snapshot, world, *rows) for rows in pairwise(edges)]
        assert [sum(column) for column in zip(*parts, strict=True)] == pytest.approx(list(whole))


def test_a_world_that_costs_too_much_is_judged_in_part_and_costs_no_more(monkeypatch):
    snapshot, _ = random_map(640, 1000)
    level = ", ".join(f"[-5, {10 + k * 1e-4:.4f}, 105, {10 + k * 1e-4:.4f}]" for k in range(2000))
    steep = ", ".join(f"[{k * 0.02:.2f}, -5, {k * 0.02 + 1:.2f}, 70]" for k in range(2000))
    marked, mark = [], truth_module._mark

    def counted(occupied, runs, between):
        rows, first, last = runs
        marked.append(len(rows) + int(np.maximum(last - first + 1, 0).sum()))
        mark(occupied, runs, between)

    monkeypatch.setattr(truth_module, "_mark", counted)
    for walls in (level, steep):
        marked.clear()
        world = load_world(f"{{walls: [{walls}], {PATH}}}")
        figures, share, visits = truth_figures_within(snapshot, world, 1_000_000)
        assert 0.0 < share < 1.0
        assert 0.0 < figures["accuracy"] < 1.0
        assert sum(marked) + share * 640 * 1000 <= visits <= 1_000_000
        marked.clear()
        figures, share, visits = truth_figures_within(snapshot, world, 100)
        assert (figures, share, visits, marked) == (None, 0.0, 0, [])


def test_a_thousand_obstacles_of_the_largest_size_are_bounded(driven):
    snapshot, settings, scans = driven
    walls = ", ".join(f"[-1e6, {k - 1e6}, 1e6, {1e6 - k}]" for k in range(1000))
    world = load_world(f"{{walls: [{walls}], circles: [[0, 0, 1e6]], {PATH}}}")
    judged = bounded_figures(snapshot, settings, scans, world)["judged"]
    assert judged["visits"] <= VISITS
    assert judged["truth"] == 1.0


def test_what_looks_whether_anybody_still_waits_can_end_it(vast):
    snapshot, settings, scans = vast

    class Enough(Exception):
        pass

    looks = iter([None] * 110)

    def between():
        if next(looks, Enough) is Enough:
            raise Enough

    with pytest.raises(Enough):
        bounded_figures(snapshot, settings, scans, None, between)


def test_a_model_with_floats_is_judged_alike():
    settings = GridSettings(resolution=0.1, cell_model=LogOdds("float64"))
    grid = OccupancyGrid(settings, "e")
    grid.integrate(fan(90, 2.0, range_max=8.0), Pose(0.0, 0.0, 0.0))
    figures, share, _ = map_figures_within(grid.snapshot(), 800)
    assert 0.0 < share < 1.0
    assert figures["mean_entropy_bits"] == pytest.approx(
        map_figures(grid.snapshot())["mean_entropy_bits"], rel=0.2
    )
