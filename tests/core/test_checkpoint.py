"""Checkpoints: what a map is made of at one revision, and the same map made of it again."""

import threading

import numpy as np
import pytest

from counts_model import Counts, scans
from ogm_core.cells.forgetting import MapTime
from ogm_core.cells.log_odds import PLANE, LogOdds
from ogm_core.cells.rate import Rate
from ogm_core.errors import LimitReached
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Region
from ogm_core.tiles import store as store_module

BOUNDS = Region(-5.0, -4.0, 12.3, 9.7)
MODELS = pytest.mark.parametrize(
    "model", [LogOdds(), LogOdds("float64"), Counts(), Rate()], ids=["int16", "float64", "counts", "rate"]
)
WHERE = pytest.mark.parametrize("bounds", [None, BOUNDS], ids=["unbounded", "bounded"])


def grid_of(model=None, bounds=None, count=6, **changes):
    settings = GridSettings(resolution=0.1, cell_model=model or LogOdds(), bounds=bounds, **changes)
    grid = OccupancyGrid(settings, "e")
    for scan, pose in list(scans())[:count]:
        grid.integrate(scan, pose)
    return grid


def restored(checkpoint, settings, tiles=None):
    grid = OccupancyGrid(settings, "another")
    grid.restore(checkpoint.state, checkpoint.tiles_since(0) if tiles is None else tiles)
    return grid


def assert_same(a, b):
    """Everything that is told of a map, and every number in it, bit for bit."""
    one, other = a.snapshot(), b.snapshot()
    assert one.meta() == other.meta()
    assert (a.cell_updates, a.nbytes, a.rect) == (b.cell_updates, b.nbytes, b.rect)
    planes = other.stored.planes()
    for name, cells in one.stored.planes().items():
        assert cells.dtype == planes[name].dtype
        assert cells.tobytes() == planes[name].tobytes()


@MODELS
@WHERE
def test_a_map_of_a_checkpoint_is_the_map_and_goes_on_as_the_map(model, bounds):
    grid = grid_of(model, bounds)
    again = restored(grid.checkpoint(), grid.settings)
    assert grid.snapshot().known_cells > 200
    assert_same(grid, again)
    for scan, pose in list(scans())[6:]:
        assert grid.integrate(scan, pose) == again.integrate(scan, pose)
        assert_same(grid, again)


@MODELS
def test_what_was_written_since_a_revision_makes_up_for_what_was_not_stored(model):
    """Kept tiles and newer ones in their place, at every revision, are the map at that revision."""
    grid, kept, since = grid_of(model, count=0), {}, 0
    written = []
    for scan, pose in scans():
        grid.integrate(scan, pose)
        checkpoint = grid.checkpoint()
        newer = list(checkpoint.tiles_since(since))
        assert all(tile.revision == grid.revision for tile in newer)
        kept |= {tile[:2]: tile for tile in newer}
        written.append(len(newer))
        since = grid.revision
        assert_same(grid, restored(checkpoint, grid.settings, kept.values()))
    assert sum(written) > len(kept) > max(written) > 1


def test_a_checkpoint_stays_what_it_was():
    grid = grid_of(count=3)
    early, then = grid.checkpoint(), restored(grid.checkpoint(), grid.settings)
    for scan, pose in list(scans())[3:]:
        grid.integrate(scan, pose)
        grid.checkpoint()
    assert_same(then, restored(early, grid.settings))
    assert (early.state.revision, early.state.epoch) == (3, "e")
    with pytest.raises(ValueError, match="read-only"):
        next(early.tiles_since(0)).planes[PLANE][0] = 1


