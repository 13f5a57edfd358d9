"""What becomes of scans and poses that are not used, and that the books balance."""

import pytest

from mapper_desk import MS, T0, Desk, Sink
from ogm_core.errors import LimitReached, OutsideBounds
from ogm_core.placing.pose_history import CAPACITY
from ogm_core.placing.scan_placer import MAX_WAITING
from ogm_core.status import PoseCounts, SourceStatus
from ogm_core.types import Pose


def test_stale_is_before_the_oldest_kept_pose():
    desk = Desk().pose(100).pose(200)
    desk.scan(99.999999).scan(100)
    assert (desk.order, desk.dropped) == ([1], {"stale": 1})


def test_stale_is_said_at_once_even_if_the_sweep_ends_later():
    desk = Desk().pose(100).scan(90, beams=101, time_increment=0.001)
    assert (desk.pending, desk.dropped) == (0, {"stale": 1})


def test_a_waiting_scan_is_stale_once_its_pose_is_no_longer_kept():
    desk = Desk().pose(0).scan(0, beams=2, time_increment=CAPACITY / 1000)
    for ms in range(1, CAPACITY):
        desk.pose(ms)
    assert desk.pending == 1
    desk.pose(CAPACITY)
    assert (desk.order, desk.dropped) == ([], {"stale": 1})


def test_only_1024_poses_are_kept():
    desk = Desk()
    for ms in range(CAPACITY + 1):
        desk.pose(ms)
    desk.scan(0).scan(1)
    assert (desk.order, desk.dropped) == ([1], {"stale": 1})


def test_a_gap_of_more_than_half_a_second_has_no_pose():
    desk = Desk().pose(0).pose(500).pose(1000.000001)
    desk.scan(499).scan(501).scan(1000).scan(1000.000001).scan(500)
    assert (desk.order, desk.dropped) == ([0, 3, 4], {"no_pose": 2})


def test_a_gap_closes_over_a_waiting_scan():
    desk = Desk().pose(0).scan(100).pose(600)
    assert (desk.order, desk.pending, desk.dropped) == ([], 0, {"no_pose": 1})


def test_a_scan_gives_up_when_64_later_ones_of_its_sensor_wait():
    assert MAX_WAITING == 64
    desk = Desk().pose(0)
    for ms in range(10, 10 + 65):
        assert desk.dropped == {}
        desk.scan(ms)
    assert (desk.pending, desk.dropped) == (64, {"no_pose": 1})
    desk.scan(5000)
    assert (desk.pending, desk.dropped) == (64, {"no_pose": 2})
    desk.pose(100)
    assert (desk.order, desk.pending) == (list(range(2, 65)), 1)


def test_scans_of_other_sensors_do_not_push_one_out():
    desk = Desk().pose(0).scan(10, sensor="quiet")
    for ms in range(1, 101):
        desk.scan(ms, sensor="busy").scan(ms, robot="other")
    assert desk.dropped == {"no_pose": 2 * (100 - 64)}
    desk.pose(10)
    assert desk.order == [0]


@pytest.mark.parametrize(
    ("seqs", "integrated"),
    [
        ([0, 1, 2], [0, 1, 2]),
        ([0, 0], [0]),
        ([5, 4, 6, 5, 7], [5, 6, 7]),
        ([3, 100, 4], [3, 100]),
    ],
)
def test_a_seq_that_is_not_above_the_last_is_a_duplicate(seqs, integrated):
    desk = Desk().pose(0)
    for seq in seqs:
        desk.scan(0, seq=seq, run="a")
    assert desk.order == integrated
    duplicates = len(seqs) - len(integrated)
    assert desk.dropped == ({"duplicate": duplicates} if duplicates else {})


def test_seqs_are_counted_by_robot_sensor_and_run():
    desk = Desk().pose(0).pose(0, robot="q")
    for where in ({}, {"run": "b"}, {"sensor": "t"}, {"robot": "q"}):
        desk.scan(0, **{"seq": 3, "run": "a", **where})
    assert desk.order == [3] * 4
    for where in ({}, {"run": "b"}, {"sensor": "t"}, {"robot": "q"}):
        desk.scan(0, **{"seq": 3, "run": "a", **where})
    assert (desk.order, desk.dropped) == ([3] * 4, {"duplicate": 4})


def test_a_scan_without_a_run_is_never_a_duplicate():
    desk = Desk().pose(0).scan(0, seq=0).scan(0, seq=0)
    assert (desk.order, desk.dropped) == ([0, 0], {})


def test_a_scan_that_waits_dropped_or_carries_its_pose_counts_as_seen():
    desk = Desk().pose(0)
    desk.scan(10, seq=1, run="a").scan(10, seq=1, run="a")
    desk.scan(-5, seq=2, run="a").scan(0, seq=2, run="a")
    desk.scan(0, seq=3, run="a", pose=Pose(0, 0, 0)).scan(0, seq=3, run="a", pose=Pose(0, 0, 0))
    assert (desk.pending, desk.dropped) == (1, {"duplicate": 3, "stale": 1})
    assert desk.pose(10).order == [3, 1]


def test_a_pose_that_is_not_later_is_counted_and_ignored():
    desk = Desk().pose(0).pose(100).scan(150)
    desk.pose(100, Pose(9, 9, 9)).pose(50, Pose(9, 9, 9))
    assert desk.receipts.status().poses == PoseCounts(received=4, malformed=0, late=2)
    assert desk.receipts.status().robots["r"].stamp == T0 + 100 * MS
    desk.scan(50).scan(100).pose(200)
    assert desk.xs == pytest.approx([0.05, 0.1, 0.15])


