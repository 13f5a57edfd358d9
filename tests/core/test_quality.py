"""Quality figures against closed forms, and against what the slow twin counts."""

import contextlib
import math

import numpy as np
import pytest

import naive
from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import OutsideBounds
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Lattice, Region
from ogm_core.quality import figures
from ogm_core.quality.figures import Consistency, map_figures
from ogm_core.quality.held_out import DECIDED, predicted_walls
from ogm_core.snapshot import MapSnapshot
from ogm_core.types import PlacedScan, Pose, Scan

NAN, INF = math.nan, math.inf
BOTH = pytest.mark.parametrize("cells", ["int16", "float64"])


def scan_of(ranges, **changes):
    values = {"stamp": 1, "angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.0, "range_max": 30.0}
    return Scan(**{**values, "ranges": np.asarray(ranges, np.float32), **changes})


def random_scan(rng, longest):
    ranges = rng.uniform(0.2, longest, 40)
    ranges[rng.integers(0, 40, 5)] = [NAN, INF, 0.0, 29.97, 30.0]
    return scan_of(ranges, angle_min=rng.uniform(-3, 3), angle_increment=rng.choice([0.157, -0.157]))


def random_pose(rng):
    return Pose(*rng.uniform(-3, 3, 2), rng.uniform(-9, 9))


def random_map(cells, seed, *, scans=30, longest=10.0, **changes):
    """A small map, and the scans in it with their poses."""
    rng = np.random.default_rng(seed)
    model = LogOdds(cells, p_prior=0.45, l_min=-2.0, l_max=3.0)
    settings = GridSettings(**{"resolution": 0.5, "cell_model": model, "alpha": 0.1, **changes})
    grid = OccupancyGrid(settings, "e")
    placed = []
    for _ in range(scans):
        scan, pose = random_scan(rng, longest), random_pose(rng)
        with contextlib.suppress(OutsideBounds):
            grid.integrate(scan, pose)
            placed.append((scan, pose))
    return grid, placed, rng


def snapshot_of(cells, model, resolution=0.5):
    return MapSnapshot(CellArrays.of(model, np.array(cells)), model, Lattice(resolution), (0, 0), "e", 1, 1)


def bits(p):
    return -(p * math.log2(p) + (1 - p) * math.log2(1 - p))


def test_entropy_and_areas_in_closed_form():
    grid = OccupancyGrid(
        GridSettings(resolution=0.5, cell_model=LogOdds("float64", p_occ=0.8, p_free=0.1)), "e"
    )
    grid.integrate(scan_of([2.0]), Pose(0.25, 0.25, 0.0))  # three cells at 0.1, one at 0.8
    figures = map_figures(grid.snapshot())
    assert figures == pytest.approx(
        {
            "entropy_bits": 3 * bits(0.1) + bits(0.8),
            "mean_entropy_bits": (3 * bits(0.1) + bits(0.8)) / 4,
            "known_m2": 1.0,
            "free_m2": 0.75,
            "occupied_m2": 0.25,
        }
    )


def test_a_known_cell_at_one_half_has_one_bit_and_an_unknown_one_none():
    figures = map_figures(snapshot_of([[0.0, -0.0, -0.0]], LogOdds("float64")))
    assert (figures["entropy_bits"], figures["mean_entropy_bits"], figures["known_m2"]) == (2.0, 1.0, 0.5)
    assert (figures["free_m2"], figures["occupied_m2"]) == (0.0, 0.0)


def test_certainty_has_no_entropy():
    model = LogOdds("float64", l_min=-900.0, l_max=900.0)
    figures = map_figures(snapshot_of([[900.0, -900.0, 40.0, -800.0]], model))
    assert figures["entropy_bits"] == pytest.approx(0.0, abs=1e-12)
    assert (figures["free_m2"], figures["occupied_m2"]) == (0.5, 0.5)


@BOTH
def test_figures_of_a_random_map_are_those_of_its_cells_one_by_one(cells):
    grid, _, _ = random_map(cells, 1)
    snapshot = grid.snapshot()
    known = snapshot.model.known(snapshot.cells)
    p = snapshot.model.probability(snapshot.cells)[known].tolist()
    figures = map_figures(snapshot)
    assert figures["entropy_bits"] == pytest.approx(sum(map(bits, p)))
    assert figures["mean_entropy_bits"] == pytest.approx(sum(map(bits, p)) / len(p))
    assert figures["known_m2"] == len(p) * 0.25
    assert figures["free_m2"] == sum(q < 0.196 for q in p) * 0.25
    assert figures["occupied_m2"] == sum(q > 0.65 for q in p) * 0.25
    assert 0 < figures["occupied_m2"] < figures["free_m2"] < figures["known_m2"]


def naive_consistency(snapshot, placed, settings):
    """The shares, cell by cell from the definitions."""
    p = snapshot.model.probability(snapshot.cells)
    ix, iy = snapshot.offset
    ends, passed = [], []
    inside = naive.Map(settings).inside
    for scan, pose in placed:
        for start, end, hit, line in naive.observed(scan, pose, settings):
            if settings.outside == "drop" and not (inside(start) and inside(end)):
                continue
            for (i, j), occupied in naive.evidence(start, end, hit, line):
                if ix <= i < ix + snapshot.width and iy <= j < iy + snapshot.height:
                    (ends if occupied else passed).append(p[j - iy, i - ix])
    return {"hits": np.mean(np.array(ends) > 0.5), "free": np.mean(np.array(passed) < 0.5)}


@BOTH
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"bounds": Region(-4, -3, 5, 4)},
        {"bounds": Region(-4, -3, 5, 4), "outside": "drop"},
        {"reach": 6.0, "clear_range": 2.0},
    ],
)
def test_consistency_is_that_of_every_cell_of_every_beam(cells, changes):
    grid, placed, _ = random_map(cells, 2, **changes)
    snapshot = grid.snapshot()
    consistency = Consistency(snapshot, grid.settings)
    for scan, pose in placed:
        consistency.add(PlacedScan(scan, pose))
    expected = naive_consistency(snapshot, placed, grid.settings)
    assert consistency.figures() == pytest.approx(expected, abs=1e-12)
    assert 0.01 < expected["hits"] < 0.95
    assert 0.5 < expected["free"] < 1.0


