"""Maps that keep robots apart: scans of three robots, in some order, and their maps."""

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.rate import PLANES, Rate
from ogm_core.errors import OutsideBounds
from ogm_core.grid_settings import GridSettings
from ogm_core.separate_grid import grid_of
from ogm_core.types import Pose, Scan

SIDES = {plane.name: plane.side for plane in PLANES}
WHERE = {"a": (-1.0, 0.0), "b": (3.5, 2.0), "c": (-30.0, 19.0)}
"""About where each robot drives, m: the first two see each other's places, the third its own alone."""


def settings_with(**changes):
    return GridSettings(**{"resolution": 0.1, "cell_model": Rate(), "separate_robots": True, **changes})


SCANS = 5


def scans_of(robot, count=SCANS, beams=70):
    rng = np.random.default_rng(ord(robot))
    for k in range(count):
        ranges = rng.uniform(0.05, 7.0, beams).astype(np.float32)
        ranges[rng.random(beams) < 0.2] = math.inf
        x, y = WHERE[robot] + rng.uniform(-1.0, 1.0, 2)
        yield robot, Scan(10**9 + k, -math.pi, math.tau / beams, 0.01, 6.5, ranges), Pose(x, y, rng.uniform())


def in_some_order(*robots, seed=1):
    """Scans of some robots, those of each in their order."""
    left = [scans_of(robot) for robot in robots]
    turns = np.random.default_rng(seed).permutation(np.repeat(np.arange(len(robots)), SCANS))
    return [next(left[n]) for n in turns]


def mapped(settings, *robots, seed=1, grid=None):
    grid = grid_of(settings, "e", "r") if grid is None else grid
    for robot, scan, pose in in_some_order(*robots, seed=seed):
        with suppress(OutsideBounds):
            grid.integrate(scan, pose, None, robot)
    return grid


def plain(settings):
    return replace(settings, separate_robots=False)


def planes_of(grid):
    return CellArrays(grid.snapshot().stored.planes(), SIDES).planes()


def assert_same_cells(a, b):
    """Equal cells, bit for bit, and an equal rectangle."""
    assert a.rect == b.rect
    other = planes_of(b)
    for name, cells in planes_of(a).items():
        assert cells.tobytes() == other[name].tobytes(), name
