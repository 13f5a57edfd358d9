"""Maps that forget: tiles that age only when they are written or read are cells that decay at every tick."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import naive_forgetting
from counts_model import Counts
from naive_rate import assert_planes
from ogm_core.cells.classes import trinary
from ogm_core.cells.forgetting import MOST_TICKS, MapTime, decay_table, decayed_steps
from ogm_core.cells.log_odds import PLANE, LogOdds
from ogm_core.cells.rate import Rate
from ogm_core.errors import BadSetting, LimitReached, OutsideBounds
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Region
from ogm_core.tiles import store as store_module
from ogm_core.tiles.polygon import Polygon
from ogm_core.types import Pose, Scan

SECOND = 10**9
HOUR = 3600 * SECOND
RESOLUTION = 0.25
MODELS = pytest.mark.parametrize("model", [LogOdds(), LogOdds("float64")], ids=["int16", "float64"])


def scan_at(stamp, rng, beams=24):
    return Scan(stamp, -math.pi, math.tau / beams, 0.1, 9.0, rng.uniform(0.5, 9.5, beams).astype(np.float32))


def stamps(rng, count, start=1_700_000_000 * SECOND):
    """Of a clock that mostly goes on, sometimes stands or steps back, and twice jumps ahead by an hour."""
    now, jumps = start, set(rng.integers(count // 3, count, 2).tolist())
    for k in range(count):
        now += int(rng.choice([0, 1, SECOND // 20, SECOND // 2, 3 * SECOND, -SECOND]))
        yield now + HOUR * sum(jump <= k for jump in jumps) - (HOUR if rng.random() < 0.05 else 0)


def poses(rng):
    """Of a robot that strays over many tiles, and comes back."""
    x, y = 0.013, 0.007  # on no edge of a cell, where either cell would do
    while True:
        x, y = (0.8 * x, 0.8 * y) if rng.random() < 0.1 else (x + rng.normal(0, 4), y + rng.normal(0, 4))
        yield Pose(x, y, rng.uniform(-4, 4))


def twin_of(settings):
    counts = isinstance(settings.cell_model, Rate)
    return naive_forgetting.Counts(settings) if counts else naive_forgetting.Map(settings)


def assert_equal(grid, twin):
    if isinstance(twin, naive_forgetting.Counts):
        assert_planes(grid, twin)
        return
    snapshot = grid.snapshot()
    expected = twin.log_odds(snapshot.offset, snapshot.width, snapshot.height)
    served = grid.model.arrays(snapshot.stored)[PLANE]
    assert np.array_equal(served, expected.astype(served.dtype), equal_nan=True)
    assert snapshot.known_cells == len(twin.cells)


def around(twin, spread):
    """The smallest rectangle with all that a twin's cells hold, and some cells around."""
    columns, rows = zip(
        *(twin.cells() if isinstance(twin, naive_forgetting.Counts) else twin.cells), strict=True
    )
    ix, iy = min(columns), min(rows)
    return CellRect(ix, iy, max(columns) - ix + 1, max(rows) - iy + 1).widened(spread)


