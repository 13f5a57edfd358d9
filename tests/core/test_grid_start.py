"""A map that begins with cells of its own."""

import math

import numpy as np
import pytest

from ogm_core.cells.log_odds import PLANE, LogOdds
from ogm_core.errors import LimitReached
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.types import Pose, Scan

BOTH = pytest.mark.parametrize("cells", ["int16", "float64"])


def grid_of(cells="int16", **changes):
    return OccupancyGrid(GridSettings(0.1, LogOdds(cells), anchor=(-3.3, 2.7), **changes), "e")


def start_cells(grid, height=150, width=200):
    """Some known cells, one of them brought back to the prior, away from the edges."""
    cells = np.zeros((height, width), grid.model.dtype)
    cells[10:20, 5:70] = -41 if cells.dtype == np.int16 else -0.75
    cells[100:102, 150] = 1 if cells.dtype == np.int16 else -0.0
    return cells


@BOTH
def test_what_it_begins_with_is_served_at_the_lattices_place(cells):
    grid = grid_of(cells)
    start = start_cells(grid)
    grid.begin_with({PLANE: start})
    snapshot = grid.snapshot()
    assert grid.rect == CellRect(5, 10, 146, 92)
    assert np.array_equal(snapshot.cells.view(np.uint8), start[10:102, 5:151].copy().view(np.uint8))
    assert snapshot.origin == pytest.approx((-3.3 + 0.5, 2.7 + 1.0))
    assert (snapshot.revision, snapshot.stamp, grid.cell_updates) == (0, None, 0)
    assert grid.model.known(snapshot.cells).sum() == 650 + 2


def test_only_tiles_with_a_known_cell_take_memory():
    grid = grid_of()
    grid.begin_with({PLANE: start_cells(grid)})
    # Columns 5 to 69 of row 10 lie in two tiles, column 150 in a third.
    assert grid._store.tiles_used == 3
    blank = grid_of()
    blank.begin_with({PLANE: np.zeros((150, 200), np.int16)})
    assert (blank._store.tiles_used, blank.rect.cells) == (0, 0)


@BOTH
@pytest.mark.parametrize("sensor", ["beam", "sector"])
def test_scans_add_to_it(sensor, cells):
    begun, empty = grid_of(cells, sensor_model=sensor), grid_of(cells, sensor_model=sensor)
    start = start_cells(begun)
    begun.begin_with({PLANE: start})
    scan = Scan(5, 0.0, 0.02, 0.0, 20.0, np.linspace(3, 12, 200, dtype=np.float32))
    pose = Pose(-2.0, 4.0, -0.3)
    assert begun.integrate(scan, pose) == empty.integrate(scan, pose)
    both, scanned = begun.snapshot(), empty.snapshot()
    evidence = np.zeros(both.cells.shape)
    dx, dy = scanned.offset[0] - both.offset[0], scanned.offset[1] - both.offset[1]
    evidence[dy : dy + scanned.height, dx : dx + scanned.width] = scanned.model.log_odds(scanned.cells)
    before = np.zeros(both.cells.shape)
    x, y = both.offset
    part = start[max(0, y) : y + both.height, max(0, x) : x + both.width]
    before[max(0, -y) : max(0, -y) + len(part), max(0, -x) : max(0, -x) + part.shape[1]] = (
        begun.model.log_odds(part)
    )
    total = np.clip(evidence + before, -8.0, 8.0)
    assert both.model.log_odds(both.cells) == pytest.approx(total, abs=1e-9)
    assert np.count_nonzero(before * evidence) > 100
    assert begun.revision == 1


def test_a_reset_empties_it():
    grid = grid_of()
    grid.begin_with({PLANE: start_cells(grid)})
    grid.reset("f")
    assert grid.snapshot().empty


@pytest.mark.parametrize("limit", ["max_cells", "max_bytes"])
def test_more_than_the_limits_is_refused_whole(limit):
    grid = grid_of(**{limit: {"max_cells": 150 * 200 - 1, "max_bytes": 3 * 8192}[limit]})
    with pytest.raises(LimitReached, match=limit):
        grid.begin_with({PLANE: start_cells(grid)})
    assert grid.snapshot().empty
    roomy = grid_of(**{limit: {"max_cells": 150 * 200, "max_bytes": 40_000}[limit]})
    roomy.begin_with({PLANE: start_cells(roomy)})


def test_an_anchor_moves_the_lattice_of_an_unbounded_map():
    grid, plain = grid_of(), OccupancyGrid(GridSettings(0.1))
    scan = Scan(1, 0.0, 0.1, 0.0, 9.0, np.array([1.0, 2.0, math.inf], np.float32))
    grid.integrate(scan, Pose(0.05, 0.03, 0.2))
    plain.integrate(scan, Pose(0.05 + 3.3, 0.03 - 2.7, 0.2))
    assert np.array_equal(grid.snapshot().cells, plain.snapshot().cells)
    assert grid.snapshot().offset == plain.snapshot().offset