def test_a_new_run_begins_a_new_history():
    desk = Desk().pose(1000, run="a").pose(1100, run="a").scan(1200).scan(1300)
    desk.pose(10, Pose(-1, 0, 0), run="b")  # its clock is behind
    assert (desk.pending, desk.dropped) == (0, {"no_pose": 2})
    assert desk.receipts.status().poses.late == 0
    desk.scan(1050).scan(5).scan(10).pose(20, Pose(-2, 0, 0), run="b").scan(15)
    # The old run's poses are gone: 1050 ms lies ahead, 5 ms behind.
    assert (desk.order, desk.xs) == ([4, 5], [-1, pytest.approx(-1.5)])
    assert (desk.pending, desk.dropped) == (1, {"no_pose": 2, "stale": 1})


def test_what_waits_for_a_robots_very_first_pose_is_given_up_too():
    # That pose is the first of a run not seen before, like any other.
    desk = Desk().scan(90).scan(100)
    assert desk.pending == 2
    desk.pose(90).pose(110)
    assert (desk.order, desk.dropped) == ([], {"no_pose": 2})
    assert desk.scan(100).xs == [pytest.approx(0.1)]


def test_no_pose_is_interpolated_between_two_runs():
    desk = Desk().pose(0, run="a").scan(10).pose(20, run="b")
    assert (desk.order, desk.dropped) == ([], {"no_pose": 1})
    desk.scan(10)
    assert desk.dropped == {"no_pose": 1, "stale": 1}


def test_a_run_seen_before_does_not_begin_again():
    desk = Desk().pose(0, run="a").pose(100, run="b").scan(150)
    desk.pose(50, run="a").pose(200, run="a")
    assert (desk.order, desk.xs) == ([0], [pytest.approx(0.15)])
    assert desk.receipts.status().poses.late == 1


def test_poses_without_a_run_are_a_run_of_their_own():
    desk = Desk().pose(1000).pose(10).pose(5, run="a").pose(7)
    assert desk.receipts.status().poses.late == 1
    assert desk.scan(6).xs == [pytest.approx(0.006)]


def test_runs_are_those_of_one_robot():
    desk = Desk().pose(0, run="a").scan(10).pose(0, run="b", robot="other").pose(10, run="a")
    assert (desk.order, desk.dropped) == ([0], {})


def test_expire_drops_what_waits_for_a_silent_robot():
    desk = Desk()
    desk.placer.heard("r", 100.0)
    desk.placer.heard("other", 101.5)
    desk.pose(0).scan(10).scan(20).pose(0, robot="other").scan(10, robot="other")
    desk.placer.expire(102.0, 2.0)
    assert (desk.pending, desk.dropped) == (3, {})
    desk.placer.expire(102.1, 2.0)
    desk.check()
    assert (desk.pending, desk.dropped) == (1, {"no_pose": 2})
    desk.placer.heard("other", 103.0)
    desk.placer.expire(104.9, 2.0)
    assert desk.pending == 1
    desk.pose(10).pose(10, robot="other")
    assert desk.order == [2]


def test_expire_keeps_the_poses():
    desk = Desk().pose(0).scan(50)
    desk.placer.heard("r", 1.0)
    desk.placer.expire(10.0, 2.0)
    assert desk.dropped == {"no_pose": 1}
    assert desk.pose(100).scan(50).xs == [pytest.approx(0.05)]


def test_finish_drops_what_waits():
    desk = Desk().pose(0).scan(10).scan(10, robot="q").scan(0)
    desk.placer.finish()
    desk.check()
    assert (desk.order, desk.pending, desk.dropped) == ([2], 0, {"no_pose": 2})


def test_refusals_are_counted_under_their_slug():
    sink = Sink({1: LimitReached("too far"), 2: OutsideBounds("all outside"), 4: LimitReached("too far")})
    desk = Desk(sink).pose(0).scan(0).scan(0).scan(0).scan(5).scan(5).scan(5).pose(5)
    assert desk.order == [0, 3, 5]
    assert desk.dropped == {"limit": 2, "outside": 1}
    source = desk.receipts.status().robots["r"].sources["s"]
    assert source == SourceStatus(
        run="", last_seq=5, received=6, pending=0, integrated=3, dropped={"limit": 2, "outside": 1}
    )


def test_a_bug_in_the_sink_is_not_a_refusal():
    desk = Desk(Sink({0: ZeroDivisionError()})).pose(0)
    with pytest.raises(ZeroDivisionError):
        desk.scan(0)


def test_headings_that_no_float_can_tell_apart_are_no_bug():
    desk = Desk().pose(0, Pose(0, 0, -1.7e308)).pose(100, Pose(0, 0, 1.7e308))
    assert desk.scan(50, mount=Pose(0.1, 0.0, 0.0)).order == [0]


def test_the_status_says_where_a_robot_is():
    desk = Desk().pose(10, Pose(1, 2, 3)).scan(10, run="a", seq=7)
    robot = desk.receipts.status().robots["r"]
    assert (robot.pose, robot.stamp) == (Pose(1, 2, 3), T0 + 10 * MS)
    desk.scan(20, pose=Pose(4, 5, 6))
    robot = desk.receipts.status().robots["r"]
    assert (robot.pose, robot.stamp) == (Pose(4, 5, 6), T0 + 20 * MS)
