"""The area model against brute force: the class of every cell, by the nearest beam to its centre."""

import math
import tracemalloc

import numpy as np
import pytest
from numba import config, njit

import naive
from ogm_core.cells.log_odds import CellConstants, LogOdds
from ogm_core.errors import LimitReached, OutsideBounds
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Region
from ogm_core.sensor_models import spans
from ogm_core.sensor_models.evidence import observe
from ogm_core.types import PlacedScan, Pose, Scan, Sweep

NOTHING, FREE, OCCUPIED = 0, 1, 2
TURN = 2 * math.pi
NAN, INF = math.nan, math.inf
SLACK = 1e-6

sector_class = njit(naive.sector_class)
FEWER = 12 if config.DISABLE_JIT else 1
"""Without a compiler brute force takes hours: then fewer scans of fewer beams are compared."""


def settings_of(**changes):
    return GridSettings(**{"resolution": 0.1, "sensor_model": "sector", "alpha": 0.3, **changes})


def scan_of(ranges, **changes):
    values = {"stamp": 0, "angle_min": -1.0, "angle_increment": 0.3, "range_min": 0.0, "range_max": 8.0}
    return Scan(**{**values, "ranges": np.asarray(ranges, np.float32), **changes})


def beams_of(scan, settings):
    """Bearings, kinds (0 skipped, 1 no return, 2 hit) and lengths."""
    limits = [INF if limit is None else limit for limit in (settings.clear_range, settings.reach)]
    kinds, lengths = [], []
    for r in scan.ranges.tolist():
        beam = naive.classify(r, scan.range_min, scan.range_max, settings.alpha, *limits)
        kinds.append(0 if beam is None else 1 + beam[0])
        lengths.append(0.0 if beam is None else beam[1])
    bearings = scan.angle_min + np.arange(len(kinds)) * scan.angle_increment
    return bearings, np.array(kinds), np.array(lengths)


@njit
def brute_force(rect, u, v, resolution, theta, bearings, half, kinds, lengths, alpha):
    classes = np.zeros((rect.height, rect.width), np.int8)
    for j in range(rect.height):
        for i in range(rect.width):
            dx, dy = (rect.ix + i + 0.5 - u) * resolution, (rect.iy + j + 0.5 - v) * resolution
            classes[j, i] = sector_class(dx, dy, theta, bearings, half, kinds, lengths, alpha)
    return classes


def assert_every_cell(scan, pose, settings):
    """Compare all cells around the sensor; return how often each class occurs."""
    lattice, bounds = settings.lattice, settings.bounds_rect
    seen = observe(PlacedScan(scan, pose), settings).arrays[0]
    bearings, kinds, lengths = beams_of(scan, settings)
    u = (pose.x - lattice.anchor[0]) / lattice.resolution
    v = (pose.y - lattice.anchor[1]) / lattice.resolution
    around = math.ceil((lengths.max() + settings.alpha) / lattice.resolution) + 3
    i0, j0 = math.floor(u), math.floor(v)
    rect = CellRect(i0 - around, j0 - around, 2 * around, 2 * around)
    found = np.zeros((rect.height, rect.width), np.int8)
    for row, first, end, kind in seen.tolist():
        assert first < end
        assert not found[row + around, first + around : end + around].any(), "a cell is updated twice"
        found[row + around, first + around : end + around] = kind
    model = pose.theta, bearings, abs(scan.angle_increment) / 2, kinds, lengths, settings.alpha
    expected = brute_force(rect, u, v, lattice.resolution, *model)
    if bounds is not None:  # what lies outside may be left out
        rows, columns = rect.iy + np.arange(rect.height), rect.ix + np.arange(rect.width)
        beside = (rows < 0) | (rows >= bounds.height), (columns < 0) | (columns >= bounds.width)
        for classes in (found, expected):
            classes[beside[0]] = NOTHING
            classes[:, beside[1]] = NOTHING
    for j, i in np.argwhere(found != expected).tolist():
        # A centre that lies within 1e-6 cells of an edge may go either way.
        dx, dy = rect.ix + i + 0.5 - u, rect.iy + j + 0.5 - v
        either = {
            sector_class(
                (dx + SLACK * math.cos(a)) * lattice.resolution,
                (dy + SLACK * math.sin(a)) * lattice.resolution,
                *model,
            )
            for a in np.linspace(0, TURN, 16, endpoint=False)
        }
        assert found[j, i] in either, (i + rect.ix, j + rect.iy, found[j, i], expected[j, i], scan, pose)
    return [int(np.count_nonzero(found == kind)) for kind in (FREE, OCCUPIED)]