def read(grid, twin, rng, stored):
    """One of what a reader, a saver or an operator does; the grid that goes on."""
    match int(rng.integers(7)):
        case 0:
            assert_equal(grid, twin)
        case 1:  # a copy that is made some scans later than it was begun
            ahead = stored.pop("ahead", None)
            if ahead is not None:
                grid.take_ahead(ahead, ahead.made())
            elif rng.random() < 0.5:
                stored["ahead"] = grid.copy_ahead()
            else:
                stored["ahead"] = grid.aged_copy_ahead(afresh=rng.random() < 0.5)
        case 2 | 3:  # a store: what has changed is written, and the whole is read again
            checkpoint = grid.checkpoint()
            stored["tiles"] |= {tile[:2]: tile for tile in checkpoint.tiles_since(stored["revision"])}
            stored["revision"] = checkpoint.state.revision
            again = OccupancyGrid(grid.settings, "", grid.run)
            again.restore(checkpoint.state, stored["tiles"].values())
            if rng.random() < 0.5:
                again_whole = OccupancyGrid(grid.settings, "", grid.run)
                again_whole.restore(checkpoint.state, checkpoint.tiles_since(0))
                assert_equal(again_whole, twin)
            assert_equal(again, twin)
            return again if rng.random() < 0.3 else grid
        case 4:
            x, y, width, height = *rng.integers(-40, 40, 2).tolist(), *rng.integers(1, 30, 2).tolist()
            rect = CellRect(x, y, width, height).intersection(grid.rect)
            if rect.cells:
                area = Polygon.of_region(grid.lattice.region_of(rect), grid.lattice)
                erased = grid.erase(area)
                assert erased == twin.erase(rect)
                if erased and grid.bounds is None:
                    assert grid.rect == around(twin, grid.model.spread)
        case _:
            pass
    return grid


CLOSED = {"bounds": Region(-20.0, -18.0, 30.0, 24.0)}
PRIOR = {"p_prior": 0.4, "p_occ": 0.9, "p_free": 0.2, "l_min": -3.0, "l_max": 2.5}


@pytest.mark.parametrize(
    ("model", "half_life", "changes"),
    [
        (LogOdds(), 2.0, {}),
        (LogOdds("float64"), 2.0, {}),
        (LogOdds("int16", **PRIOR), 12.0, {"traversal": "dda"}),
        (LogOdds("float64", **PRIOR), 12.0, {"traversal": "dda"}),
        (LogOdds(), 7.3, CLOSED),
        (LogOdds("float64"), 9.0, CLOSED | {"outside": "drop"}),
        (Rate(), 1.0, {}),
        (Rate(), 3.0, CLOSED),
        (Rate(), 4.5, CLOSED | {"outside": "drop"}),
    ],
    ids=lambda value: getattr(value, "cells", None) or str(value)[:20],
)
def test_aged_tiles_are_cells_that_decay_at_every_tick(monkeypatch, model, half_life, changes):
    """Whatever is read, stored, restored and erased between scans, whose clock steps both ways."""
    monkeypatch.setattr(store_module, "_FIRST_ROOM", 0)  # the store grows time and again
    rng = np.random.default_rng(8)
    settings = GridSettings(RESOLUTION, model, half_life=half_life, alpha=0.2, **changes)
    grid, twin = OccupancyGrid(settings), twin_of(settings)
    stored = {"tiles": {}, "revision": 0}
    for stamp, pose in zip(stamps(rng, 120), poses(rng), strict=False):
        scan = scan_at(stamp, rng)
        try:
            updates = grid.integrate(scan, pose)
        except OutsideBounds:
            continue
        assert twin.integrate(scan, pose) in (updates, None)
        assert grid.time.time == twin.clock.time
        grid = read(grid, twin, rng, stored)
    assert_equal(grid, twin)
    assert twin.clock.ticks > 12
    assert len(stored["tiles"]) > 3


class Eager:
    """A map whose every cell is looked up in a table of its own at every tick."""

    def __init__(self, settings):
        self.clock = naive_forgetting.Map(settings)
        self.grid = OccupancyGrid(replace(settings, half_life=None))

    def integrate(self, scan, pose):
        for _ in range(self.clock.clock.passed(scan.stamp)):
            self.decay()
        return self.grid.integrate(scan, pose)

    def decay(self):
        cells = self.grid._store.planes[PLANE].cells
        known = np.flatnonzero(self.grid.model.known(cells))
        before = cells[known]
        for value in np.unique(before).tolist():
            which = known[before == value]
            if cells.dtype == np.float64:
                left = self.clock.decayed(value)
                cells[which] = -0.0 if left == 0 else left
            else:
                cells[which] = 2 * self.clock.decayed(value >> 1) + (value & 1) or 1
        self.grid._copies = None


