"""Judging a map by held-out beams: against the slow judge, closed forms, and what damage must cost."""

import math

import numpy as np
import pytest

from naive_judge import NaiveJudge
from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.log_odds import LogOdds, logit
from ogm_core.cells.rate import Rate
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Lattice
from ogm_core.quality.hazards import fitted_rates, step_edges
from ogm_core.quality.held_out_beams import beams_of
from ogm_core.quality.judged_map import JudgedMap
from ogm_core.quality.judgement import judge, judge_by, nats_of_empty_map
from ogm_core.quality.reliability import reliability
from ogm_core.simulation.lidar import Lidar, measure
from ogm_core.simulation.worlds import lab
from ogm_core.snapshot import MapSnapshot
from ogm_core.types import PlacedScan, Pose, Scan

NAN, INF = math.nan, math.inf


def scan_of(ranges, **changes):
    values = {"stamp": 1, "angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.0, "range_max": 30.0}
    return Scan(**{**values, "ranges": np.asarray(ranges, np.float32), **changes})


def snapshot_of(log_odds, resolution=0.5, offset=(0, 0)):
    """A map of these log odds, NaN where unknown."""
    model = LogOdds("float64", l_min=-50.0, l_max=50.0)
    values = np.asarray(log_odds, float)
    cells = CellArrays({"log_odds": model.store(np.nan_to_num(values), ~np.isnan(values))})
    return MapSnapshot(cells, model, Lattice(resolution), offset, "e", 1, 1)


def rays_of(beams):
    return [(x, y, math.atan2(dy, dx), r) for x, y, dx, dy, r in beams.rays.tolist()]


def naive_judge(snapshot, edges):
    log_odds, (p, known) = snapshot.log_odds(), snapshot.published()
    ix, iy = snapshot.offset
    cells = {(ix + i, iy + j): (log_odds[j, i], p[j, i]) for j, i in np.argwhere(known).tolist()}
    return NaiveJudge(cells, snapshot.resolution, edges.tolist())


def random_case(seed):
    """A map with walls and gaps, and scans of which some start beyond it, and some see farther than 20 m."""
    rng = np.random.default_rng(seed)
    values = rng.choice(
        [-35.0, -3.0, -1.0, 0.0, 0.5, 2.0, 33.0], (50, 60), p=[0.2, 0.4, 0.2, 0.05, 0.05, 0.06, 0.04]
    )
    values += rng.normal(0.0, 0.3, values.shape)
    values[rng.random(values.shape) < 0.05] = NAN
    scans = []
    for _ in range(9):
        ranges = rng.uniform(0.3, 12.0, 20)
        ranges[rng.integers(0, 20, 4)] = [NAN, INF, 0.0, 23.0]
        pose = Pose(*rng.uniform(-2.0, 14.0, 2), rng.choice([0.0, math.pi / 2, rng.uniform(-3, 3)]))
        scans.append(PlacedScan(scan_of(ranges, angle_increment=rng.choice([0.3, -0.3])), pose))
    return snapshot_of(values, 0.25, (-3, 2)), scans


@pytest.mark.parametrize("seed", range(2))
def test_equals_the_slow_judge(seed):
    snapshot, scans = random_case(seed)
    settings = GridSettings(
        resolution=0.25, reach=6.0
    )  # `reach` is the map's: longer returns are judged, too
    beams = beams_of(scans, settings)
    assert beams.readings.tolist() == [20] * 9
    assert len(beams.rays) == sum(
        np.count_nonzero(np.isfinite(s.scan.ranges) & (s.scan.ranges > 0)) for s in scans
    )
    edges = step_edges(JudgedMap.of(snapshot).known_log_odds())
    slow = naive_judge(snapshot, edges)
    rays = rays_of(beams)
    by_scan = [[ray for ray, n in zip(rays, beams.scans, strict=True) if n == number] for number in range(9)]
    judgement = judge(snapshot, settings, scans)
    assert judgement.bits == pytest.approx(slow.bits(by_scan, beams.readings.tolist()), abs=1e-9)
    assert judgement.walls == pytest.approx(slow.first_walls(rays), abs=1e-12)
    assert judgement.interval[0] < judgement.bits < judgement.interval[1]
    assert judgement.beams == len(rays)


def test_steps_are_quantiles_of_cells_of_which_the_likeliest_count_twice():
    known = np.linspace(-5.0, 5.0, 1001)
    edges = step_edges(known)
    assert len(edges) == 29
    assert np.all(np.diff(edges) > 0)
    assert np.count_nonzero(edges > 3.5) == pytest.approx(
        14.5 + 0.15 * 14.5, abs=1
    )  # half the pool, and 15 %
    assert step_edges(np.full(10, 2.0)).tolist() == [2.0]
    assert step_edges(np.empty(0)).tolist() == []


def test_rates_rise_whatever_the_counts_say():
    counts = np.array([[8.0, 2.0, 9.0, 1.0], [1.0, 1.0, 1.0, 10.0]])
    rates = fitted_rates(np.array([0.0, 1.0]), lambda _: counts, 10_000)
    assert rates[0] == rates[1] == pytest.approx(10.002 / 2.02)
    assert rates[2] == pytest.approx(9.001 / 1.01)
    assert rates[3] == pytest.approx(1.01 / 10.1)


def test_an_empty_map_says_the_same_of_every_place():
    ranges = np.array([2.0, 8.0, 20.0, 25.0])  # h = 2 / 50
    h = 0.04
    want = [0.95 * h * math.exp(-h * r) + 0.00125 for r in (2.0, 8.0)] + [0.95 * math.exp(-0.8) + 0.025] * 2
    assert nats_of_empty_map(ranges) == pytest.approx(-np.log(want))


def test_a_map_that_knows_nothing_saves_nothing():
    nothing = OccupancyGrid(GridSettings(), "e").snapshot()
    rng = np.random.default_rng(3)
    scans = [PlacedScan(scan_of(rng.exponential(4.0, 200) + 0.1, angle_increment=0.03), Pose(0, 0, 0))] * 4
    judgement = judge(nothing, GridSettings(), scans)
    assert abs(judgement.bits) < 0.02
    assert judgement.walls[:4] == (0.0, 1.0, 0.0, 0.0)
    assert (judgement.free_m2, judgement.occupied_m2, judgement.known_m2) == (0.0, 0.0, 0.0)


def test_without_returns_there_are_no_figures():
    snapshot = snapshot_of([[-2.0, 2.0, 0.0, NAN]])
    judgement = judge(
        snapshot, GridSettings(resolution=0.5), [PlacedScan(scan_of([NAN, INF]), Pose(0, 0, 0))]
    )
    assert (judgement.bits, judgement.interval, judgement.beams) == (None, None, 0)
    assert judgement.walls == (None,) * 5
    assert (judgement.free_m2, judgement.occupied_m2, judgement.known_m2) == (0.25, 0.25, 0.75)


@pytest.mark.parametrize(
    ("measured", "outcome"),
    [
        (9.75, "hit"),
        (9.84, "hit"),
        (9.86, None),
        (9.66, "hit"),
        (9.64, None),
        (9.945, None),
        (9.96, "short"),
        (9.555, None),
        (9.54, "long"),
        (14.9, "short"),
    ],
)
def test_a_wall_is_judged_where_the_beam_enters_it(measured, outcome):
    corridor = snapshot_of([[-2.0] * 20 + [2.0] + [-2.0] * 12])
    settings = GridSettings(resolution=0.5)
    walls = judge(corridor, settings, [PlacedScan(scan_of([measured]), Pose(0.25, 0.25, 0))]).walls
    assert {name for name in ("hit", "unknown", "short", "long") if getattr(walls, name)} == {outcome} - {
        None
    }


@pytest.mark.parametrize(
    ("row", "outcome"),
    [
        ([-2.0, NAN, 2.0], "unknown"),
        ([NAN, -2.0, 2.0], "hit"),  # the sensor's own cell may be unknown: it is not entered
        ([-2.0, 0.0, 2.0], "hit"),  # undecided is known
        ([-2.0, -2.0, logit(0.6499)], "unknown"),  # not above the threshold: on through it, and off the map
        ([-2.0] * 50, "long"),
    ],
)
def test_what_comes_first_decides(row, outcome):
    settings = GridSettings(resolution=0.5)
    walls = judge(snapshot_of([row]), settings, [PlacedScan(scan_of([0.75]), Pose(0.25, 0.25, 0))]).walls
    assert [name for name in ("hit", "unknown", "short", "long") if getattr(walls, name)] == [outcome]


@pytest.mark.parametrize(("y", "false_free"), [(0.41, 0.0), (0.39, 1.0), (0.61, 0.0)])
def test_a_false_free_end_has_no_wall_near_by(y, false_free):
    """The wall begins at y = 0.5; the beam runs along it and ends at x = 1.25."""
    rows = [[-2.0] * 4, [2.0] * 4]
    settings = GridSettings(resolution=0.5)
    walls = judge(snapshot_of(rows), settings, [PlacedScan(scan_of([1.0]), Pose(0.25, y, 0))]).walls
    assert walls.false_free == false_free


def test_far_away_poses_end_no_loop():
    snapshot = snapshot_of([[-2.0, 2.0]])
    scans = [PlacedScan(scan_of([1.0, 25.0]), Pose(x, 0, 0)) for x in (1e12, 1e300, -1e300)]
    judgement = judge(snapshot, GridSettings(resolution=0.5), scans)
    assert judgement.walls.unknown == 1.0
    assert math.isfinite(judgement.bits)


def test_reliability_is_the_share_of_visits_that_end():
    corridor = snapshot_of(
        [[logit(0.05)] * 4 + [logit(0.85)] + [NAN] * 3 + [logit(0.97)] + [logit(0.05)] * 40]
    )
    settings = GridSettings(resolution=0.5)
    # From the first cell: into the wall, short of it, through it, far away through it.
    beams = beams_of([PlacedScan(scan_of([2.0]), Pose(0.25, 0.25, 0))] * 3, settings)
    more = beams_of([PlacedScan(scan_of([r]), Pose(0.25, 0.25, 0)) for r in (1.0, 4.0, 21.0)], settings)
    found = reliability(JudgedMap.of(corridor), np.concatenate([beams.rays, more.rays]))
    assert found.visits.tolist() == [3 * 4 + 3 + 4 + 4 + 32, 0, 0, 0, 0, 0, 0, 0, 3 + 1 + 1, 2]
    assert found.ended[[0, 8, 9]] == pytest.approx([1 / 55, 3 / 5, 1 / 2])
    assert found.predicted[[0, 8, 9]] == pytest.approx([0.05, 0.85, 0.97])
    assert np.isnan(found.ended[1:8]).all()


def test_worse_poses_cost_bits():
    """Poses of the map that are off by 8 cm and 1 degree: what is judged is the map, by true poses."""
    sensor, path, rng = Lidar.lab(), lab().path, np.random.default_rng(1)
    placed = []
    for i in range(0, 220, 2):
        ranges = measure(lab(), path.pose(i), sensor, rng)
        scan = scan_of(
            ranges, angle_min=sensor.angle_min, angle_increment=sensor.angle_increment, range_max=8.0
        )
        placed.append(PlacedScan(scan, path.pose(i)))
    settings = GridSettings(resolution=0.1)
    bits = []
    for off in (0.0, 1.0):
        grid = OccupancyGrid(settings, "e")
        for n, (scan, (x, y, theta), _) in enumerate(placed):
            if n % 10 != 5:
                dx, dy, turn = off * rng.normal(0.0, [0.08, 0.08, math.radians(1.0)])
                grid.integrate(scan, Pose(x + dx, y + dy, theta + turn))
        bits.append(judge(grid.snapshot(), settings, placed[5::10]).bits)
    assert bits[0] > 4.5
    assert bits[0] - bits[1] > 0.4


def test_counts_are_judged_in_the_fine_cells_that_they_are_published_in():
    settings = GridSettings(resolution=0.2, cell_model=Rate())
    grid = OccupancyGrid(settings, "e")
    scan = scan_of(np.full(60, 3.0), angle_increment=0.1)
    for n in range(6):
        grid.integrate(scan, Pose(0.01 * n, 0.0, 0.1 * n))
    snapshot = grid.snapshot()
    beams = beams_of([PlacedScan(scan, Pose(0.02, 0.01, 0.05))] * 4, settings)
    finest = snapshot.finest()
    p, known = finest.published()
    judged = JudgedMap.of(snapshot)
    assert judged.resolution == 0.1
    assert np.array_equal(judged.classes != 0, known)
    judgement = judge_by(judged, beams)
    assert judgement.free_m2 == pytest.approx(np.sum(known & (p < 0.196)) * 0.01)
    slow = naive_judge(finest, step_edges(judged.known_log_odds()))
    assert judgement.walls == pytest.approx(slow.first_walls(rays_of(beams)), abs=1e-12)
    assert judgement.bits > 5.0
