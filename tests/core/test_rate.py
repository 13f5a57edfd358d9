"""The rate cell model against its twin, cell for cell; order; what is published of it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numba import njit

import naive_rate
from naive_rate import assert_planes
from ogm_core.cells import rate_kernel, rate_publishing
from ogm_core.cells.rate import Rate
from ogm_core.cells.rate_publishing import OF_CELLS, OF_HALVES
from ogm_core.errors import BadSetting, LimitReached, OutsideBounds
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.sensor_models import passing
from ogm_core.sensor_models.bresenham import FRACTION_BITS
from ogm_core.sensor_models.evidence import observe
from ogm_core.sensor_models.true_line import MAX_COLUMNS, line_of, row_at_start
from ogm_core.tiles import store as store_module
from ogm_core.types import PlacedScan, Pose, Scan, Sweep

BOUNDS = Region(-4.0, -3.0, 5.0, 4.5)
CHANGES = {
    "unbounded": {},
    "clipped": {"bounds": BOUNDS},
    "dropped": {"bounds": BOUNDS, "outside": "drop"},
    "near": {"reach": 5.0, "clear_range": 3.0, "bounds": BOUNDS},
    "coarse": {"resolution": 0.25, "anchor": (0.1, -7.3)},
}
EVERYWHERE = pytest.mark.parametrize("changes", CHANGES.values(), ids=CHANGES)


def settings_with(**changes):
    return GridSettings(**{"resolution": 0.1, "cell_model": Rate(), **changes})


def scans(seed, count=6, beams=90):
    """Scans along a way through many tiles: hits, no returns, silence, beams of a few centimetres."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        ranges = rng.uniform(0.02, 9.0, beams).astype(np.float32)
        ranges[rng.random(beams) < 0.15] = rng.choice([math.inf, math.nan, 8.0, 0.0])
        ranges[rng.random(beams) < 0.2] *= 0.05
        scan = Scan(k, -math.pi, math.tau / beams, 0.01, 8.0, ranges)
        yield scan, Pose(*rng.uniform(-3.0, 3.0, 2), rng.choice([0.0, rng.uniform(-9.0, 9.0)]))


def mapped(settings, placed):
    grid, twin = OccupancyGrid(settings, "e"), naive_rate.Counts(settings)
    updates = 0
    for scan, pose in placed:
        try:
            updates += grid.integrate(scan, pose)
        except OutsideBounds:
            continue
        twin.integrate(scan, pose)
    return grid, twin, updates


@EVERYWHERE
@pytest.mark.parametrize("seed", range(4))
def test_planes_are_the_twins(seed, changes):
    grid, twin, updates = mapped(settings_with(**changes), scans(seed))
    assert_planes(grid, twin)
    assert sum(twin.N.values()) > 1000 < sum(twin.H.values())
    assert updates == grid.cell_updates > 1000


def test_the_map_is_as_large_as_what_was_counted_and_two_cells_around():
    grid, twin, _ = mapped(settings_with(), scans(3))
    columns, rows = zip(*twin.cells(), strict=True)
    rect = grid.rect
    assert (rect.ix, rect.iy) == (min(columns) - 2, min(rows) - 2)
    assert (rect.width, rect.height) == (max(columns) - min(columns) + 5, max(rows) - min(rows) + 5)


def test_growth_moves_every_plane(monkeypatch):
    monkeypatch.setattr(store_module, "_FIRST_ROOM", 0)
    moved, take = [], store_module.TileStore.take
    monkeypatch.setattr(
        store_module.TileStore,
        "take",
        lambda self, other: (moved.append(other.tiles_used), take(self, other)),
    )
    placed = [
        (scan, Pose(pose.x + 9.0 * k, pose.y - 8.0 * k, pose.theta))
        for k, (scan, pose) in enumerate(scans(5))
    ]
    grid, twin, _ = mapped(settings_with(), placed)
    assert sum(used > 0 for used in moved) >= 2
    assert_planes(grid, twin)


def test_order_does_not_matter():
    placed = list(scans(6, count=8))
    one, other = (mapped(settings_with(), order)[0].snapshot() for order in (placed, placed[::-1]))
    assert one.rect == other.rect
    assert all(
        np.array_equal(cells, other.stored.planes()[name]) for name, cells in one.stored.planes().items()
    )


def test_every_beam_starts_where_its_sweep_was():
    ((scan, pose),) = scans(7, count=1)
    way = np.linspace(0.0, 1.0, scan.ranges.size)[:, None] * (0.7, -0.4, 0.5) + pose
    settings = settings_with()
    grid, twin = OccupancyGrid(settings, "e"), naive_rate.Counts(settings)
    grid.integrate(scan, pose, Sweep(pose, way))
    twin.integrate(scan, way)
    assert_planes(grid, twin)