@pytest.mark.parametrize("cells", ["int16", "float64"])
def test_areas_that_scans_see_decay_as_well(cells):
    """Of the sensor model `sector`; known bits included."""
    rng = np.random.default_rng(3)
    settings = GridSettings(RESOLUTION, LogOdds(cells), "sector", half_life=5.0, alpha=0.4)
    grid, eager = OccupancyGrid(settings), Eager(settings)
    for k, (stamp, pose) in enumerate(zip(stamps(rng, 60), poses(rng), strict=False)):
        scan = scan_at(stamp, rng)
        assert grid.integrate(scan, pose) == eager.integrate(scan, pose)
        if k % 4 == 0:
            assert grid.rect == eager.grid.rect
            assert grid.snapshot().cells.tobytes() == eager.grid.snapshot().cells.tobytes()
    assert len(set(grid.time.ticks)) > 8


def test_a_tick_rounds_towards_the_prior_exactly():
    """The largest whole number of steps whose fourth power is not above half of the fourth power before."""
    for steps in range(2**14 + 1):
        left = decayed_steps(steps)
        assert 2 * left**4 <= steps**4
        assert 2 * (left + 1) ** 4 > steps**4 or steps == 0
        assert decayed_steps(-steps) == -left
    assert [decayed_steps(steps) for steps in (0, 1, 2, 3, 4, 16383)] == [0, 0, 1, 2, 3, 13776]
    assert math.trunc(16383 * Fraction(0.8408964152537145)) == 13776


@pytest.mark.parametrize("ticks", [1, 2, 7, MOST_TICKS])
def test_known_cells_stay_known_and_unknown_ones_unknown(ticks):
    every = np.arange(-(2**15) + 1, 2**15, dtype=np.int16)
    aged = decay_table(ticks)[every.view(np.uint16)]
    assert np.array_equal(aged == 0, every == 0)
    for stored, found in zip(every[::7].tolist(), aged[::7].tolist(), strict=True):
        steps = stored >> 1
        for _ in range(ticks):
            steps = math.trunc(steps * 2**-0.25)
        assert found >> 1 == steps
        assert found & 1 == stored & 1 or (found == 1 and steps == 0)


@MODELS
def test_after_so_many_ticks_nothing_is_left_and_more_change_nothing(model):
    ends = model.store(np.array([-8.0, 8.0, 0.4, -1e-3, 0.0]), np.ones(5, np.bool_))
    for ticks in (MOST_TICKS, MOST_TICKS + 1):
        aged = model.decayed({PLANE: ends}, ticks)[PLANE]
        assert model.known(aged).all()
        assert (model.log_odds(aged) == model.l0).all()
    almost = model.log_odds(model.decayed({PLANE: ends}, 20)[PLANE])
    assert (np.abs(almost[:2]) > 0.2).all()


def test_the_time_of_a_map_goes_on_by_a_second_a_scan_at_most_and_never_back():
    tick = SECOND // 4
    time = MapTime().after(10 * SECOND, 1, tick)
    assert time == (10 * SECOND, ())
    told = []
    for revision, stamp in enumerate([10, 10.2, 9, 0, 10.25, 3610, 3610, 11.9, 12.3], 2):
        time = time.after(round(stamp * SECOND), revision, tick)
        told.append((time.time / SECOND, time.ticks))
    assert [now for now, _ in told] == [10, 10.2, 10.2, 10.2, 10.25, 11.25, 12.25, 12.25, 12.3]
    ticks = (6, *(7,) * 4, *(8,) * 4)
    assert [len(passed) for _, passed in told] == [0, 0, 0, 0, 1, 5, 9, 9, 9]
    assert time.ticks == ticks
    for revision in range(11, 40):
        time = time.after(10**18, revision, tick)
    assert time.ticks == tuple(revision for revision in range(26, 40) for _ in range(4))
    assert len(time.ticks) == MOST_TICKS


