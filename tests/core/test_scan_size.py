"""Size of a scan in cells, told from its ranges, against the updates that it makes."""

import math

import numpy as np
import pytest

from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.sensor_models.scan_size import ScanSize
from ogm_core.types import Pose, Scan

NAN, INF = math.nan, math.inf


def size(settings, ranges, *, increment=0.1, range_min=0.1, range_max=8.0, **more):
    return ScanSize(settings).cells(np.asarray(ranges, np.float32), increment, range_min, range_max, **more)


@pytest.mark.parametrize(
    ("ranges", "metres"),
    [
        ([2.0], 2.0),
        ([1.0, 2.0, 3.0], 6.0),
        ([INF], 8.0),
        ([8.0], 8.0),
        ([7.99], 7.99),
        ([NAN, -1.0, 0.0, -INF, 0.05, 8.1], 0.0),
        ([], 0.0),
    ],
)
def test_a_beam_speaks_of_the_cells_along_its_free_length(ranges, metres):
    assert size(GridSettings(0.05), ranges) == pytest.approx(metres / 0.05, rel=1e-6)


def test_limits_of_the_map_and_of_the_sensor_shorten_beams():
    ranges = [6.0, INF]
    assert size(GridSettings(0.5, reach=4.0), ranges) == pytest.approx(16.0)
    assert size(GridSettings(0.5, clear_range=3.0), ranges) == pytest.approx(12.0 + 6.0)
    assert size(GridSettings(0.5, reach=4.0), ranges, reach=2.0) == pytest.approx(8.0)
    assert size(GridSettings(0.5, clear_range=3.0), ranges, clear_range=1.0) == pytest.approx(12.0 + 2.0)
    assert size(GridSettings(0.5), [9.0], beyond_clears=True) == pytest.approx(16.0)


def test_no_beam_is_longer_than_a_map_with_bounds():
    bounds = Region(0.0, 0.0, 10.0, 20.0)
    settings = GridSettings(0.5, bounds=bounds)
    assert size(settings, [900.0] * 3, range_max=1000.0) == 3 * 60
    settings = GridSettings(0.5, bounds=bounds, sensor_model="sector", alpha=0.5)
    assert size(settings, [900.0] * 30, range_max=1000.0, increment=0.2) < 20 * 40 + 2 * 60


@pytest.mark.parametrize("sensor_model", ["beam", "sector"])
@pytest.mark.parametrize("seed", range(5))
def test_it_is_about_the_number_of_updates(sensor_model, seed):
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(2.0, 7.0, 360).astype(np.float32)
    ranges[rng.integers(0, 360, 40)] = rng.choice([NAN, INF, 0.0], 40)
    settings = GridSettings(0.05, sensor_model=sensor_model)
    scan = Scan(0, -math.pi, math.tau / 360, 0.1, 8.0, ranges)
    updates = OccupancyGrid(settings).integrate(scan, Pose(0.3, 0.2, 0.1))
    found = size(settings, ranges, increment=scan.angle_increment)
    if sensor_model == "beam":
        assert updates <= found * 1.02
        assert found <= updates * 1.4142
    else:  # its outline goes out and back again between such beams, which takes as long as that area
        outline = np.nansum(np.abs(np.diff(np.nan_to_num(ranges, posinf=8.0)))) / 0.05
        assert found - outline == pytest.approx(updates, rel=0.05)