@pytest.mark.parametrize("changes", [{}, {"bounds": BOUNDS}], ids=["unbounded", "clipped"])
def test_tiles_told_beforehand_are_those_that_are_written(changes, monkeypatch):
    monkeypatch.setattr(store_module, "_FIRST_ROOM", 100)
    settings = settings_with(**changes)
    for scan, pose in scans(8):
        grid = OccupancyGrid(settings, "e")
        grid.integrate(scan, pose)
        store = grid._store
        evidence = observe(PlacedScan(scan, pose), settings)
        told = np.zeros_like(store.touched)
        window = evidence.window(store, settings.bounds_rect or store.rect)
        fresh = passing.touch_tiles(*evidence.arrays, tuple(window), told, 1)
        assert np.array_equal(told, store.touched)
        assert fresh == store.tiles_used == np.count_nonzero(told)
        written = [plane.tiles(told.shape).any(axis=2) for plane in store.planes.values()]
        assert np.array_equal(np.any(written, axis=0), told != 0)


def ends_of(start, points, kinds):
    ends = np.empty((5, len(kinds)), np.int64)
    ends[:2], ends[2], ends[3:] = np.transpose(points), kinds, np.array(start)[:, None]
    return ends


def counted(start, points, kinds, weights, width, height):
    """A store of width x height cells with these beams, counted directly; and its twin."""
    store = store_module.TileStore(store_module.CellRect(0, 0, width, height), Rate().planes)
    planes = [store.planes[name] for name in "NCFEH"]
    columns = planes[0].column, planes[3].column
    ends = ends_of(start, points, kinds)
    cells = tuple(plane.cells for plane in planes)
    passing.update_planes(ends, np.array(weights), (0, 0, width, height), store.touched, 1, columns, cells)
    twin, names = naive_rate.Counts(), {1: naive_rate.NO_RETURN, 2: naive_rate.HIT, 3: naive_rate.BEYOND}
    for point, kind, weight in zip(points, kinds, weights, strict=True):
        if kind:
            twin.beam(names[kind], start, point, weight)
    return store, twin


def plane_of(store, name, width, height, side=1):
    tiles = store.planes[name].tiles(store.touched.shape).reshape(*store.touched.shape, 64 * side, 64 * side)
    return tiles.transpose(1, 2, 0, 3).reshape(store.rect.height * side, -1)[: height * side, : width * side]


def assert_counted(store, twin, width, height):
    """Every cell of every plane."""
    passed = plane_of(store, "N", width, height) + (
        plane_of(store, "C", width, height).astype(np.int64) << 16
    )
    for found, plane, side in (
        *((passed, twin.N, 1), (plane_of(store, "F", width, height), twin.F, 1)),
        *(
            (plane_of(store, "E", width, height, 2), twin.E, 2),
            (plane_of(store, "H", width, height, 2), twin.H, 2),
        ),
    ):
        wanted = np.zeros((height * side, width * side), np.int64)
        for (i, j), count in plane.items():
            if 0 <= i < width * side and 0 <= j < height * side:
                wanted[j, i] = count
        assert np.array_equal(found, wanted)


@pytest.mark.parametrize("spread", [1, 3, 40, 300])
@pytest.mark.parametrize("seed", range(5))
def test_random_beams_also_past_the_edges(seed, spread):
    rng = np.random.default_rng(seed)
    for _ in range(4):
        start = rng.integers(0, 16 * 180, 2)
        points = start + rng.integers(-16 * spread, 16 * spread + 1, (60, 2))
        points[:9, 0], points[9:15, 1] = start[0], start[1] + points[9:15, 0] - start[0]
        kinds, weights = rng.integers(0, 4, 60), rng.integers(1, 17, 60)
        found = counted(tuple(start.tolist()), points.tolist(), kinds.tolist(), weights.tolist(), 250, 180)
        assert_counted(*found, 250, 180)


