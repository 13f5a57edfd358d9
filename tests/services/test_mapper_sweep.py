"""A scan that takes its time: which poses its beams get, and when it is dropped instead."""

import math

import numpy as np
import pytest

from mapper_desk import MS, T0, Desk
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.rules import PlacingRules
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.types import Pose, PoseStamped, Scan

FAST = {"max_speed": math.inf, "max_turn_rate": math.inf}
"""A robot that moves as it likes."""


def test_every_beam_gets_the_pose_of_its_time():
    desk = Desk(**FAST).pose(0, Pose(0, 0, 0)).pose(20, Pose(2, 0, 1)).pose(40, Pose(2, 4, 1))
    desk.scan(10, beams=3, time_increment=0.01)
    assert desk.sink.placed == [(0, Pose(1, 0, 0.5))]
    sweep = desk.sink.sweeps[0]
    assert sweep.beams.tolist() == [[1, 0, 0.5], [2, 0, 1], [2, 2, 1]]
    assert sweep.middle == Pose(2, 0, 1)


def test_the_mount_goes_along():
    desk = Desk(**FAST).pose(0, Pose(0, 0, 0)).pose(20, Pose(0, 0, math.pi / 2))
    desk.scan(0, beams=2, time_increment=0.02, mount=Pose(1, 0, 0.25))
    assert desk.sink.sweeps[0].beams == pytest.approx(np.array([[1, 0, 0.25], [0, 1, math.pi / 2 + 0.25]]))
    assert desk.sink.sweeps[0].middle[2] == pytest.approx(math.pi / 4 + 0.25)


def test_a_scan_at_once_and_one_with_its_own_pose_have_no_sweep():
    desk = Desk().pose(0).pose(100)
    desk.scan(10, beams=5).scan(10, beams=5, time_increment=0.001, pose=Pose(7, 7, 7))
    assert [pose for _, pose in desk.sink.placed] == [pytest.approx((0.01, 0, 0)), Pose(7, 7, 7)]
    assert desk.sink.sweeps == {}


def test_a_gap_between_poses_anywhere_in_the_sweep_is_no_pose():
    desk = Desk().pose(0).pose(100).pose(700)
    desk.scan(50, beams=2, time_increment=0.1)
    assert (desk.order, desk.dropped) == ([], {"no_pose": 1})
    desk.scan(50, beams=2, time_increment=0.05)
    assert desk.order == [1]


def test_an_ambiguous_pose_anywhere_in_the_sweep_is_no_pose():
    desk = Desk().pose(0).pose(20).pose(20, Pose(1, 0, 0)).pose(40).pose(60).pose(80)
    desk.scan(10, beams=6, time_increment=0.01)  # one at 20 ms
    desk.scan(10, beams=2, time_increment=0.05)  # one between 20 and 40 ms
    desk.scan(40, beams=3, time_increment=0.02)
    assert (desk.order, desk.dropped) == ([2], {"no_pose": 2})
    assert "has the stamp of another, different pose" in desk.complaints[-1][2]


def test_a_sweep_that_ends_before_the_oldest_pose_is_no_pose_and_one_that_begins_there_stale():
    desk = Desk().pose(0).pose(20)
    desk.scan(5, beams=11, time_increment=-0.001)
    assert desk.dropped == {"no_pose": 1}
    desk.scan(-1, beams=11, time_increment=0.001)
    assert desk.dropped == {"no_pose": 1, "stale": 1}


@pytest.mark.parametrize("time_increment", [1e290, -1e290, 1e12, 5e-324])
def test_any_time_between_beams_is_placed_or_dropped(time_increment):
    desk = Desk().pose(0).pose(20)
    desk.scan(10, beams=3, time_increment=time_increment)
    desk.pose(40)
    desk.placer.finish()
    desk.check()
    assert desk.order == ([0] if time_increment == 5e-324 else [])
    assert desk.pending == 0


def test_a_map_of_sweeps_is_that_of_their_beams_one_by_one():
    """Through the mapper: a scan of N beams, and N scans of one beam at their own times."""
    maps = []
    for split in (False, True):
        grid = OccupancyGrid(GridSettings(0.1))
        mapper = ScanPlacer(grid, Receipts(), lambda *_: None, PlacingRules(**FAST))
        for n in range(8):
            mapper.add_pose("r", PoseStamped(T0 + 20 * n * MS, Pose(n * 0.2, n * n * 0.05, n * 0.3)))
        ranges = np.linspace(1, 6, 12, dtype=np.float32)
        fields = {"angle_increment": 0.2, "range_min": 0.0, "range_max": 8.0, "mount": Pose(0.1, 0.2, 0.3)}
        if split:
            for k in range(12):
                stamp = T0 + 7 * MS + k * 10 * MS
                mapper.add_scan("r", "s", Scan(stamp, k * 0.2, ranges=ranges[k : k + 1], **fields))
        else:
            mapper.add_scan("r", "s", Scan(T0 + 7 * MS, 0.0, ranges=ranges, time_increment=0.01, **fields))
        maps.append(grid.snapshot())
    assert maps[0].offset == maps[1].offset
    assert np.array_equal(maps[0].cells, maps[1].cells)
    assert (maps[0].revision, maps[1].revision) == (1, 12)
