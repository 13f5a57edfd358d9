"""Maps of counts that forget: what becomes of a door that closes, of a box that goes, of what nobody sees."""

import math

import numpy as np
import pytest

from ogm_core.cells.rate import PLANES, Rate
from ogm_core.cells.rate_sums import halved_counts
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.types import Pose, Scan

SECOND = 10**9
HALF_LIFE = 4.0
A_SECOND = 5
"""Scans."""
BEARINGS = np.arange(-30, 31) * 0.01
NEAR, FAR = 2.0, 4.0


class Robot:
    """It stands before a wall, and maps it with a half-life or without."""

    def __init__(self, half_life=HALF_LIFE):
        settings = GridSettings(0.05, Rate(), half_life=half_life)
        self.grid = OccupancyGrid(settings, "e")
        self.scans = 0

    def look(self, half_lives, distance, y=0.01):
        """At a wall so far ahead."""
        for _ in range(round(half_lives * HALF_LIFE * A_SECOND)):
            ranges = (distance / np.cos(BEARINGS)).astype(np.float32)
            scan = Scan(self.scans * SECOND // A_SECOND, -0.3, 0.01, 0.0, 8.0, ranges)
            self.grid.integrate(scan, Pose(0.01, y, 0.0))
            self.scans += 1

    def said(self, distance):
        """Of the cell so far ahead: p, None where unknown."""
        snapshot = self.grid.snapshot().finest()
        x, y = snapshot.origin
        column, row = (math.floor(d / snapshot.resolution) for d in (distance + 0.01 - x, 0.01 - y))
        p, known = snapshot.published(slice(row, row + 1), slice(column, column + 1))
        return p.item() if known.item() else None


def test_a_door_that_closes_is_a_wall_after_half_a_half_life():
    forgetting, keeping = Robot(), Robot(half_life=None)
    for robot in (forgetting, keeping):
        robot.look(20, FAR)
        assert robot.said(NEAR) < 0.05
        robot.look(0.25, NEAR)
        assert robot.said(NEAR) < 0.65
        robot.look(0.35, NEAR)
    assert forgetting.said(NEAR) > 0.65
    assert keeping.said(NEAR) < 0.196


def test_a_box_that_goes_is_undecided_after_two_half_lives_and_free_after_four():
    forgetting, keeping = Robot(), Robot(half_life=None)
    for robot in (forgetting, keeping):
        robot.look(20, NEAR)
        robot.look(1.5, FAR)
        assert robot.said(NEAR) > 0.65
        robot.look(0.75, FAR)
    assert 0.196 < forgetting.said(NEAR) < 0.65
    for robot in (forgetting, keeping):
        robot.look(2, FAR)
    assert forgetting.said(NEAR) < 0.196
    assert keeping.said(NEAR) > 0.95


def test_what_nobody_sees_stays_what_it_was_until_nothing_is_left_of_it_and_is_unknown_then():
    robot, told = Robot(), []
    robot.look(1, FAR)
    for _ in range(16):
        robot.look(1, FAR, y=-40.0)
        told.append((robot.said(FAR), robot.said(NEAR)))
    wall, floor = ([_class_of(p) for p in said] for said in zip(*told, strict=True))
    assert wall == ["occupied"] * 11 + ["undecided"] * 3 + ["unknown"] * 2
    assert floor == ["free"] * 9 + ["unknown"] * 7


def _class_of(p):
    if p is None:
        return "unknown"
    return "occupied" if p > 0.65 else "free" if p < 0.196 else "undecided"


@pytest.mark.parametrize("times", [1, 5, 16, 31, 32, 56])
def test_counts_are_halved_and_halves_of_counts_are_lost(times):
    rng = np.random.default_rng(times)
    planes = {}
    for name, dtype, side in PLANES:
        most = np.iinfo(dtype).max
        planes[name] = rng.integers(0, most, (6 * side, 9 * side), dtype, endpoint=True)
        planes[name].reshape(-1)[:4] = 0, 1, most, most - 1
    left = halved_counts(planes, times)
    assert {name: cells.dtype for name, cells in left.items()} == {kind.name: kind.dtype for kind in PLANES}
    for name in "FEH":
        assert [n >> times for n in planes[name].ravel().tolist()] == left[name].ravel().tolist()
    passing = [n + 65536 * c for n, c in zip(*(planes[x].ravel().tolist() for x in "NC"), strict=True)]
    halved = [n + 65536 * c for n, c in zip(*(left[x].ravel().tolist() for x in "NC"), strict=True)]
    assert halved == [n >> times for n in passing]