def test_consistency_counts_each_beam_anew_and_one_half_as_neither():
    settings = GridSettings(resolution=0.5, cell_model=LogOdds("float64"))
    consistency = Consistency(snapshot_of([[1.0, -1.0, -0.0, 1.0]], settings.cell_model), settings)
    consistency.add(PlacedScan(scan_of([1.5, 1.5, 1.0], angle_increment=1e-9), Pose(0.25, 0.25, 0.0)))
    # Hits: cell 3 twice, and cell 2 at one half. Passed: cell 1 three times, cell 2 twice at one half.
    assert consistency.figures() == pytest.approx({"hits": 2 / 3, "free": 3 / 5})


def test_nothing_judged_gives_none():
    settings = GridSettings(resolution=0.5)
    empty = OccupancyGrid(settings, "e").snapshot()
    assert map_figures(empty) == {
        "entropy_bits": 0.0,
        "mean_entropy_bits": None,
        "known_m2": 0.0,
        "free_m2": 0.0,
        "occupied_m2": 0.0,
    }
    consistency = Consistency(empty, settings)
    assert consistency.figures() == {"hits": None, "free": None}
    consistency.add(PlacedScan(scan_of([3.0, INF]), Pose(0, 0, 0)))
    assert consistency.figures() == {"hits": None, "free": None}
    nothing = {
        "beams": 0,
        "median_abs_m": None,
        "within_0_1_m": None,
        "within_0_2_m": None,
        "into_unknown": None,
    }
    assert predicted_walls(empty, settings, []) == nothing
    assert (
        predicted_walls(empty, settings, [PlacedScan(scan_of([NAN, INF, 15.0, 0.0]), Pose(0, 0, 0))])
        == nothing
    )