def mapped(model=None, half_life=8.0, **changes):
    return OccupancyGrid(GridSettings(RESOLUTION, model or LogOdds(), half_life=half_life, **changes), "e")


def look(grid, stamp, x=0.0, r=3.0, y=0.0):
    """A scan of one beam to the east, a hit at a distance."""
    scan = Scan(stamp, 0.0, 0.1, 0.0, 8.0, np.array([r], np.float32))
    return grid.integrate(scan, Pose(x + 0.1, y + 0.1, 0.0))


def stored_cells(grid):
    return grid._store.planes[PLANE].cells.tobytes()


def test_a_tick_touches_no_tile_but_those_that_its_scan_writes():
    grid = mapped()
    look(grid, 0)
    look(grid, SECOND, x=40.0)
    west = grid._store.touched.copy()
    (tx,), (ty,) = np.nonzero(west == 1)
    tile = grid._store.planes[PLANE].tiles(west.shape)[tx, ty]
    before = tile.tobytes()
    look(grid, 2 * SECOND, x=40.0)
    assert grid.time.ticks == (3,)
    assert tile.tobytes() == before
    assert grid._store.touched[tx, ty] == 1
    grid.snapshot()
    assert tile.tobytes() == before
    assert [tile[:3] for tile in grid.checkpoint().tiles_since(2)] == [(2, 0, 3)]
    look(grid, 2 * SECOND)
    assert tile.tobytes() != before


def test_a_copy_that_is_made_while_a_tile_ages_is_not_the_stores():
    """Of a tile that a scan comes near, and does not write: its cells have aged meanwhile."""
    grid = mapped()
    look(grid, 0, x=20.0, y=20.0)
    ahead = grid.copy_ahead()
    for second in (1, 2):  # to the east and to the north of its tile, not to the north-east
        scan = Scan(second * SECOND, 0.0, math.pi / 2, 0.0, 8.0, np.array([5.0, 5.0], np.float32))
        grid.integrate(scan, Pose(13.1, 13.1, 0.0))
    assert grid.time.ticks == (3,)
    assert grid._store.touched[grid._store.aged == 3].tolist().count(1) == 1
    grid.take_ahead(ahead, ahead.made())
    checkpoint, again = grid.checkpoint(), mapped()
    again.restore(checkpoint.state, checkpoint.tiles_since(0))
    assert again.snapshot().cells.tobytes() == grid.snapshot().cells.tobytes()
    wall = again.snapshot().crop(Region(23.0, 20.0, 23.2, 20.2)).log_odds()
    assert wall == pytest.approx(grid.model.d_occ * 2**-0.25, abs=1e-3)


def test_a_copy_of_before_a_tick_stays_what_it_was():
    grid = mapped()
    look(grid, 0)
    early = grid.snapshot()
    cells = early.cells.tobytes()
    look(grid, SECOND)
    look(grid, 2 * SECOND, x=40.0)
    assert early.cells.tobytes() == cells
    late = grid.snapshot().crop(grid.lattice.region_of(early.rect))
    assert np.abs(late.log_odds()).max() < 2 * np.abs(early.log_odds()).max() * 0.85
    for numbers in (early.stored.tiles, late.stored.tiles):
        assert not numbers.blocks[0].planes[PLANE].flags.writeable


def test_reading_twice_copies_nothing_and_waiting_changes_nothing():
    grid = mapped()
    for second in range(4):
        look(grid, second * SECOND)
    first = grid.snapshot()
    assert np.array_equal(first.stored.tiles.numbers, grid.snapshot().stored.tiles.numbers)
    look(grid, 3 * SECOND, x=40.0)  # no tick
    again = grid.snapshot().crop(grid.lattice.region_of(first.rect))
    assert again.cells.tobytes() == first.cells.tobytes()