def test_cells_that_a_map_begins_with_count_until_a_scan_has_come():
    grid = grid_of(count=0)
    cells = np.zeros((10, 10), np.int16)
    cells[3, 4] = 77
    grid.begin_with({PLANE: cells}, (-5, 60))
    first = grid.checkpoint()
    assert [(tile.tx, tile.ty, tile.revision) for tile in first.tiles_since(0)] == [(-1, 0, 1)]
    assert_same(grid, restored(first, grid.settings))
    for scan, pose in list(scans())[:1]:
        grid.integrate(scan, pose)
    tiles = list(grid.checkpoint().tiles_since(0))
    assert (-1, 0) in [tile[:2] for tile in tiles]
    assert_same(grid, restored(grid.checkpoint(), grid.settings, tiles))


def test_a_reset_map_is_empty_and_of_its_new_epoch():
    grid = grid_of()
    grid.checkpoint()
    grid.reset("f")
    checkpoint = grid.checkpoint()
    assert checkpoint.state == ("f", 0, None, 0, None, CellRect(0, 0, 0, 0), 0, MapTime(), None, ())
    assert list(checkpoint.tiles_since(0)) == []


def test_a_map_that_is_more_than_it_may_hold_is_refused():
    checkpoint = grid_of().checkpoint()
    small = OccupancyGrid(GridSettings(resolution=0.1, max_bytes=100_000))
    with pytest.raises(LimitReached, match="more than max_bytes = 100000"):
        small.restore(checkpoint.state, checkpoint.tiles_since(0))
    assert small.snapshot().empty


def test_a_tile_outside_the_map_is_refused():
    checkpoint = grid_of().checkpoint()
    tile = next(checkpoint.tiles_since(0))
    for tx, ty in ((-1000, 0), (0, -1000), (1000, 0), (0, 1000)):
        with pytest.raises(IndexError):
            restored(checkpoint, GridSettings(resolution=0.1), [tile._replace(tx=tx, ty=ty)])


@pytest.mark.parametrize("first_room", [4096, 0], ids=["with room", "growing"])
@MODELS
def test_copies_made_ahead_while_the_map_is_written_leave_nothing_wrong(model, first_room, monkeypatch):
    """One thread copies all the time, the other integrates; every checkpoint is the map at its revision."""
    monkeypatch.setattr(store_module, "_FIRST_ROOM", first_room)
    grid, done, copied = grid_of(model, count=0), threading.Event(), []
    lock = threading.Lock()

    def copy():
        while not done.is_set():
            with lock:
                ahead = grid.copy_ahead()
            made = ahead.made()
            with lock:
                grid.take_ahead(ahead, made)
                copied.append(grid._copies is made)

    copying = threading.Thread(target=copy)
    copying.start()
    twin = grid_of(model, count=0)
    try:
        for _ in range(4):
            for scan, pose in scans():
                with lock:
                    grid.integrate(scan, pose)
                twin.integrate(scan, pose)
                with lock:
                    checkpoint = grid.checkpoint()
                assert_same(twin, restored(checkpoint, grid.settings))
    finally:
        done.set()
        copying.join()
    assert any(copied)


def test_what_was_copied_ahead_is_not_copied_again():
    grid = grid_of()
    ahead = grid.copy_ahead()
    made = ahead.made()
    grid.take_ahead(ahead, made)
    assert grid.checkpoint().cells[0].copies.blocks == made.blocks
    scan, pose = list(scans())[6]
    grid.integrate(scan, pose)
    *_, newest = grid.checkpoint().cells[0].copies.blocks
    assert newest.size == len(list(grid.checkpoint().tiles_since(6)))


def test_copies_ahead_of_cells_that_have_moved_count_for_nothing(monkeypatch):
    """A store that has grown has given its memory back: what is read of it then is 0."""
    monkeypatch.setattr(store_module, "_FIRST_ROOM", 0)
    grid, (scan, pose) = grid_of(count=3), list(scans())[11]
    ahead = grid.copy_ahead()
    grid.integrate(scan, pose)
    assert ahead.store is not grid._store
    grid.take_ahead(ahead, ahead.made())
    twin = grid_of(count=3)
    twin.integrate(scan, pose)
    assert_same(twin, restored(grid.checkpoint(), grid.settings))