def test_in_an_empty_map_every_beam_ends_in_the_unknown():
    settings = GridSettings(resolution=0.5)
    figures = predicted_walls(
        OccupancyGrid(settings, "e").snapshot(), settings, [PlacedScan(scan_of([3.0, 4.0]), Pose(0, 0, 0))]
    )
    assert figures == {
        "beams": 2,
        "median_abs_m": None,
        "within_0_1_m": 0.0,
        "within_0_2_m": 0.0,
        "into_unknown": 1.0,
    }


CORRIDOR = [[-2.0] * 20 + [2.0]] * 3
"""Three rows of free cells with a wall at their end, 10 m from the west edge."""


@pytest.mark.parametrize(
    ("x", "theta", "measured", "error"),
    [
        (0.25, 0.0, 9.75, 0.0),
        (0.25, 0.0, 9.5, 0.25),
        (3.1, 0.0, 7.0, 0.1),
        (3.1, 0.05, 6.9, 6.9 / math.cos(0.05) - 6.9),
    ],
)
def test_a_wall_is_predicted_where_the_ray_enters_it(x, theta, measured, error):
    settings = GridSettings(resolution=0.5, cell_model=LogOdds("float64"))
    snapshot = snapshot_of(CORRIDOR, settings.cell_model)
    figures = predicted_walls(snapshot, settings, [PlacedScan(scan_of([measured]), Pose(x, 0.75, theta))])
    assert figures["median_abs_m"] == pytest.approx(error, abs=1e-6)
    assert (figures["beams"], figures["into_unknown"]) == (1, 0.0)
    assert figures["within_0_2_m"] == float(error <= 0.2)


@pytest.mark.parametrize(
    ("cell", "found"),
    [
        (-0.0, "unknown"),
        (0.0, "unknown"),
        (DECIDED, "unknown"),
        (-DECIDED, "unknown"),
        (math.nextafter(DECIDED, 1), "wall"),
        (math.nextafter(-DECIDED, -1), "free"),
    ],
)
def test_what_is_not_clearly_free_stops_a_ray(cell, found):
    settings = GridSettings(resolution=0.5, cell_model=LogOdds("float64"))
    row = [[-2.0] * 8 + [cell] + [-2.0] * 11 + [2.0]]
    figures = predicted_walls(
        snapshot_of(row, settings.cell_model), settings, [PlacedScan(scan_of([3.75]), Pose(0.25, 0.25, 0.0))]
    )
    assert figures["into_unknown"] == float(found == "unknown")
    assert figures["within_0_1_m"] == float(found == "wall")
    assert figures["median_abs_m"] == {"unknown": None, "wall": 0.0, "free": 6.0}[found]


def test_a_cell_is_decided_relative_to_the_prior():
    model = LogOdds("float64", p_prior=0.25, p_free=0.1)
    assert model.l0 == pytest.approx(-1.0986, abs=1e-4)
    settings = GridSettings(resolution=0.5, cell_model=model)
    row = [[-2.0, -2.0, -2.0, -0.4]]  # -0.4 is 0.7 above the prior
    figures = predicted_walls(
        snapshot_of(row, model), settings, [PlacedScan(scan_of([1.25]), Pose(0.25, 0.25, 0.0))]
    )
    assert figures["median_abs_m"] == 0.0