@MODELS
def test_a_box_that_is_gone_unseen_is_undecided_after_the_half_lives_that_its_log_odds_say(model):
    """Seen for 600 scans; the robot then looks elsewhere: nothing tells that it is gone but time."""
    grid = mapped(model, half_life=100.0)
    for k in range(600):
        look(grid, k * SECOND // 20)
    box = tuple(grid.lattice.cell_of(3.1, 0.1)), tuple(grid.lattice.cell_of(1.6, 0.1))
    seen, classes = len(grid.time.ticks), {}
    while len(grid.time.ticks) < seen + 20:
        look(grid, grid.time.time + SECOND, x=40.0)
        snapshot = grid.snapshot()
        (x, y), ticks = snapshot.offset, len(grid.time.ticks) - seen
        row = snapshot.encode(trinary)
        classes.setdefault(ticks, [int(row[iy - y, ix - x]) for ix, iy in box])
    wall, floor = ([classes[ticks][cell] for ticks in range(1, 21)] for cell in (0, 1))
    assert seen == 1
    assert wall == [100] * 14 + [-1] * 6  # 8 * 2^(-15/4) < 0.62, of which p is 0.65
    assert floor == [0] * 10 + [-1] * 10  # 8 * 2^(-11/4) < 1.41, of which p is 0.196
    assert snapshot.published()[1][box[0][1] - y, box[0][0] - x]


def test_a_scan_that_is_refused_is_no_time():
    grid = mapped(bounds=Region(0.0, 0.0, 10.0, 10.0), outside="drop")
    look(grid, 0)
    before, told = grid.time, stored_cells(grid)
    with pytest.raises(OutsideBounds):
        look(grid, 10 * SECOND, x=20.0)
    limited = mapped(max_cells=500)
    look(limited, 0)
    with pytest.raises(LimitReached):
        look(limited, 10 * SECOND, x=400.0)
    assert grid.time == limited.time == before == (0, ())
    assert stored_cells(grid) == told
    clipped = mapped(bounds=Region(0.0, 0.0, 10.0, 10.0))
    look(clipped, 0)
    for second in (1, 2):
        assert look(clipped, second * SECOND, x=20.0) == 0
    assert clipped.time == (2 * SECOND, (3,))


def test_a_reset_begins_another_time_and_a_map_without_half_life_has_none():
    grid = mapped()
    for second in range(9):
        look(grid, second * SECOND)
    assert len(grid.time.ticks) == 4
    grid.reset("f")
    assert grid.time == MapTime()
    look(grid, SECOND)
    assert grid.time == (SECOND, ())
    plain = mapped(half_life=None)
    for second in range(9):
        look(plain, second * SECOND)
    assert plain.time == MapTime()


def test_a_map_that_begins_with_cells_forgets_them_from_the_first_scan_on():
    grid = mapped()
    planes = {PLANE: np.full((80, 80), grid.model.store(np.array([8.0]), np.array([True]))[0])}
    grid.begin_with(planes, (-100, 0))
    for copy in (grid.snapshot, grid.checkpoint):
        copy()
    look(grid, 100 * SECOND)
    assert grid.snapshot().log_odds()[5, 5] == 8.0
    look(grid, 101 * SECOND)
    look(grid, 102 * SECOND)
    assert grid.time.ticks == (3,)
    assert grid.snapshot().log_odds()[5, 5] == pytest.approx(8.0 * 2**-0.25, abs=1e-3)


@pytest.mark.parametrize("half_life", [0.999, 0.0, -600.0, math.nan, math.inf, 1.001e9, 1e300])
def test_half_lives_that_no_map_can_have_are_refused(half_life):
    with pytest.raises(BadSetting, match=r"half_life: 1 to 1e\+09 s are needed, got"):
        GridSettings(half_life=half_life)


def test_cells_that_do_not_forget_take_no_half_life():
    with pytest.raises(BadSetting, match=r"half_life: the cells of cell model counts do not forget: leave"):
        GridSettings(cell_model=Counts(), half_life=60.0)
    with pytest.raises(NotImplementedError, match="Counts cells do not forget"):
        Counts().decayed({}, 1)