@pytest.mark.parametrize("along", [0, 1])
@pytest.mark.parametrize("sides", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_diagonal_beams_that_end_by_the_corner_of_a_tile(sides, along):
    """The first half of an end lies up to four from the last: in another tile, where that begins."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        start = 16 * 64 - 16 * 9 * np.array(sides) + rng.integers(-24, 25, 2)
        lengths = np.empty((120, 2), np.int64)
        lengths[:, along] = 16 * 9 + rng.integers(-40, 41, 120)
        lengths[:, 1 - along] = lengths[:, along] - rng.integers(0, 4, 120)
        points = start + lengths * sides
        for place in ((0, 0), 16 * 64 * (np.array(sides) < 0)):  # in the middle of a store, and at its edge
            moved = (start - place).tolist(), (points - place).tolist()
            store, twin = counted(*moved, [2] * 120, [16] * 120, 128, 128)
            assert_counted(store, twin, 128, 128)
            written = [plane.tiles(store.touched.shape).any(axis=2) for plane in store.planes.values()]
            assert np.array_equal(np.any(written, axis=0), store.touched > 0)


def test_long_beams_are_exact():
    rng = np.random.default_rng(5)
    start = 16 * 4500 + 3, 16 * 4500 + 11
    points = rng.integers(0, 16 * 9000, (40, 2)).tolist()
    store, twin = counted(start, points, rng.integers(1, 4, 40).tolist(), [16] * 40, 9000, 9000)
    for name, plane, side in (("N", twin.N, 1), ("F", twin.F, 1), ("E", twin.E, 2), ("H", twin.H, 2)):
        found, bits = store.planes[name], 6 + side - 1
        assert len(plane) > 20
        for (i, j), count in plane.items():
            assert found.cells[found.column[i] + (j << bits)] == count
        assert np.count_nonzero(found.cells) == sum(count > 0 for count in plane.values())


def test_what_wraps_is_carried():
    points = [(16 * 40 + 5, 16 * 11 + 2)] * 5000 + [(16 * 12, 16 * 50 + 9)] * 5000
    store, twin = counted((16 * 10 + 2, 16 * 10 + 7), points, [2] * 10000, [16] * 10000, 64, 64)
    assert store.planes["C"].cells.max() == 1
    assert_counted(store, twin, 64, 64)


def test_beams_that_met_nothing_are_counted_up_to_65535():
    store, twin = counted((8, 8), [(16 * 9, 8)], [1], [16], 64, 64)
    ends = ends_of((8, 8), [(16 * 4, 8)] * 65540, [1] * 65540)
    columns = store.planes["N"].column, store.planes["E"].column
    cells = tuple(store.planes[name].cells for name in "NCFEH")
    passing.update_planes(ends, np.ones(65540, np.int64), (0, 0, 64, 64), store.touched, 1, columns, cells)
    assert plane_of(store, "F", 64, 64)[0, :11].tolist() == [0, 65535, 65535, 65535, 65535, 1, 1, 1, 1, 1, 0]
    assert len(twin.F) == 9


@njit
def rows_of(starts, ends, steps):
    rows = np.empty_like(steps)
    for n in range(steps.size):
        line = line_of(starts[n, 0], starts[n, 1], ends[n, 0], ends[n, 1])
        rows[n] = (row_at_start(line) + steps[n] * line.step) >> FRACTION_BITS
    return rows


def test_steps_are_those_of_exact_fractions():
    """Any step of any line up to the longest."""
    rng = np.random.default_rng(9)
    count = 200_000
    longest = 16 * rng.choice([4, 60, 1000, MAX_COLUMNS], count) - 16
    starts, along = rng.integers(0, 16, (count, 2)), rng.integers(1, longest) * rng.choice([-1, 1], count)
    across = rng.integers(-abs(along), abs(along) + 1)
    ends = starts + np.stack((along, across), axis=1)
    steps = rng.integers(0, abs(ends[:, 0] >> 4) + 1)
    rows = rows_of(starts, ends, steps)
    for start, end, k, row in zip(starts.tolist(), ends.tolist(), steps.tolist(), rows.tolist(), strict=True):
        sign = 1 if end[0] > start[0] else -1
        assert row == naive_rate.on_line(start, end, 0, 32 * sign * k + 16, 32)


@EVERYWHERE
def test_what_is_published_is_the_twins(changes):
    grid, twin, _ = mapped(settings_with(**changes), scans(2, count=3, beams=40))
    rng, coarse = np.random.default_rng(0), grid.snapshot()
    fine = coarse.finest()
    assert (fine.width, fine.height) == (2 * coarse.width, 2 * coarse.height)
    assert (fine.resolution, fine.origin) == (coarse.resolution / 2, coarse.origin)
    for snapshot, probability in ((fine, twin.probability), (coarse, twin.probability_of_cell)):
        p, known = snapshot.published()
        assert 50 < known.sum() < known.size
        assert snapshot.known_cells == known.sum()
        everywhere = np.array(list(np.ndindex(known.shape)))
        edges = (
            everywhere + np.array(snapshot.offset)[::-1]
        ) % 64 % 63 < 2  # of tiles, which have none in planes
        chosen = edges.any(axis=1) | known.ravel() & (rng.random(known.size) < 0.1)
        for j, i in rng.permutation(everywhere[chosen])[:3000].tolist():
            here = known[j, i]
            wanted = probability(i + snapshot.offset[0], j + snapshot.offset[1])
            assert here == (wanted is not None)
            assert p[j, i] == pytest.approx(0.5 if wanted is None else wanted, abs=1e-12)


@pytest.mark.parametrize("rule", [OF_HALVES, OF_CELLS], ids=["halves", "cells"])
def test_numpy_publishes_the_same(rule):
    rng = np.random.default_rng(1)
    for density in (0.0, 0.03, 0.3, 1.0):
        shape = 40 + 2 * rule.margin, 31 + 2 * rule.margin
        counted = np.where(rng.random(shape) < density, rng.integers(0, 9000, shape), 0).astype(np.float64)
        hits = np.where(rng.random(shape) < density / 2, rng.integers(0, 2**32, shape), 0).astype(np.uint32)
        unanswered = rng.integers(0, 4, shape).astype(np.uint16)
        (p, known), (slow, seen) = (
            publish(counted, hits, unanswered, rule)
            for publish in (rate_kernel.publish, rate_publishing.publish)
        )
        assert np.array_equal(known, seen)
        np.testing.assert_allclose(p, slow, rtol=0, atol=1e-12)
        assert p.shape == (40, 31)


def test_a_part_is_published_as_in_the_whole():
    fine = mapped(settings_with(), scans(2))[0].snapshot().finest()
    p, known = fine.published()
    for rows, columns in (
        (slice(3, 50), slice(7, 60)),
        (slice(4, 51), slice(0, 33)),
        (slice(0, 1), slice(5, 6)),
    ):
        assert np.array_equal(fine.published(rows, columns)[0], p[rows, columns])
        x, y = fine.origin
        side = fine.resolution
        corner = Region(
            x + side * (columns.start + 0.1),
            y + side * (rows.start + 0.1),
            x + side * (columns.stop - 0.1),
            y + side * (rows.stop - 0.1),
        )
        part = fine.crop(corner)
        assert part.offset == (fine.offset[0] + columns.start, fine.offset[1] + rows.start)
        assert np.array_equal(part.published()[0], p[rows, columns])
        assert np.array_equal(part.published()[1], known[rows, columns])


def test_a_wall_ahead():
    bearings = 0.01 * np.arange(-100, 101)
    scan = Scan(0, -1.0, 0.01, 0.0, 30.0, (3.0 / np.cos(bearings)).astype(np.float32))
    grid = OccupancyGrid(GridSettings(cell_model=Rate()), "e")
    grid.integrate(scan, Pose(0.0, 0.0, 0.0))
    fine = grid.snapshot().finest()
    row = -fine.offset[1]  # y = 0
    p, known = fine.published(slice(row, row + 1))
    wall = 120 - fine.offset[0]
    assert p[0, wall - 1 : wall + 1].max() > 0.65
    assert (p[0, wall - 110 : wall - 10] < 0.196).all()
    assert not known[0, wall + 4 :].any()


def test_a_beam_longer_than_lines_are_exact_for_is_refused_whole():
    settings = settings_with(resolution=0.002, max_cells=10**12)
    grid = OccupancyGrid(settings, "e")
    far = Scan(0, 0.0, 0.1, 0.0, 200.0, np.array([100.0], np.float32))
    with pytest.raises(
        LimitReached, match="longer than the 32765 that cell model rate counts exactly"
    ) as error:
        grid.integrate(far, Pose(0.0, 0.0, 0.0))
    assert error.value.kind == "too_far"
    assert grid.revision == 0
    assert grid.integrate(replace(far, ranges=np.array([65.0], np.float32)), Pose(0.0, 0.0, 0.0)) > 32000


def test_bytes_count_all_planes():
    grid = OccupancyGrid(settings_with(), "e")
    assert grid._store.tile_bytes == 64 * 64 * 3 * 2 + 128 * 128 * 2 * 4
    small = OccupancyGrid(settings_with(max_bytes=100_000), "e")
    with pytest.raises(LimitReached, match="tiles of 155648 bytes"):
        small.integrate(*next(scans(0)))
    assert small.revision == 0


def test_what_it_does_not_take_is_refused_by_name():
    with pytest.raises(BadSetting, match=r"^sensor_model: cell model rate takes beam, not sector$"):
        settings_with(sensor_model="sector")
