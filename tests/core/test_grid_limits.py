"""How a map grows, what it allocates, and what it refuses whole."""

import math
import re

import numpy as np
import pytest

import naive
from ogm_core import grid as grid_module
from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import BadSetting, LimitReached
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Region
from ogm_core.sensor_models import one_call
from ogm_core.types import Pose, Scan

EAST, NORTH, WEST, SOUTH = 0.0, math.pi / 2, math.pi, -math.pi / 2
ORIGIN = Pose(0.05, 0.05, EAST)
TILE_BYTES = 64 * 64 * 2


def scan_of(ranges, **changes):
    values = {"stamp": 1, "angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.0, "range_max": 100.0}
    return Scan(**{**values, "ranges": np.asarray(ranges, np.float32), **changes})


def grid_of(**changes):
    return OccupancyGrid(GridSettings(**{"resolution": 0.1, "alpha": 0.2, **changes}), "epoch")


def state(grid):
    """Everything that a refused scan must leave alone."""
    snapshot = grid.snapshot()
    identity = grid.epoch, grid.revision, grid.stamp, grid.cell_updates
    return identity, grid.rect, grid.nbytes, snapshot.cells.tobytes()


def refuses(grid, scan, pose):
    """Assert that the scan is refused as a limit, and changes nothing; return the refusal."""
    before = state(grid)
    with pytest.raises(LimitReached) as refused:
        grid.integrate(scan, pose)
    assert state(grid) == before
    return refused.value


def assert_equal(grid, twin):
    snapshot = grid.snapshot()
    found = np.where(grid.model.known(snapshot.cells), grid.model.log_odds(snapshot.cells), math.nan)
    expected = twin.log_odds(snapshot.offset, snapshot.width, snapshot.height)
    assert np.array_equal(found, expected, equal_nan=True)
    assert np.count_nonzero(~np.isnan(found)) == len(twin.cells)


def table_bytes(rect):
    """Memory of a store's tables over a rectangle of whole tiles."""
    return 8 * rect.width + 8 * (rect.width // 64) * (rect.height // 64)


def test_an_empty_map():
    grid = grid_of()
    assert grid.rect == CellRect(0, 0, 0, 0)
    assert grid.nbytes == 0
    snapshot = grid.snapshot()
    assert (snapshot.cells.shape, snapshot.offset, snapshot.revision, snapshot.stamp) == (
        (0, 0),
        (0, 0),
        0,
        None,
    )
    assert snapshot.empty


@pytest.mark.parametrize("cells", ["int16", "float64"])
@pytest.mark.parametrize(
    "directions", [(EAST, NORTH, WEST, SOUTH), (SOUTH, WEST, SOUTH, EAST), (NORTH, NORTH, NORTH, WEST)]
)
def test_growth_in_every_direction_keeps_the_cells(cells, directions):
    rng = np.random.default_rng(1)
    grid = grid_of(cell_model=LogOdds(cells))
    twin = naive.Map(grid.settings)
    x, y = 0.0, 0.0
    for direction in directions:
        for _ in range(6):
            scan = scan_of(rng.uniform(0.1, 5.0, 30), angle_increment=0.2)
            pose = Pose(x, y, rng.uniform(-3, 3))
            assert grid.integrate(scan, pose) == twin.integrate(scan, pose)
            assert_equal(grid, twin)
            x, y = x + 4 * math.cos(direction), y + 4 * math.sin(direction)
    far = scan_of([40.0] * 4, angle_increment=math.pi / 2)
    assert grid.integrate(far, Pose(x, y, 0.1)) == twin.integrate(far, Pose(x, y, 0.1))
    assert_equal(grid, twin)


def test_bytes_are_those_of_the_touched_tiles_and_the_tables():
    rng = np.random.default_rng(2)
    grid = grid_of()
    twin = naive.Map(grid.settings)
    for _ in range(8):
        scan, pose = scan_of(rng.uniform(1, 60, 5), angle_increment=1.2), Pose(*rng.uniform(-9, 9, 3))
        grid.integrate(scan, pose)
        twin.integrate(scan, pose)
        tiles = {(i // 64, j // 64) for i, j in twin.cells}
        assert grid.nbytes == len(tiles) * TILE_BYTES + table_bytes(grid._store.rect)


def test_bounds_are_served_whole_from_the_beginning():
    grid = grid_of(bounds=Region(-3, -2, 4, 5))
    assert grid.rect == CellRect(0, 0, 70, 70)
    assert grid.snapshot().cells.shape == (70, 70)
    assert grid.nbytes == table_bytes(CellRect(0, 0, 128, 128))
    grid.integrate(scan_of([1.0]), ORIGIN)
    assert grid.nbytes == TILE_BYTES + table_bytes(CellRect(0, 0, 128, 128))


def test_cells_beyond_the_bounds_of_a_map_that_clips_are_not_allocated():
    grid = grid_of(bounds=Region(0, 0, 3.2, 3.2))  # a quarter of a tile
    for theta in (EAST, NORTH, WEST, SOUTH, 0.7):
        grid.integrate(scan_of([90.0]), Pose(1.6, 1.6, theta))
    store = grid._store
    outside = naive.stored(store, store.rect)
    outside[:32, :32] = 0
    assert not outside.any()


def test_bounds_beyond_max_cells_are_refused_at_once():
    with pytest.raises(BadSetting, match="70 x 70 cells are more than max_cells = 4899"):
        grid_of(bounds=Region(-3, -2, 4, 5), max_cells=4899)
    assert grid_of(bounds=Region(-3, -2, 4, 5), max_cells=4900).rect.cells == 4900


def test_max_cells_limits_the_known_rectangle():
    grid = grid_of(max_cells=101 * 20)
    grid.integrate(scan_of([10.0]), ORIGIN)
    grid.integrate(scan_of([1.9]), Pose(0.05, 0.05, NORTH))
    assert grid.rect == CellRect(0, 0, 101, 20)
    refuses(grid, scan_of([2.0]), Pose(0.05, 0.05, NORTH))
    refuses(grid, scan_of([1.0, 50.0]), ORIGIN)  # whole, though its first beam would fit
    assert grid.integrate(scan_of([9.0]), ORIGIN) == 90
    assert (grid.revision, grid.stamp) == (3, 1)


@pytest.mark.parametrize("sensor_model", ["beam", "sector"])
def test_a_refusal_says_which_limit_it_is_with_its_value_and_what_helps(sensor_model):
    helps = "raise it, map with larger cells (resolution), or keep far ends out (reach, bounds)"
    corner = scan_of([5.0, 5.0], angle_increment=math.pi / 2)
    found = refuses(grid_of(sensor_model=sensor_model, max_cells=600), corner, ORIGIN)
    needed = r"the map would be \d+ x \d+ cells, more than mapper\.max_cells = 600: (.*)"
    assert re.fullmatch(needed, str(found))[1] == helps
    assert (found.kind, found.slug) == ("max_cells", "limit")
    found = refuses(grid_of(sensor_model=sensor_model, max_bytes=5000), corner, ORIGIN)
    needed = (
        rf"it needs \d more tiles of {TILE_BYTES} bytes, for which mapper\.max_bytes = 5000 has no room: "
    )
    needed += "(.*)"
    assert re.fullmatch(needed, str(found))[1] == helps
    assert (found.kind, found.slug) == ("max_bytes", "limit")
    found = refuses(grid_of(sensor_model=sensor_model), corner, Pose(1e300, 0.0, 0.0))
    assert str(found).endswith("right?")
    assert (found.kind, found.slug) == ("too_far", "limit")


def test_max_cells_refuses_before_anything_is_allocated():
    grid = grid_of()
    grid.integrate(scan_of([1.0]), ORIGIN)
    refuses(grid, scan_of([1.0]), Pose(1e5, 1e5, 0.3))
    refuses(grid, scan_of([1.0]), Pose(-1e6, -1e6, 0.3))
    assert grid.integrate(scan_of([1.0]), ORIGIN) == 10


def test_max_bytes_counts_tiles_exactly():
    # Beams that leave a corner of the scan's rectangle free: 7 x 7 tiles in it, 13 of them touched.
    grid = grid_of(max_bytes=10**6)  # too few bytes for room around the first cells
    cross = scan_of([40.0, 40.0], angle_increment=math.pi / 2)
    grid.integrate(cross, ORIGIN)
    needed = grid.nbytes
    assert needed == 13 * TILE_BYTES + table_bytes(CellRect(0, 0, 448, 448))
    exact = grid_of(max_bytes=needed)
    exact.integrate(cross, ORIGIN)
    assert exact.nbytes == needed
    exact.integrate(cross, ORIGIN)
    refuses(grid_of(max_bytes=needed - 1), cross, ORIGIN)


def test_max_bytes_counts_the_tiles_of_a_straight_beam_exactly():
    beam = scan_of([40.0])
    grid = grid_of(max_bytes=10**6)
    grid.integrate(beam, ORIGIN)
    assert grid.nbytes == 7 * TILE_BYTES + table_bytes(CellRect(0, 0, 448, 64))
    refuses(grid_of(max_bytes=grid.nbytes - 1), beam, ORIGIN)
    grid_of(max_bytes=grid.nbytes).integrate(beam, ORIGIN)


@pytest.mark.parametrize("cells", ["int16", "float64"])
def test_after_max_bytes_scans_within_what_is_allocated_still_go_in(cells):
    grid = grid_of(max_bytes=200_000, cell_model=LogOdds(cells))
    twin = naive.Map(grid.settings)
    home = scan_of([4.0, 5.0, 3.0, 5.5, 2.0], angle_increment=1.1)
    away = scan_of([95.0, 95.0, 4.0], angle_increment=1.0)
    for _ in range(3):
        assert grid.integrate(home, ORIGIN) == twin.integrate(home, ORIGIN)
        refuses(grid, away, ORIGIN)
        refuses(grid, away, Pose(0.05, 0.05, WEST))
        assert grid.nbytes <= grid.settings.max_bytes
    assert_equal(grid, twin)
    assert grid.revision == 3


def test_the_tables_of_a_refused_scan_do_not_use_up_max_bytes():
    grid = grid_of(max_bytes=30_000, max_cells=10**12)
    grid.integrate(scan_of([3.0]), ORIGIN)
    # The table of this many columns alone is larger than max_bytes.
    refuses(grid, scan_of([1.0]), Pose(5000.0, 0.05, EAST))
    assert grid.integrate(scan_of([3.0]), ORIGIN) == 30
    assert grid.integrate(scan_of([5.0]), ORIGIN) == 50


def test_max_bytes_of_a_map_with_bounds():
    grid = grid_of(bounds=Region(-20, -20, 20, 20), max_bytes=60_000)
    grid.integrate(scan_of([3.0]), ORIGIN)
    refuses(grid, scan_of([90.0] * 30, angle_increment=0.2), ORIGIN)
    assert grid.integrate(scan_of([5.0]), ORIGIN) == 50


def test_reset_gives_the_memory_back():
    grid = grid_of(max_bytes=60_000)
    first = scan_of([3.0], stamp=5)
    grid.integrate(first, ORIGIN)
    expected = grid.snapshot().cells.tolist()
    grid.integrate(scan_of([20.0], stamp=9), ORIGIN)
    grid.reset("another")
    assert state(grid) == (("another", 0, None, 0), CellRect(0, 0, 0, 0), 0, b"")
    grid.integrate(first, ORIGIN)
    snapshot = grid.snapshot()
    assert snapshot.cells.tolist() == expected
    assert (snapshot.epoch, snapshot.revision, snapshot.stamp) == ("another", 1, 5)


def test_a_snapshot_is_a_copy():
    grid = grid_of()
    grid.integrate(scan_of([3.0]), ORIGIN)
    snapshot = grid.snapshot()
    before = snapshot.cells.copy()
    grid.integrate(scan_of([3.0], stamp=7), ORIGIN)
    grid.reset("another")
    assert np.array_equal(snapshot.cells, before)
    assert (snapshot.epoch, snapshot.revision, snapshot.stamp) == ("epoch", 1, 1)


def test_the_stamp_is_the_largest_integrated():
    grid = grid_of()
    stamps = []
    for stamp in (5, 3, 9, 9, 0):
        grid.integrate(scan_of([1.0], stamp=stamp), ORIGIN)
        stamps.append(grid.stamp)
    assert stamps == [5, 5, 9, 9, 9]
    refuses(grid, scan_of([1.0], stamp=50), Pose(1e300, 0.0, 0.0))


@pytest.mark.parametrize("ranges", [[math.nan, 0.0, -math.inf], [0.01], []])
def test_a_scan_without_a_usable_beam_is_integrated_and_changes_nothing(ranges):
    grid = grid_of()
    grid.integrate(scan_of([1.0]), ORIGIN)
    cells = grid.snapshot().cells.tobytes()
    assert grid.integrate(scan_of(ranges, stamp=2), ORIGIN) == 0
    assert (grid.revision, grid.stamp) == (2, 2)
    assert (grid.snapshot().cells.tobytes(), grid.rect.cells) == (cells, 10)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("far", [1e6, 1e15, 1e300])
def test_a_pose_far_away_is_a_limit(far, sign):
    grid = grid_of()
    grid.integrate(scan_of([1.0]), ORIGIN)
    refuses(grid, scan_of([1.0, 2.0]), Pose(sign * far, sign * far, 0.7))
    assert grid.integrate(scan_of([1.0]), ORIGIN) == 10


@pytest.mark.parametrize("far", [1e6, -1e6, 1e9])
def test_a_map_may_begin_far_away(far):
    grid = grid_of()
    twin = naive.Map(grid.settings)
    scan, pose = scan_of([3.0, 4.0, 5.0], angle_increment=1.3), Pose(far, -far, 0.3)
    assert grid.integrate(scan, pose) == twin.integrate(scan, pose)
    assert_equal(grid, twin)


@pytest.mark.parametrize(
    ("heading", "rect"), [(EAST, CellRect(6, 5, 99_999, 20)), (NORTH, CellRect(-15, 6, 21, 99_999))]
)
def test_ranges_of_a_kilometre_in_centimetre_cells(heading, rect):
    grid = grid_of(resolution=0.01)
    twin = naive.Map(grid.settings)
    scan = scan_of([999.0, 1000.0, math.inf], angle_min=0.0, angle_increment=1e-4, range_max=1000.0)
    pose = Pose(0.05, 0.05, heading)
    assert grid.integrate(scan, pose) == twin.integrate(scan, pose)
    assert grid.rect == rect
    assert_equal(grid, twin)


def test_the_longest_beam_in_the_smallest_cells():
    grid = grid_of(resolution=0.001)
    scan = scan_of([999.5], angle_min=5e-5, range_max=1000.0)
    assert grid.integrate(scan, Pose(0.0005, 0.0005, EAST)) == 999_500
    # The end point is (999.500499, 0.050475).
    assert grid.rect == CellRect(1, 0, 999_500, 51)


@pytest.mark.parametrize(
    ("module", "name", "length"), [(grid_module, "observe", 900.0), (one_call, "read_only", 1.0)]
)
def test_a_system_without_memory_is_a_limit(module, name, length, monkeypatch):
    """Whether a scan tells of cells for which there is no store yet, or goes in in one call."""

    def fail(*_):
        raise MemoryError

    grid = grid_of()
    grid.integrate(scan_of([1.0]), ORIGIN)
    monkeypatch.setattr(module, name, fail)
    refuses(grid, scan_of([length], range_max=1000.0), ORIGIN)


def fan(metres, beams=10):
    """Beams along +x, so that each is so many cells long."""
    return scan_of([metres] * beams, angle_increment=1e-9)


@pytest.mark.parametrize("traversal", ["bresenham", "dda"])
def test_a_scan_may_speak_of_max_scan_cells_and_no_more(traversal):
    grid = grid_of(traversal=traversal, max_scan_cells=500)
    assert grid.integrate(fan(5.0), ORIGIN) == 500
    refuses(grid, fan(5.1), ORIGIN)
    refuses(grid, fan(5.0, 11), ORIGIN)
    refuses(grid, scan_of([math.inf] * 10, range_max=5.1, angle_increment=1e-9), ORIGIN)
    assert grid.integrate(scan_of([math.nan] * 10 + [5.0] * 10, angle_increment=1e-9), ORIGIN) == 500
    with pytest.raises(
        LimitReached,
        match=r"^a scan that speaks of 510 cells is more than mapper.max_scan_cells = 500: ",
    ):
        grid.integrate(fan(5.1), ORIGIN)


def test_a_slanted_beam_speaks_of_the_cells_that_it_updates():
    slanted = scan_of([5.0 * math.sqrt(2.0)] * 10, angle_min=math.pi / 4, angle_increment=1e-9)
    assert grid_of(max_scan_cells=500).integrate(slanted, ORIGIN) == 500
    refuses(grid_of(max_scan_cells=499), slanted, ORIGIN)


@pytest.mark.parametrize("sensor_model", ["beam", "sector"])
def test_what_is_clipped_counts_and_what_is_dropped_does_not(sensor_model):
    bounds = {"bounds": Region(0.0, 0.0, 2.0, 2.0), "sensor_model": sensor_model, "max_scan_cells": 2000}
    scan = scan_of([100.0, 100.0, 100.0, 1.0], angle_increment=0.2)
    pose = Pose(0.55, 1.05, EAST)
    refuses(grid_of(**bounds), scan, pose)
    assert grid_of(outside="drop", **bounds).integrate(scan, pose) > 0
    assert grid_of(**bounds).integrate(scan_of([1.0, 1.0, 1.0], angle_increment=0.2), pose) > 0


def test_sectors_speak_of_their_area():
    metres, beams = 10.0, 360
    area = math.pi * (metres + 0.1) ** 2 / 0.1**2  # up to the far side of the wall
    circle = scan_of([metres] * beams, angle_increment=math.tau / beams)
    grid = grid_of(sensor_model="sector", max_scan_cells=round(1.02 * area))
    assert grid.integrate(circle, ORIGIN) == pytest.approx(area, rel=0.02)
    refuses(grid_of(sensor_model="sector", max_scan_cells=round(0.96 * area)), circle, ORIGIN)
    # No cell is spoken of twice, however often the beams go round.
    turns = scan_of([metres] * beams * 5, angle_increment=math.tau / beams)
    assert grid.integrate(turns, ORIGIN) == pytest.approx(area, rel=0.02)


def test_sectors_speak_of_their_outline_which_takes_time_too():
    zigzag = scan_of([0.3, 50.0] * 5000, angle_increment=1e-5)
    area = 0.1 / 2 * 50.0**2 / 0.1**2
    assert area < 20_000
    refuses(grid_of(sensor_model="sector", max_scan_cells=1_000_000), zigzag, ORIGIN)


def test_by_default_a_scan_may_speak_of_a_thousand_million_cells():
    grid = grid_of(bounds=Region(0.0, 0.0, 10.0, 10.0))
    refuses(grid, scan_of([999.0] * 100_200, range_max=1000.0, angle_increment=1e-9), ORIGIN)
    assert grid.integrate(scan_of([999.0] * 100_000, range_max=1000.0, angle_increment=1e-9), ORIGIN) > 0
