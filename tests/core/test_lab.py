"""The textbook exercise: 220 simulated scans in the lab, against the plain float64 computation."""

import numpy as np
import pytest

import naive
from ogm_core.cells.classes import trinary
from ogm_core.cells.log_odds import LogOdds
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.simulation.lidar import Lidar, measure
from ogm_core.simulation.worlds import lab
from ogm_core.types import Scan

SEED = 1
ROUND = 220


def lab_settings(cells):
    return GridSettings(
        resolution=0.1,
        cell_model=LogOdds(cells),
        alpha=0.2,
        bounds=Region(-10.0, -10.0, 10.0, 10.0),
        outside="drop",
    )


@pytest.fixture(scope="module")
def placed():
    """The scans of one round, and the poses they were taken at."""
    world, sensor, rng = lab(), Lidar.lab(), np.random.default_rng(SEED)
    poses = [world.path.pose(i) for i in range(ROUND)]
    scans = [
        Scan(
            stamp=i,
            angle_min=sensor.angle_min,
            angle_increment=sensor.angle_increment,
            range_min=sensor.range_min,
            range_max=sensor.range_max,
            ranges=measure(world, pose, sensor, rng),
        )
        for i, pose in enumerate(poses)
    ]
    return list(zip(scans, poses, strict=True))


def built(cells, placed):
    grid = OccupancyGrid(lab_settings(cells), "lab")
    for scan, pose in placed:
        grid.integrate(scan, pose)
    return grid


@pytest.fixture(scope="module")
def float_grid(placed):
    return built("float64", placed)


@pytest.fixture(scope="module")
def twin(placed):
    textbook = naive.Map(lab_settings("float64"))
    textbook.updates = sum(textbook.integrate(scan, pose) for scan, pose in placed)
    return textbook


def test_the_scans_are_those_of_the_exercise(placed):
    scan, pose = placed[55]
    assert pose == pytest.approx((0.0, 6.0, np.pi), abs=1e-12)
    assert (scan.ranges.dtype, scan.ranges.shape) == (np.float32, (360,))
    assert (scan.angle_min, scan.angle_increment, scan.range_max) == (-np.pi, 2 * np.pi / 360, 8.0)
    assert scan.ranges[90] == pytest.approx(
        4.0, abs=0.1
    )  # heading west, beam 90 looks north: the wall at 10 m
    shares = [np.mean(scan.ranges >= 8.0) for scan, _ in placed]
    assert 0.1 < np.mean(shares) < 0.6


def test_the_float64_map_is_the_plain_computation_bit_for_bit(float_grid, twin):
    snapshot = float_grid.snapshot()
    assert (snapshot.cells.shape, snapshot.cells.dtype) == ((200, 200), np.float64)
    expected = twin.log_odds((0, 0), 200, 200)
    known = snapshot.model.known(snapshot.cells)
    assert np.array_equal(known, ~np.isnan(expected))
    assert np.array_equal(
        np.where(known, snapshot.model.log_odds(snapshot.cells), np.nan), expected, equal_nan=True
    )
    assert float_grid.cell_updates == twin.updates
    assert float_grid.revision == ROUND
    assert np.count_nonzero(known) > 20_000


def test_the_int16_map_says_the_same(float_grid, placed):
    exact, stored = float_grid.snapshot(), built("int16", placed).snapshot()
    assert stored.cells.dtype == np.int16
    assert np.array_equal(stored.model.known(stored.cells), exact.model.known(exact.cells))
    difference = stored.model.probability(stored.cells) - exact.model.probability(exact.cells)
    assert np.abs(difference).max() <= 0.002
    classes = stored.model.encode(stored.cells, trinary)
    assert np.array_equal(classes, exact.model.encode(exact.cells, trinary))
    assert np.unique(classes).size == 3


def test_the_map_shows_the_lab(float_grid):
    snapshot = float_grid.snapshot()
    log_odds, known = snapshot.model.log_odds(snapshot.cells), snapshot.model.known(snapshot.cells)

    def at(array, x, y):
        ix, iy = snapshot.lattice.cell_of(x, y)
        return array[iy, ix]

    assert at(log_odds, 0.05, 0.05) == -8.0
    assert at(log_odds, 9.95, 0.05) == 8.0  # the east wall
    assert at(log_odds, 2.5, -2.0) > 5.0  # the southern edge of a circle
    assert at(log_odds, 2.5, -2.15) == -8.0
    assert not at(known, 2.5, -1.0)  # its middle
