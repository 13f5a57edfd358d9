"""A copy of a map of counts is the map that its mapper serves, cell for cell."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ogm_client import BadReply, MapGrid
from ogm_client.map_copy import MapCopy, Taken
from ogm_core.cells.classes import trinary
from ogm_core.cells.rate import Rate
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.tiles.changes import ChangedTiles
from ogm_core.types import Pose, Scan
from ogm_core.wire.map_changes import updates_of
from ogm_core.wire.map_update import decode_updates, encode_update

MUCH = 2**30


def scan_at(stamp, rng):
    ranges = rng.uniform(0.5, 9.5, 48).astype(np.float32)
    return Scan(stamp, -math.pi, math.tau / 48, 0.1, 9.0, ranges)


def message(snapshot, since=None):
    changed = ChangedTiles.since(snapshot.stored.tiles, since or 0)
    (update,) = updates_of(snapshot, changed, since or 0, whole=since is None)
    (told,) = decode_updates(encode_update(update))
    return told


@pytest.mark.parametrize("coarse", [False, True])
def test_a_copy_is_the_map_that_is_served_after_every_change(coarse):
    rng = np.random.default_rng(5)
    grid = OccupancyGrid(GridSettings(resolution=0.25, cell_model=Rate()), "e", "r")
    copy, x, y, since = MapCopy(MUCH, coarse=coarse), 0.0, 0.0, None
    for stamp in range(12):
        grid.integrate(scan_at(stamp, rng), Pose(x, y, rng.uniform(-4.0, 4.0)))
        x, y = x - rng.uniform(0.0, 6.0), y + rng.normal(0.0, 3.0)
        snapshot = grid.snapshot()
        assert copy.take(message(snapshot, since)) is Taken.APPLIED
        since = snapshot.revision
        served = snapshot if coarse else snapshot.finest()
        expected, found = MapGrid.from_snapshot(served), copy.grid()
        # The mapper's are made by compiled code, which may round the last bit otherwise.
        np.testing.assert_allclose(found.log_odds, expected.log_odds, rtol=2e-7, strict=True)
        np.testing.assert_array_equal(found.occupancy, expected.occupancy)
        for name in ("resolution", "anchor", "offset", "epoch", "run", "revision", "stamp"):
            assert getattr(found, name) == getattr(expected, name)
    assert found.resolution == (0.25 if coarse else 0.125)
    assert found.offset[0] < (-64 if coarse else -128)
    assert (found.occupancy == 100).any()


def test_counts_that_are_others_or_too_many_are_refused():
    grid = OccupancyGrid(GridSettings(resolution=0.25, cell_model=Rate()), "e", "r")
    grid.integrate(scan_at(1, np.random.default_rng(1)), Pose(0.0, 0.0, 0.0))
    told = message(grid.snapshot())
    copy = MapCopy(MUCH)
    copy.take(replace(told, extent=CellRect(0, 0, 10**4, 10**4)))
    with pytest.raises(BadReply, match=r"its cells take 1600000000 bytes, at most 1073741824 are allowed"):
        copy.grid()
    copy = MapCopy(MUCH)
    names = [plane.name for plane in told.planes[:-1]]
    other = replace(told, planes=told.planes[:-1], cells={name: told.cells[name] for name in names})
    assert copy.take(other) is Taken.APPLIED
    with pytest.raises(BadReply, match=r"in other planes than known here: N, C, F, E$"):
        copy.grid()


@pytest.mark.parametrize("coarse", [False, True])
def test_a_copy_calls_free_what_its_mapper_does(coarse):
    grid = OccupancyGrid(GridSettings(resolution=0.25, cell_model=Rate(free_below=0.05)), "e", "r")
    for stamp in range(4):
        grid.integrate(scan_at(stamp, np.random.default_rng(stamp)), Pose(0.1, 0.2, 0.3 * stamp))
    copy = MapCopy(MUCH, coarse=coarse)
    assert copy.take(message(grid.snapshot())) is Taken.APPLIED
    found, expected = copy.grid(), grid.snapshot() if coarse else grid.snapshot().finest()
    assert found.free_below == 0.05
    np.testing.assert_array_equal(found.occupancy, expected.encode(trinary))
    assert (found.occupancy != replace(found, free_below=0.196).occupancy).any()


@pytest.mark.parametrize("told", [0.0, 0.65, math.nan, "0.05"])
def test_a_free_below_that_separates_nothing_is_refused(told):
    grid = OccupancyGrid(GridSettings(resolution=0.25, cell_model=Rate()), "e", "r")
    grid.integrate(scan_at(1, np.random.default_rng(1)), Pose(0.0, 0.0, 0.0))
    update, copy = message(grid.snapshot()), MapCopy(MUCH)
    copy.take(replace(update, model={**update.model, "free_below": told}))
    with pytest.raises(BadReply, match=r"map\.tiles: free_below .* is no probability below 0\.65"):
        copy.grid()
