"""The map against its slow twin, cell by cell; limits and growth are in test_grid_limits.py."""

import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import naive
from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import OutsideBounds
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.types import Pose, Scan

NAN, INF = math.nan, math.inf
BOTH = pytest.mark.parametrize("cells", ["int16", "float64"])
EAST, NORTH, WEST, SOUTH = 0.0, math.pi / 2, math.pi, -math.pi / 2


def scan_of(ranges, **changes):
    values = {"stamp": 1, "angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.0, "range_max": 8.0}
    return Scan(**{**values, "ranges": np.asarray(ranges, np.float32), **changes})


def random_scan(rng, beams=50):
    """Every kind of reading, and more of those around r_max - alpha / 2 for an alpha of 0.2."""
    ranges = rng.uniform(-0.5, 9.0, beams)
    special = [0.0, -0.0, NAN, INF, -INF, 8.0, 7.9, 7.9000001, 7.8999, 0.3, 0.29999]
    ranges[rng.integers(0, beams, len(special))] = special
    increment = rng.choice([0.13, -0.13, 2.5])
    return scan_of(ranges, angle_min=rng.uniform(-4, 4), angle_increment=increment, range_min=0.3)


def observe(grid, twin, scan, pose):
    """Integrate in both, and compare what was done."""
    before = grid.revision
    expected = twin.integrate(scan, pose)
    try:
        updates = grid.integrate(scan, pose)
    except OutsideBounds:
        assert (expected, grid.revision) == (0, before)
    else:
        assert (updates, grid.revision) == (expected, before + 1)


def assert_equal(grid, twin):
    """Same known cells, same log odds bit for bit, and nothing served that need not be."""
    snapshot = grid.snapshot()
    if grid.bounds is not None:
        assert grid.rect == grid.bounds
    elif twin.cells:
        ix, iy = min(i for i, _ in twin.cells), min(j for _, j in twin.cells)
        right, top = max(i for i, _ in twin.cells) + 1, max(j for _, j in twin.cells) + 1
        assert grid.rect == (ix, iy, right - ix, top - iy)
    found = np.where(grid.model.known(snapshot.cells), grid.model.log_odds(snapshot.cells), NAN)
    expected = twin.log_odds(snapshot.offset, snapshot.width, snapshot.height)
    assert np.array_equal(found, expected, equal_nan=True)


def pair(**changes):
    grid_settings = GridSettings(**{"resolution": 0.1, "alpha": 0.2, **changes})
    return OccupancyGrid(grid_settings, "epoch"), naive.Map(grid_settings)


@BOTH
@pytest.mark.parametrize("prior", [0.5, 0.4])
@pytest.mark.parametrize(
    "area",
    [{}, {"bounds": Region(-3, -2, 4, 5)}, {"bounds": Region(-3, -2, 4, 5), "outside": "drop"}],
    ids=["unbounded", "clip", "drop"],
)
@pytest.mark.parametrize("limits", [{}, {"reach": 5.0, "clear_range": 3.0}, {"clear_range": 0.0}])
def test_random_scans(cells, prior, area, limits):
    rng = np.random.default_rng(0)
    grid, twin = pair(cell_model=LogOdds(cells, p_prior=prior, l_min=-2, l_max=3.5), **area, **limits)
    for _ in range(25):
        observe(grid, twin, random_scan(rng), Pose(*rng.uniform(-5, 6, 2), rng.uniform(-9, 9)))
    assert_equal(grid, twin)
    assert len(twin.cells) > 1000


@BOTH
@pytest.mark.parametrize(
    ("pose", "length"),
    [
        (Pose(0.05, 0.05, EAST), 2.0),
        (Pose(0.05, 0.05, NORTH), 2.0),
        (Pose(0.05, 0.05, WEST), 2.0),
        (Pose(0.05, 0.05, SOUTH), 2.0),
        (Pose(0.0, 0.0, math.pi / 4), 2.0),
        (Pose(0.0, 0.0, 3 * math.pi / 4), 2.0),
        (Pose(0.05, 0.05, -math.pi / 4), 2.0),
        (Pose(0.05, 0.05, EAST), 0.01),
        (Pose(0.05, 0.05, EAST), 0.1),
        (Pose(0.0999999, 0.0, EAST), 1e-6),
        (Pose(-7.0, 0.7, EAST), 2.0),
        (Pose(-7.0, 0.7, EAST), 7.2),
        (Pose(-3.0, -2.0, 1.0), 7.0),
        (Pose(4.0, 5.0, -2.0), 7.0),
    ],
)
@pytest.mark.parametrize("outside", ["clip", "drop"])
@pytest.mark.parametrize("bounds", [None, Region(-3, -2, 4, 5)])
def test_one_beam(cells, pose, length, outside, bounds):
    grid, twin = pair(cell_model=LogOdds(cells), bounds=bounds, outside=outside)
    for reading in (length, INF, length):
        observe(grid, twin, scan_of([reading]), pose)
    assert_equal(grid, twin)


def test_a_beam_frees_the_cells_before_its_end_and_not_its_own():
    grid, _ = pair(cell_model=LogOdds("float64"))
    assert grid.integrate(scan_of([0.5]), Pose(0.05, 0.05, EAST)) == 5
    assert grid.rect == (1, 0, 5, 1)
    free, occupied = grid.model.d_free, grid.model.d_occ
    assert grid.snapshot().cells.tolist() == [[free, free, free, free, occupied]]


@BOTH
def test_clipping_is_the_unbounded_map_restricted_to_the_bounds(cells):
    rng = np.random.default_rng(1)
    model, bounds = LogOdds(cells), Region(-3, -2, 4, 5)
    clipped, _ = pair(cell_model=model, bounds=bounds)
    unbounded = OccupancyGrid(GridSettings(resolution=0.1, alpha=0.2, cell_model=model), "e")
    # The anchors differ by whole cells: only an end point within rounding of an edge could tell.
    for _ in range(40):
        scan, pose = random_scan(rng), Pose(*rng.uniform(-8, 8, 2), rng.uniform(-9, 9))
        clipped.integrate(scan, pose)
        unbounded.integrate(scan, pose)
    assert np.array_equal(unbounded.snapshot().crop(bounds).cells, clipped.snapshot().cells)


def test_only_a_scan_that_lost_every_beam_to_the_bounds_is_refused():
    grid, _ = pair(bounds=Region(-3, -2, 4, 5), outside="drop")
    with pytest.raises(OutsideBounds):
        grid.integrate(scan_of([6.0, INF, NAN]), Pose(0, 0, EAST))
    with pytest.raises(OutsideBounds):
        grid.integrate(scan_of([1.0]), Pose(-3.01, 0, EAST))
    assert (grid.revision, grid.stamp, grid.cell_updates) == (0, None, 0)
    assert not grid.snapshot().cells.any()
    assert grid.integrate(scan_of([6.0, 1.05]), Pose(0, 0, EAST)) == 10
    assert grid.integrate(scan_of([NAN, 0.0]), Pose(0, 0, EAST)) == 0  # nothing to drop: integrated
    assert (grid.revision, grid.stamp) == (2, 1)


def hammered(model, hits, passes):
    """A cell hit and passed over, alternately counted, next to one that is only passed."""
    grid, twin = pair(cell_model=model)
    for count, reading in ((hits, 0.5), (passes, 0.9), (hits, 0.5)):
        for _ in range(count):
            observe(grid, twin, scan_of([reading]), Pose(0.05, 0.05, EAST))
            assert_equal(grid, twin)
    return grid, twin


@BOTH
@pytest.mark.parametrize(
    "model",
    [
        {},
        {"l_min": -2.0, "l_max": 3.5},
        {"p_prior": 0.6, "p_occ": 0.9, "p_free": 0.2},
        {"p_occ": 1.0, "p_free": 0.0},  # an increment larger than the distance between the clamps
        {"p_occ": 1.0, "p_free": 0.0, "l_min": -40.0, "l_max": 1.0},
        {"p_prior": 0.5, "l_min": -0.001, "l_max": 8.0},
        {"l_min": -1e-4},  # less than half a step of int16 from the prior
        {"l_max": 1e-4},
    ],
)
def test_clamps_hold_and_are_left_again(cells, model):
    model = LogOdds(cells, **model)
    grid, _ = hammered(model, 30, 40)
    end = grid.snapshot()
    highest, lowest = model.log_odds(end.cells).max(), model.log_odds(end.cells).min()
    assert highest == pytest.approx(model.l_max, abs=model.step / 2)
    assert lowest == pytest.approx(model.l_min, abs=model.step / 2)


def test_int16_uses_its_whole_range():
    grid, _ = hammered(LogOdds("int16"), 30, 30)
    cells = grid.snapshot().cells
    assert cells.dtype == np.int16
    assert (cells.max(), cells.min()) == (32767, -32766)


@BOTH
def test_a_cell_brought_back_to_the_prior_stays_known(cells):
    model = LogOdds(cells, p_occ=0.75, p_free=0.25)
    assert model.d_occ == -model.d_free
    grid, twin = pair(cell_model=model)
    for reading in (0.5, 0.7):
        observe(grid, twin, scan_of([reading]), Pose(0.05, 0.05, EAST))
    snapshot = grid.snapshot()
    assert model.log_odds(snapshot.cells)[0, 5 - grid.rect.ix] == 0.0
    assert model.known(snapshot.cells).all()
    assert_equal(grid, twin)
    observe(grid, twin, scan_of([0.5]), Pose(0.05, 0.05, EAST))
    assert_equal(grid, twin)


def test_float64_log_odds_of_zero_are_not_the_prior():
    model = LogOdds("float64", p_prior=0.25, p_occ=0.5, p_free=0.1)
    assert model.l0 + model.d_occ == 0.0
    grid, twin = pair(cell_model=model)
    for step in (1, 2, 3):
        observe(grid, twin, scan_of([0.5]), Pose(0.05, 0.05, EAST))
        hit = model.log_odds(grid.snapshot().cells)[0, -1]
        assert hit == (step - 1) * model.d_occ
        assert model.known(grid.snapshot().cells).all()
    assert_equal(grid, twin)
    for reading in (0.7, 0.6):  # a cell is hit, which makes it zero, and passed
        observe(grid, twin, scan_of([reading]), Pose(0.05, 0.05, EAST))
    assert_equal(grid, twin)
    observe(grid, twin, scan_of([0.9]), Pose(0.05, 0.05, EAST))
    assert_equal(grid, twin)


@BOTH
def test_without_clamping_evidence_adds_up(cells):
    rng = np.random.default_rng(3)
    model = LogOdds(cells, p_prior=0.4, p_occ=0.8, p_free=0.3, l_min=-300, l_max=300)
    grid, _ = pair(cell_model=model)
    counts = {False: Counter(), True: Counter()}
    for _ in range(15):
        scan, pose = random_scan(rng), Pose(*rng.uniform(-1, 1, 2), rng.uniform(-3, 3))
        grid.integrate(scan, pose)
        for start, end, hit, line in naive.observed(scan, pose, grid.settings):
            for cell, occupied in naive.evidence(start, end, hit, line):
                counts[occupied][cell] += 1
    log_odds = model.log_odds(grid.snapshot().cells)
    # An increment is rounded to half a step; a float64 sum loses next to nothing.
    rounding = model.step / 2 if cells == "int16" else 1e-13
    ix, iy, width, height = grid.rect
    for i in range(ix, ix + width):
        for j in range(iy, iy + height):
            n_free, n_occ = counts[False][i, j], counts[True][i, j]
            expected = model.l0 + n_free * model.d_free + n_occ * model.d_occ
            assert abs(log_odds[j - iy, i - ix] - expected) <= (n_free + n_occ) * rounding
    assert max(counts[False].values()) > 20


def test_cell_updates_grow_as_one_over_the_resolution():
    room = scan_of(np.linspace(3.0, 6.0, 720), angle_increment=math.tau / 720)
    updates = {}
    for resolution in (0.2, 0.1, 0.05, 0.025):
        grid, _ = pair(resolution=resolution)
        updates[resolution] = grid.integrate(room, Pose(0.01, 0.02, 0.3))
        assert grid.cell_updates == updates[resolution]
    for resolution in (0.1, 0.05, 0.025):
        assert updates[resolution] / updates[2 * resolution] == pytest.approx(2.0, rel=0.02)


def test_equal_scans_in_equal_order_give_equal_cells():
    def build():
        rng = np.random.default_rng(5)
        grid, _ = pair()
        for _ in range(20):
            grid.integrate(random_scan(rng), Pose(*rng.uniform(-5, 5, 3)))
        return grid.snapshot()

    first, second = build(), build()
    assert first.offset == second.offset
    assert np.array_equal(first.cells, second.cells)


READINGS = st.one_of(
    st.floats(0, 9, width=32), st.sampled_from([NAN, INF, -INF, -1.0, 0.0, 8.0, 7.9, 7.875, 0.25])
)
SCANS = st.builds(
    scan_of,
    st.lists(READINGS, min_size=1, max_size=6),
    angle_min=st.one_of(st.floats(-7, 7), st.sampled_from([EAST, NORTH, WEST, SOUTH])),
    angle_increment=st.sampled_from([0.01, -0.3, 1.0, math.pi / 4, math.pi / 2]),
    range_min=st.sampled_from([0.0, 0.25]),
)
POSES = st.builds(Pose, st.floats(-4, 4), st.floats(-4, 4), st.one_of(st.just(0.0), st.floats(-7, 7)))
AREAS = st.one_of(
    st.none(), st.sampled_from([Region(-1, -1, 2, 1), Region(0.25, -3, 1, 3), Region(-4, -4, 4, 4)])
)
MODELS = st.builds(
    LogOdds,
    st.sampled_from(["int16", "float64"]),
    p_prior=st.sampled_from([0.5, 0.35, 0.6]),
    p_occ=st.sampled_from([0.65, 0.97, 1.0]),
    l_min=st.sampled_from([-8.0, -1.0]),
    l_max=st.sampled_from([8.0, 2.0]),
)
SETTINGS = st.builds(
    GridSettings,
    resolution=st.sampled_from([0.125, 0.25]),
    cell_model=MODELS,
    alpha=st.sampled_from([0.0, 0.25]),
    reach=st.sampled_from([None, 0.1, 5.0]),
    clear_range=st.sampled_from([None, 0.0, 4.0]),
    bounds=AREAS,
    outside=st.sampled_from(["clip", "drop"]),
)


@settings(max_examples=150, deadline=None)
@given(SETTINGS, st.lists(st.tuples(SCANS, POSES), min_size=1, max_size=4))
def test_any_scans_in_any_map(grid_settings, placed):
    grid, twin = OccupancyGrid(grid_settings, "e"), naive.Map(grid_settings)
    for scan, pose in placed:
        observe(grid, twin, scan, pose)
    assert_equal(grid, twin)
