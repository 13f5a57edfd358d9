"""A robot's pose at a time: exact, between two poses, or not at all."""

import math
import random
import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ogm_core.errors import NoPose
from ogm_core.placing.held import Held
from ogm_core.placing.pose_history import PoseHistory, nearly_equal
from ogm_core.placing.rules import FEWEST_POSES, POSE_GAP, PlacingRules
from ogm_core.types import Pose, shorter_arc

T0 = 1_700_000_000_000_000_000
"""A stamp of our days: float64 would round it to 256 ns."""
MS = 1_000_000
GAP_NS = round(POSE_GAP * 1e9)


def history(*entries, start=T0):
    poses = PoseHistory()
    for after, pose in entries:
        poses.append(start + after, pose)
    return poses


def bits(pose):
    """A pose to the last bit, with the sign of its zeros."""
    return [value.hex() for value in map(float, pose)]


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
        assert bits(poses.at(T0 + k)) == bits(pose)


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
    assert (FEWEST_POSES, len(poses), poses.oldest) == (1024, 1024, T0)
    poses.append(T0 + 102_400 * MS, Pose(1024, 0, 0))
    assert (len(poses), poses.oldest, poses.newest) == (1024, T0 + 100 * MS, T0 + 102_400 * MS)
    assert told(poses, T0) is None
    assert poses.at(T0 + 100 * MS) == Pose(1, 0, 0)


class Twin:
    """A history as plain lists that are searched from end to end."""

    def __init__(self, fewest, most):
        self.fewest, self.most, self.kept, self.ambiguous = fewest, most, [], set()

    def append(self, stamp, pose):
        self.kept.append((stamp, pose))
        while len(self.kept) > self.fewest and (
            stamp - self.kept[0][0] > 60_000_000_000 or len(self.kept) > self.most
        ):
            del self.kept[0]

    def at(self, stamp):
        """The pose, None if nothing is said."""
        for n, (t1, p1) in enumerate(self.kept):
            if t1 == stamp:
                return None if t1 in self.ambiguous else p1
            if t1 > stamp and n:
                t0, p0 = self.kept[n - 1]
                if {t0, t1} & self.ambiguous or (t1 - t0 > GAP_NS and not nearly_equal(p0, p1)):
                    return None
                f, turn = (stamp - t0) / (t1 - t0), shorter_arc(p0.theta, p1.theta)
                return Pose(p0.x + f * (p1.x - p0.x), p0.y + f * (p1.y - p0.y), p0.theta + f * turn)
            if t1 > stamp:
                return None
        return None


@pytest.mark.parametrize("start", [0, T0, 2**63 - 1 - 700 * GAP_NS])
@pytest.mark.parametrize(("fewest", "most"), [(1, 5), (16, 40), (300, 400)])
def test_every_pose_is_that_of_a_list_bit_for_bit(start, fewest, most):
    rng = random.Random(most)
    poses, twin = PoseHistory(PlacingRules(fewest_poses=fewest, most_poses=most)), Twin(fewest, most)
    stamp = start
    for _ in range(500):
        pose = Pose(rng.uniform(-1e3, 1e3), -0.0, rng.choice((1e308, -1e308, rng.uniform(-9, 9))))
        for history in (poses, twin):
            history.append(stamp, pose)
        if rng.random() < 0.1:
            poses.doubt(stamp)
            twin.ambiguous.add(stamp)
        if rng.random() < 0.02:
            assert poses.shorten() == (len(twin.kept) > fewest)
            del twin.kept[:-fewest]
        assert bits(poses.newest_pose) == bits(pose)
        assert (len(poses), poses.oldest, poses.newest) == (len(twin.kept), twin.kept[0][0], stamp)
        oldest = twin.kept[max(0, len(twin.kept) - 6)][0]
        for asked in (oldest - 1, oldest, stamp, stamp + 1, *(rng.randint(oldest, stamp) for _ in range(4))):
            expected, got = twin.at(asked), told(poses, asked)
            assert (got is None) == (expected is None)
            assert got is None or bits(got) == bits(expected)
        stamp += rng.choice((1, 1000, GAP_NS // 2, GAP_NS, GAP_NS + 1))
    assert stamp <= 2**63


def test_stamps_and_poses_lie_together_and_are_never_written_again():
    poses = history(*((k, Pose(k, 2 * k, 3 * k)) for k in range(20)))
    _, stamps, values, _ = poses.state
    for k in range(20, 70_000):
        poses.append(T0 + k, Pose(-1.0, -1.0, -1.0))
    assert stamps.tolist() == [T0 + k for k in range(20)]
    assert values.tolist() == [n * k for k in range(20) for n in (1, 2, 3)]
    assert poses.state.stamps.tolist() == [T0 + k for k in range(70_000 - 65_536, 70_000)]
    assert len(poses.state.poses) == 3 * 65_536
    with pytest.raises(TypeError):
        poses.state.poses[0] = 1.0


def test_a_pose_takes_41_bytes_and_is_counted():
    held = Held()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        poses = PoseHistory(PlacingRules(most_poses=4096), held)
        for k in range(6000):
            poses.append(T0 + k, Pose(k, 0.0, 0.0))
        taken = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert 4096 * 33 <= held.nbytes == poses.nbytes <= 4096 * 33 * 1.25
    assert abs(taken - held.nbytes) < 4096
    assert poses.shorten()
    assert 1024 * 33 <= held.nbytes == poses.nbytes <= 1024 * 33 * 1.25
    assert not poses.shorten()
