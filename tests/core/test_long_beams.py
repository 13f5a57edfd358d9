"""Beams of ten thousand cells, and scans of a hundred thousand beams."""

import math

import numpy as np
import pytest

import naive
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.types import Pose, Scan

VARIANTS = {
    "bresenham": {"traversal": "bresenham"},
    "dda": {"traversal": "dda"},
    "sector": {"sensor_model": "sector"},
}


def scan_of(ranges, increment, range_max):
    return Scan(0, -math.pi, increment, 0.0, range_max, np.asarray(ranges, np.float32))


def log_odds_of(grid):
    snapshot = grid.snapshot()
    known = snapshot.model.known(snapshot.cells)
    return np.where(known, snapshot.model.log_odds(snapshot.cells), np.nan)


@pytest.mark.parametrize("theta", [0.0, 1.5])
@pytest.mark.parametrize("traversal", ["bresenham", "dda"])
def test_beams_of_200_m_in_cells_of_2_cm(traversal, theta):
    settings = GridSettings(resolution=0.02, traversal=traversal)
    grid, twin = OccupancyGrid(settings), naive.Map(settings)
    ranges = [200.0, *np.random.default_rng(1).uniform(150.0, 200.0, 10)]
    scan = Scan(0, -0.05, 0.01, 0.0, 200.0, np.array(ranges, np.float32))
    pose = Pose(-73.217, 1234.5, theta)
    assert grid.integrate(scan, pose) == twin.integrate(scan, pose) > 80_000
    expected = twin.log_odds(grid.rect[:2], grid.rect.width, grid.rect.height)
    assert np.array_equal(log_odds_of(grid), expected, equal_nan=True)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_scan_of_100_000_beams(variant):
    settings = GridSettings(**VARIANTS[variant])
    grid = OccupancyGrid(settings)
    ranges = 1.0 + 0.3 * np.sin(np.arange(100_000) * 2 * math.pi / 20_000)
    scan, pose = scan_of(ranges, 2 * math.pi / 100_000, 8.0), Pose(0.01, 0.02, 0.3)
    updates = grid.integrate(scan, pose)
    if variant == "bresenham":  # exact arithmetic takes minutes for so many beams
        twin = naive.Map(settings)
        assert updates == twin.integrate(scan, pose)
        rect = grid.rect
        expected = twin.log_odds((rect.ix, rect.iy), rect.width, rect.height)
        assert np.array_equal(log_odds_of(grid), expected, equal_nan=True)
    # Five bumps: their mean of r^2 / 2 over a turn is pi (1 + 0.3^2 / 2) m2; half of alpha more is occupied.
    area = np.count_nonzero(~np.isnan(log_odds_of(grid))) * 0.05**2
    assert area == pytest.approx(math.pi * (1.05**2 + 0.3**2 / 2), rel=0.05)