def test_a_ray_is_cast_no_farther_than_25_m():
    settings = GridSettings(resolution=0.5, cell_model=LogOdds("float64"))
    row = [[-2.0] * 60 + [2.0]]
    scans = [PlacedScan(scan_of([3.0]), Pose(x, 0.25, 0.0)) for x in (0.25, 4.99, 5.01, 16.0)]
    figures = predicted_walls(snapshot_of(row, settings.cell_model), settings, scans)
    # The wall is at 30 m: the first two find nothing, the others are 21.99 m and 11 m off.
    assert (figures["beams"], figures["into_unknown"]) == (4, 0.0)
    assert figures["median_abs_m"] == pytest.approx((21.99 + 11.0) / 2)


def naive_held_out(snapshot, settings, placed):
    """The figures, beam by beam through the list of grid lines that it crosses."""
    evidence = snapshot.model.log_odds(snapshot.cells) - snapshot.model.l0
    ix, iy = snapshot.offset

    def belief(cell):
        i, j = cell[0] - ix, cell[1] - iy
        if not (0 <= i < snapshot.width and 0 <= j < snapshot.height) or abs(evidence[j, i]) <= 0.6:
            return "unknown"
        return "wall" if evidence[j, i] > 0.6 else "free"

    found, errors = [], []
    for scan, pose, _ in placed:
        for k, r in enumerate(scan.ranges.tolist()):
            reach = settings.reach or INF
            beam = naive.classify(r, scan.range_min, scan.range_max, settings.alpha, reach=reach)
            if beam is None or not beam[0] or r >= 15.0:
                continue
            u, v = pose.x / settings.resolution, pose.y / settings.resolution
            bearing = pose.theta + scan.angle_min + k * scan.angle_increment
            what, length = naive.cast(u, v, bearing, 25.0 / settings.resolution, belief)
            found.append(what)
            if what == "wall":
                errors.append(abs(length * settings.resolution - r))
    return {
        "beams": len(found),
        "median_abs_m": np.median(errors),
        "within_0_1_m": sum(e <= 0.1 for e in errors) / len(found),
        "within_0_2_m": sum(e <= 0.2 for e in errors) / len(found),
        "into_unknown": found.count("unknown") / len(found),
    }


@BOTH
@pytest.mark.parametrize("changes", [{}, {"resolution": 0.3}, {"reach": 12.0}])
def test_held_out_is_that_of_every_crossing_of_every_ray(cells, changes):
    grid, _, rng = random_map(cells, 3, scans=40, longest=6.0, **changes)
    others = [PlacedScan(random_scan(rng, 20.0), random_pose(rng)) for _ in range(40)]
    others += [PlacedScan(random_scan(rng, 6.0), Pose(*rng.uniform(-9, 9, 2), 0.0)) for _ in range(10)]
    figures = predicted_walls(grid.snapshot(), grid.settings, others)
    assert figures == pytest.approx(naive_held_out(grid.snapshot(), grid.settings, others), rel=1e-9)
    assert figures["beams"] > 1000
    assert 0.05 < figures["into_unknown"] < 0.95
    assert figures["within_0_2_m"] > 0.0


def test_a_scan_that_is_judged_piece_by_piece_is_judged_as_a_whole(monkeypatch):
    grid = OccupancyGrid(GridSettings(resolution=0.1))
    rng = np.random.default_rng(5)
    ranges = rng.uniform(0.5, 9.0, 1000).astype(np.float32)
    placed = PlacedScan(Scan(0, -3.0, 0.006, 0.1, 8.0, ranges), Pose(0.3, 0.2, 0.1))
    grid.integrate(placed.scan, placed.pose)
    whole, pieces, looks = (*(Consistency(grid.snapshot(), grid.settings) for _ in range(2)), [])
    whole.add(placed)
    monkeypatch.setattr(figures, "BEAMS_IN_A_ROW", 7)
    pieces.add(placed, lambda: looks.append(1))
    assert pieces.figures() == whole.figures()
    assert 0.2 < whole.figures()["hits"] < 0.4
    assert 0.5 < whole.figures()["free"] < 1.0
    assert len(looks) == 143

    def enough():
        raise TimeoutError

    with pytest.raises(TimeoutError):
        pieces.add(placed, enough)
