"""Where counts stop: beams that are counted one by one stop where sums of whole maps do."""

import numpy as np
import pytest

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.rate import PLANES, Rate
from ogm_core.cells.rate_sums import add_counts
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.types import Pose, Scan

SETTINGS = GridSettings(resolution=0.1, cell_model=Rate(), bounds=Region(-3.2, -3.2, 3.2, 3.2))
MOST = {"F": 2**16 - 1, "E": 2**32 - 1, "H": 2**32 - 1}


def planes_of(grid):
    return CellArrays(grid.snapshot().stored.planes(), {plane.name: plane.side for plane in PLANES}).planes()


def mapped(begun_with=None, scans=3):
    """Beams all around, many of which end in the same halves, and some of which meet nothing."""
    grid = OccupancyGrid(SETTINGS, "e")
    if begun_with is not None:
        grid.begin_with(begun_with)
    ranges = np.tile([1.5, 2.0, 2.04, 9.0], 90).astype(np.float32)
    for k in range(scans):
        scan = Scan(k, -np.pi, 2 * np.pi / ranges.size, 0.01, 9.0, ranges)
        grid.integrate(scan, Pose(0.03 * k, 0.02, 0.1 * k))
    return grid


def nearly_full(rng, below):
    """Planes that lack up to `below` of what they hold."""
    planes = {
        plane.name: np.iinfo(plane.dtype).max - rng.integers(0, below, (64 * plane.side,) * 2, plane.dtype)
        for plane in PLANES
    }
    return planes | {"C": np.where(rng.random((64, 64)) < 0.5, 65535, 65534).astype(np.uint16)}


@pytest.mark.parametrize("below", [3, 200, 60_000])
def test_what_is_counted_stops_where_sums_of_maps_stop(below):
    begun_with = nearly_full(np.random.default_rng(below), below)
    sums = {name: plane.copy() for name, plane in begun_with.items()}
    counted = planes_of(mapped())
    add_counts(sums, counted)
    found = planes_of(mapped(begun_with))
    for name, plane in sums.items():
        assert np.array_equal(found[name], plane), name
    for name, most in MOST.items():
        stopped = begun_with[name].astype(np.int64) + counted[name] > most
        assert stopped.any() or below == 60_000
        assert (found[name][stopped] == most).all()
    passing = [(p["C"].astype(np.int64) << 16) + p["N"] for p in (begun_with, counted, found)]
    full = passing[0] + passing[1] >= 2**32
    assert full.any()
    assert (passing[2][full] == 2**32 - 1).all()
    assert np.array_equal(passing[2][~full], (passing[0] + passing[1])[~full])
