"""A robot's pose at a time: exact, between two poses, or not at all."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ogm_core.errors import NoPose
from ogm_core.placing.pose_history import CAPACITY, PoseHistory
from ogm_core.placing.rules import POSE_GAP
from ogm_core.types import Pose

T0 = 1_700_000_000_000_000_000
"""A stamp of our days: float64 would round it to 256 ns."""
MS = 1_000_000
GAP_NS = round(POSE_GAP * 1e9)


def history(*entries, start=T0):
    poses = PoseHistory()
    for after, pose in entries:
        poses.append(start + after, pose)
    return poses


def told(poses, stamp):
    """The pose at a stamp, None if it cannot be told."""
    try:
        return poses.at(stamp)
    except NoPose:
        return None


def test_equal_stamps_give_that_pose_itself():
    kept = [Pose(0.1 * k, math.pi * k, -1e3 * k) for k in range(5)]
    poses = history(*((k, pose) for k, pose in enumerate(kept)))
    for k, pose in enumerate(kept):
        assert poses.at(T0 + k) is pose


def test_an_equal_stamp_needs_no_neighbour():
    poses = history((0, Pose(1, 2, 3)), (10 * GAP_NS, Pose(4, 5, 6)))
    assert poses.at(T0) == Pose(1, 2, 3)
    assert poses.at(T0 + 10 * GAP_NS) == Pose(4, 5, 6)


def test_nothing_is_extrapolated():
    poses = history((0, Pose(1, 2, 3)), (100, Pose(4, 5, 6)))
    assert told(PoseHistory(), T0) == told(poses, T0 - 1) == told(poses, T0 + 101) is None


@pytest.mark.parametrize(
    ("share", "expected"), [(0.25, (1.0, -1.5, 0.7)), (0.5, (2.0, -1.0, 0.9)), (0.75, (3.0, -0.5, 1.1))]
)
def test_position_and_heading_are_linear(share, expected):
    poses = history((0, Pose(0.0, -2.0, 0.5)), (400 * MS, Pose(4.0, 0.0, 1.3)))
    assert poses.at(T0 + round(share * 400 * MS)) == pytest.approx(expected, abs=1e-12)


def test_stamps_are_compared_to_the_nanosecond():
    poses = history((0, Pose(0.0, 0.0, 0.0)), (10, Pose(10.0, 0.0, 0.0)), (20, Pose(10.0, 50.0, 0.0)))
    assert [poses.at(T0 + k).x for k in (3, 7, 11)] == pytest.approx([3.0, 7.0, 10.0])
    assert poses.at(T0 + 11).y == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("start", "end", "middle"),
    [
        (3.0, -3.0, math.pi),
        (-3.0, 3.0, -math.pi),
        (math.radians(170), math.radians(-150), math.radians(190)),
        (0.0, 5 * math.tau + 0.2, 0.1),
        (7 * math.tau + 0.2, 0.0, 7 * math.tau + 0.1),
        (0.0, 3.1, 1.55),
        (0.0, -3.1, -1.55),
        (0.0, 3.2, (3.2 - math.tau) / 2),
    ],
)
def test_heading_takes_the_shortest_arc_and_is_not_normalised(start, end, middle):
    poses = history((0, Pose(0, 0, start)), (200, Pose(0, 0, end)))
    assert poses.at(T0 + 100).theta == pytest.approx(middle, abs=1e-9)


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.integers(1, 999))
def test_the_arc_never_exceeds_half_a_turn(start, end, after):
    theta = history((0, Pose(0, 0, start)), (1000, Pose(0, 0, end))).at(T0 + after).theta
    share = after / 1000
    assert abs(theta - start) <= math.pi * share + 1e-9
    # Where it leads is the other heading, up to whole turns.
    assert abs(math.remainder(start + (theta - start) / share - end, math.tau)) < 1e-6


def test_headings_too_far_apart_for_a_float_still_have_a_finite_one_between():
    poses = history((0, Pose(0, 0, -1.7e308)), (100, Pose(1, 0, 1.7e308)))
    assert all(map(math.isfinite, poses.at(T0 + 50)))


@pytest.mark.parametrize(("gap", "known"), [(GAP_NS, True), (GAP_NS + 1, False)])
def test_poses_more_than_half_a_second_apart_say_nothing_between_them(gap, known):
    poses = history((0, Pose(0, 0, 0)), (gap, Pose(1, 0, 0)), (gap + 10, Pose(2, 0, 0)))
    assert (told(poses, T0 + 1) is not None) == known
    assert (told(poses, T0 + gap - 1) is not None) == known
    assert poses.at(T0 + gap + 5) == pytest.approx((1.5, 0, 0))
    assert GAP_NS == 500 * MS


def test_an_ambiguous_stamp_says_nothing_of_itself_and_of_the_time_beside_it():
    poses = history(*((k, Pose(k, 0, 0)) for k in (0, 10, 20, 30)))
    poses.doubt(T0 + 10)
    for k in (1, 10, 19):
        with pytest.raises(NoPose, match="stamp of another, different pose"):
            poses.at(T0 + k)
    assert [poses.at(T0 + k).x for k in (0, 20, 25)] == [0, 20, pytest.approx(25)]


def test_old_poses_are_forgotten_when_there_are_1024_of_60_s():
    poses = PoseHistory()
    assert (len(poses), poses.oldest, poses.newest) == (0, None, None)
    for k in range(1024):
        poses.append(T0 + 100 * k * MS, Pose(k, 0, 0))
    assert (CAPACITY, len(poses), poses.oldest) == (1024, 1024, T0)
    poses.append(T0 + 102_400 * MS, Pose(1024, 0, 0))
    assert (len(poses), poses.oldest, poses.newest) == (1024, T0 + 100 * MS, T0 + 102_400 * MS)
    assert told(poses, T0) is None
    assert poses.at(T0 + 100 * MS) == Pose(1, 0, 0)