def random_ranges(rng, count):
    """Smooth walls with jumps, and every kind of reading."""
    ranges = np.repeat(rng.uniform(0.3, 7.5, count // 7 + 1), 7)[:count] + rng.normal(0, 0.05, count)
    ranges[rng.random(count) < 0.08] = rng.choice([INF, 8.0, 9.0, NAN, -INF, 0.0, 0.05, 7.9])
    return np.where(rng.random(count) < 0.1, rng.uniform(0.02, 8.0, count), ranges)


FIELDS = {
    "full circle": (-math.pi, TURN),
    "270 degrees": (-0.75 * math.pi, 1.5 * math.pi),
    "180 degrees": (-math.pi / 2, math.pi),
    "narrow": (0.2, 0.4),
}
LATTICES = {
    "at the origin": {"resolution": 0.1},
    "with bounds": {"resolution": 0.08, "bounds": Region(-3.3, 2.7, 12.7, 18.7)},
}


@pytest.mark.parametrize("lattice", LATTICES)
@pytest.mark.parametrize("field", FIELDS)
def test_random_scans(field, lattice):
    rng = np.random.default_rng([7, len(field), len(lattice)])
    totals = np.zeros(2, int)
    for n in range(1 + 24 // FEWER):
        start, width = FIELDS[field]
        count = int(rng.integers(3, 380 // FEWER))
        increment = width / count if field == "full circle" else width / (count - 1)
        if n % 3 == 1:
            start, increment = start + width, -increment
        settings = settings_of(**LATTICES[lattice], alpha=rng.choice([0.0, 0.1, 0.3, 1.5]))
        if n % 5 == 4:
            settings = settings_of(**LATTICES[lattice], clear_range=3.0, reach=5.0)
        scan = scan_of(random_ranges(rng, count), angle_min=start, angle_increment=increment, range_min=0.1)
        pose = Pose(*rng.uniform((-3, 2), (8, 15)), rng.uniform(-20, 20))
        totals += assert_every_cell(scan, pose, settings)
    assert totals.min() > 1000 // FEWER


ALIGNED = (0.0, 0.5, 0.25, 1e-13, 1.0 - 1e-13, 0.5 + 1e-14, 0.5 + 2**-52, 0.5 - 2**-53)


@pytest.mark.parametrize(
    "theta", [0.0, math.pi / 2, -math.pi, math.pi / 4, 4 * math.pi, 1e-15, 1e-17, -1e-17]
)
@pytest.mark.parametrize("count", [4, 8, 12, 90 // FEWER, 360 // FEWER])
def test_poses_aligned_with_the_lattice(count, theta):
    """Edges of sectors, ends of beams and the sensor lie on cell centres, corners and grid lines."""
    rng = np.random.default_rng(count)
    for n, (fu, fv) in enumerate(list(zip(ALIGNED * 2, ALIGNED + ALIGNED[::-1], strict=True))[::FEWER]):
        increment = TURN / count * (-1) ** n
        ranges = rng.choice([0.5, 1.0, 1.25, 2.0, 0.25, 8.0], count)
        scan = scan_of(ranges, angle_min=(0.0, -math.pi, increment / 2)[n % 3], angle_increment=increment)
        settings = settings_of(resolution=0.25, alpha=(0.0, 0.25, 0.5)[n % 3])
        assert_every_cell(scan, Pose((3 + fu) * 0.25, fv * 0.25, theta), settings)


@pytest.mark.parametrize(
    "theta", [k * math.pi / 2 + tiny for k in (0, 1, -1, 2) for tiny in (0.0, 1e-17, -1e-17, 1e-310)]
)
def test_edges_of_sectors_along_rows_of_cell_centres(theta):
    """Such an edge and a row are almost parallel: where they meet is known to no digit."""
    rng = np.random.default_rng(11)
    for fv in (0.5, 0.5 + 2**-53, 0.5 + 2**-52, 0.5 - 2**-53, 0.5 - 2**-54)[::FEWER]:
        for fu in (0.5, 0.3, fv):
            for _ in range(1 + 3 // FEWER):
                scan = scan_of(
                    rng.choice([NAN, 1.0, 4.0, 5.0, 5.25, 6.0, 7.0], 4),
                    angle_min=TURN / 8,
                    angle_increment=TURN / 4,
                )
                assert_every_cell(
                    scan, Pose(fu * 0.25, fv * 0.25, theta), settings_of(resolution=0.25, alpha=0.5)
                )


@pytest.mark.parametrize(
    ("count", "increment"),
    [
        (361, TURN / 360),  # the last beam looks where the first one does
        (76, TURN / 75),  # and here but for rounding
        (301, -TURN / 300),
        (361, float(np.float32(TURN / 360))),
        (360, float(np.float32(TURN / 360))),
        (720, TURN / 360),  # twice round
        (700, -TURN / 360),
        (600, 0.7 * TURN / 360),  # the second round looks between the beams of the first
        (5, 2.5),
        (3, -2.5),
        (2, 5.0),
        (1, 0.3),
        (1, 7.0),
        (2, 7.0),
        (4, TURN),
        (6, math.pi),
    ],
)
def test_rounds_that_overlap_or_leave_gaps(count, increment):
    rng = np.random.default_rng(count)
    for _ in range(4):
        scan = scan_of(rng.uniform(0.5, 4.0, count), angle_min=rng.uniform(-3, 3), angle_increment=increment)
        assert_every_cell(scan, Pose(*rng.uniform(-1, 1, 2), rng.uniform(-3, 3)), settings_of())


@pytest.mark.parametrize(
    ("count", "angle_min", "increment"),
    [(644, 1e5, -0.41887902047873904), (300, 1e9, 0.1), (20_000 // FEWER, 0.3, TURN + 1e-10)],
)
def test_no_cell_is_updated_twice_where_rounding_disturbs_the_order_of_beams(count, angle_min, increment):
    ranges = np.where(np.arange(count) % 2, 5.0, 30.0)
    scan = scan_of(ranges, angle_min=angle_min, angle_increment=increment, range_max=31.0)
    for theta in (-0.6637793476328504, 0.1, 2.0):
        grid = OccupancyGrid(settings_of())
        updates = grid.integrate(scan, Pose(0.01, 0.02, theta))
        assert updates == np.count_nonzero(grid.model.known(grid.snapshot().cells)) > 10_000


def test_of_equal_bearings_the_first_beam_wins():
    ranges = [2.0, 3.0, 4.0, 5.0, 6.0]  # the fifth looks where the first does
    both = [
        observe(
            PlacedScan(scan_of(r, angle_min=0.0, angle_increment=TURN / 4), Pose(0.03, 0.02, 0.1)),
            settings_of(),
        ).arrays[0]
        for r in (ranges, ranges[:4])
    ]
    assert np.array_equal(*both)


@pytest.mark.parametrize("fv", [0.5, 0.3])
def test_only_a_cell_whose_centre_is_the_sensor_is_left_out(fv):
    scan = scan_of([2.0] * 8, angle_min=0.0, angle_increment=TURN / 8)
    grid = OccupancyGrid(settings_of(resolution=0.25))
    grid.integrate(scan, Pose(0.125, 0.25 * fv, 0.0))
    snapshot = grid.snapshot()
    known = snapshot.model.known(snapshot.cells)
    ix, iy = snapshot.offset
    assert known[-iy, -ix] == (fv != 0.5)
    assert known[-iy, -ix + 1]
    assert known[-iy, -ix - 1]


@pytest.mark.parametrize("cells", ["int16", "float64"])
@pytest.mark.parametrize(
    ("x", "y"), [(0.0, 0.0), (3.9, -1.9), (3.999, 2.0), (4.0, 0.5), (-4.2, -2.1), (5.5, 0.3), (0.7, 3.1)]
)
def test_bounds_clip_the_map_of_the_same_lattice_without_bounds(x, y, cells):
    """Sensor inside, on the edge, and outside."""
    rng = np.random.default_rng(3)
    bounds = Region(-4.0, -2.0, 4.0, 2.0)
    model = LogOdds(cells)
    bounded = OccupancyGrid(settings_of(cell_model=model, bounds=bounds))
    whole = OccupancyGrid(settings_of(cell_model=model, bounds=Region(-20.0, -18.0, 20.0, 18.0)))
    updates = 0
    for theta in (0.0, 2.0, 4.0):
        scan = scan_of(rng.uniform(0.5, 7, 300), angle_min=-2.4, angle_increment=4.8 / 299)
        updates += bounded.integrate(scan, Pose(x, y, theta))
        whole.integrate(scan, Pose(x, y, theta))
    part = whole.snapshot().crop(bounds)
    assert part.cells.shape == bounded.snapshot().cells.shape
    assert np.array_equal(part.cells, bounded.snapshot().cells)
    assert updates == bounded.cell_updates > 0
    assert part.model.known(part.cells).sum() <= updates


def test_an_unbounded_map_is_served_as_the_rectangle_of_its_known_cells():
    grid = OccupancyGrid(settings_of())
    rng = np.random.default_rng(9)
    for n in range(12):
        scan = scan_of(rng.uniform(0.5, 7, 60), angle_min=0.0, angle_increment=1.2 / 60)
        grid.integrate(scan, Pose(n * 5.0, -n * 3.0, n * 1.0))
        known = grid.model.known(grid.snapshot().cells)
        assert known[0].any()
        assert known[-1].any()
        assert known[:, 0].any()
        assert known[:, -1].any()
    assert grid.rect.width > 500


def test_drop_ignores_the_sectors_of_beams_that_leave_the_bounds():
    bounds = Region(-2.0, -2.0, 2.0, 2.0)
    dropping = OccupancyGrid(settings_of(bounds=bounds, outside="drop"))
    skipping = OccupancyGrid(settings_of(bounds=bounds))
    ranges = np.array([1.0, 1.5, 3.0, 1.0, INF, 0.5, 1.9, 6.0])
    turn = {"angle_min": 0.0, "angle_increment": TURN / 8}
    dropping.integrate(scan_of(ranges, **turn), Pose(0.01, 0.02, 0.0))
    ranges[[2, 4, 7]] = NAN
    skipping.integrate(scan_of(ranges, **turn), Pose(0.01, 0.02, 0.0))
    assert np.array_equal(dropping.snapshot().cells, skipping.snapshot().cells)
    with pytest.raises(OutsideBounds):
        dropping.integrate(scan_of([1.0], angle_min=0.0), Pose(2.5, 0.0, math.pi))


def test_tiles_are_taken_only_where_cells_are():
    grid = OccupancyGrid(settings_of(resolution=0.05, max_bytes=10**6))
    scan = scan_of([7.0] * 3, angle_min=0.0, angle_increment=0.01)  # a thin wedge, 140 cells long
    grid.integrate(scan, Pose(0.01, 0.3, 0.0))
    snapshot = grid.snapshot()
    rows, columns = np.nonzero(snapshot.model.known(snapshot.cells))
    tiles = {
        ((snapshot.offset[0] + i) // 64, (snapshot.offset[1] + j) // 64)
        for j, i in zip(rows, columns, strict=True)
    }
    assert grid._store.tiles_used == len(tiles) == np.count_nonzero(grid._store.touched)
    tight = OccupancyGrid(settings_of(resolution=0.05, max_bytes=grid.nbytes))
    tight.integrate(scan, Pose(0.01, 0.3, 0.0))
    assert tight.nbytes == grid.nbytes
    with pytest.raises(LimitReached, match="max_bytes"):
        OccupancyGrid(settings_of(resolution=0.05, max_bytes=grid.nbytes - 1)).integrate(
            scan, Pose(0.01, 0.3, 0.0)
        )


def test_a_sweep_is_read_at_its_middle():
    scan, middle = scan_of([2.0] * 20), Pose(1.0, 2.0, 0.4)
    moved, still = OccupancyGrid(settings_of()), OccupancyGrid(settings_of())
    moved.integrate(scan, Pose(0.8, 2.0, 0.3), Sweep(middle, np.zeros((20, 3))))
    still.integrate(scan, middle)
    assert moved.rect == still.rect
    assert np.array_equal(moved.snapshot().cells, still.snapshot().cells)


@pytest.mark.parametrize(("increment", "theta"), [(1e-300, 0.3), (1e-15, -2.0), (2.2e-16, 3.0)])
def test_an_increment_lost_in_rounding_shows_nothing(increment, theta):
    grid = OccupancyGrid(settings_of())
    for count in (1, 2):
        scan = scan_of([5.0] * count, angle_min=0.0, angle_increment=increment)
        assert grid.integrate(scan, Pose(0.01, 0.02, theta)) == 0


def test_whole_turns_of_the_heading_do_not_count():
    scan = scan_of(np.linspace(1, 7, 120), angle_min=-1.0, angle_increment=TURN / 360)
    for theta in (1e9, -1e12, 1e16, 1e300):
        turned, plain = (OccupancyGrid(settings_of()) for _ in range(2))
        turned.integrate(scan, Pose(0.01, 0.02, theta))
        plain.integrate(scan, Pose(0.01, 0.02, math.atan2(math.sin(theta), math.cos(theta))))
        assert np.array_equal(turned.snapshot().cells, plain.snapshot().cells)
        assert plain.cell_updates > 1000


def jagged_scan(count, far):
    """Long and short beams by turns: every row meets the outline again and again."""
    ranges = np.where(np.arange(count) % 2, far, far / 9)
    return scan_of(ranges, angle_min=-math.pi, angle_increment=TURN / count, range_max=1000.0)


def test_a_scan_that_is_too_large_is_refused_before_its_cells_are_listed():
    tracemalloc.start()
    try:
        grid = OccupancyGrid(settings_of(resolution=0.05))
        with pytest.raises(LimitReached, match="max_cells"):
            grid.integrate(jagged_scan(20_000 // FEWER, 900.0), Pose(0.01, 0.02, 0.0))
        assert tracemalloc.get_traced_memory()[1] < 100e6
    finally:
        tracemalloc.stop()
    assert (grid.revision, grid.nbytes) == (0, OccupancyGrid(settings_of(resolution=0.05)).nbytes)


@pytest.mark.skipif(config.DISABLE_JIT, reason="four million cells, one by one")
def test_bounds_limit_what_a_huge_scan_costs():
    tracemalloc.start()
    try:
        settings = settings_of(resolution=0.001, bounds=Region(-1, -1, 1, 1), max_scan_cells=10**13)
        grid = OccupancyGrid(settings)
        updates = grid.integrate(jagged_scan(360, 999.0), Pose(0.0102, 0.0203, 0.0))
        assert tracemalloc.get_traced_memory()[1] < 100e6
    finally:
        tracemalloc.stop()
    assert updates == 2000 * 2000


def test_far_beams_of_fine_cells():
    """A thousand metres at 5 mm: 200,000 cells ahead, against the definition at places along the edges."""
    settings = settings_of(resolution=0.005, alpha=0.02)
    ranges = np.array([900.0, 950.0, 999.0], np.float32)
    scan = scan_of(ranges, angle_min=-1e-5, angle_increment=1e-5, range_max=1000.0)
    pose = Pose(0.0012, 0.0031, 0.3)
    bearings, kinds, lengths = beams_of(scan, settings)
    seen = observe(PlacedScan(scan, pose), settings).arrays[0]
    assert seen.shape[0] > 50_000
    fu, fv = pose.x / 0.005, pose.y / 0.005
    model = pose.theta, bearings, 0.5e-5, kinds, lengths, settings.alpha
    wrong = 0
    for row, first, end, kind in seen[:: seen.shape[0] // 2000].tolist():
        for i, expected in ((first, kind), (end - 1, kind)):
            dx, dy = (i + 0.5 - fu) * 0.005, (row + 0.5 - fv) * 0.005
            wrong += sector_class(dx, dy, *model) != expected
    assert wrong == 0


def test_counting_and_kinds_of_the_update_kernel():
    found = np.array(
        [[0, -3, 5, spans.SPAN_FREE], [1, 60, 70, spans.SPAN_FREE], [1, 70, 130, spans.SPAN_OCCUPIED]],
        np.int32,
    )
    columns = np.arange(192)
    column = (columns // 64) * 64 * 64 + columns % 64
    cells = np.zeros(3 * 64 * 64, np.int16)
    update = CellConstants(-20, 30, -100, 100, 0)
    touched = np.zeros((3, 1), np.int64)
    window = CellRect(0, 0, 128, 64)
    assert spans.update_cells(found, window, touched, 7, cells, column, update) == (5 + 10 + 58, 2)
    assert touched.ravel().tolist() == [7, 7, 0]
    dense = cells.reshape(3, 64, 64).transpose(1, 0, 2).reshape(64, 192)
    assert (dense[0, :5] == -20).all()
    assert (dense[1, 60:70] == -20).all()
    assert (dense[1, 70:128] == 31).all()
    assert np.count_nonzero(dense) == 5 + 10 + 58
    assert spans.extent(found) == (-3, 0, 133, 2)


def test_blocks_of_cells_are_updated_as_one_cell_is():
    rng = np.random.default_rng(12)
    first = np.sort(rng.choice([0, 1, 2, 62, 63, 64, 65, 100], 64))
    end = first + rng.choice([1, 2, 61, 62, 63, 64, 65, 66, 92], 64)
    kinds = rng.choice([FREE, OCCUPIED], 64)
    found = np.stack((rng.permutation(64), first, end, kinds), axis=1).astype(np.int32)
    columns = np.arange(192)
    column = (columns // 64) * 64 * 64 + columns % 64
    window, update = CellRect(0, 0, 150, 60), LogOdds(l_min=-1.0, l_max=3.0).constants
    blocks = rng.integers(update.lower, update.upper, 3 * 64 * 64).astype(np.int16)
    singly, touched = blocks.copy(), np.zeros((3, 1), np.int64)
    for _ in range(3):
        counts = {
            spans.update_blocks(found, window, touched, 1, blocks, column, update)[0],
            spans.update_one_by_one(found, window, touched, 1, singly, column, update)[0],
        }
        assert len(counts) == 1
        assert np.array_equal(blocks, singly)


def test_a_span_that_ends_at_a_tiles_edge_touches_no_tile_beyond_it():
    found = np.array([[63, 10, 64, spans.SPAN_FREE], [64, 64, 128, spans.SPAN_OCCUPIED]], np.int32)
    touched = np.zeros((3, 3), np.int64)
    assert spans.touch_tiles(found, CellRect(0, 0, 192, 192), touched, 4) == 2
    assert np.argwhere(touched == 4).tolist() == [[0, 0], [1, 1]]
    assert spans.touch_tiles(found, CellRect(0, 0, 192, 192), touched, 5) == 0
