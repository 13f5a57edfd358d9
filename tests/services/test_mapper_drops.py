"""What becomes of scans and poses that are not used, and that the books balance."""

import math

import pytest

from mapper_desk import MS, T0, Desk, Sink
from ogm_core.errors import LimitReached, OutsideBounds
from ogm_core.placing.rules import FEWEST_POSES, MAX_ROBOTS, MAX_WAITING_SCANS, MOST_POSES
from ogm_core.status import PoseCounts, SourceStatus
from ogm_core.types import Pose, PoseStamped


def test_stale_is_before_the_oldest_kept_pose():
    desk = Desk().pose(100).pose(200)
    desk.scan(99.999999).scan(100)
    assert (desk.order, desk.dropped) == ([1], {"stale": 1})


def test_stale_is_said_at_once_even_if_the_sweep_ends_later():
    desk = Desk().pose(100).scan(90, beams=101, time_increment=0.001)
    assert (desk.pending, desk.dropped) == (0, {"stale": 1})


def test_a_waiting_scan_is_stale_once_its_pose_is_no_longer_kept():
    desk = Desk().pose(0).scan(0, beams=2, time_increment=60.1)
    for ms in range(50, 60_001, 50):
        desk.pose(ms)
    assert desk.pending == 1
    desk.pose(60_100)
    assert (desk.order, desk.dropped) == ([], {"stale": 1})


def test_poses_of_60_s_are_kept():
    desk = Desk()
    for ms in range(0, 60_050, 50):
        desk.pose(ms)
    desk.scan(0, seq=3, run="a").scan(50, seq=2, run="a")
    desk.pose(60_050).scan(0, seq=1, run="a").scan(50, seq=0, run="a")
    assert (desk.order, desk.dropped) == ([3, 2, 0], {"stale": 1})


def test_1024_poses_are_kept_at_least_and_65536_at_most():
    slow, fast = Desk(pose_gap=1.0), Desk()
    for k in range(FEWEST_POSES):
        slow.pose(1000 * k)
    slow.scan(0, seq=1, run="a").pose(1000 * FEWEST_POSES).scan(0, seq=0, run="a")
    assert (slow.order, slow.dropped) == ([1], {"stale": 1})
    for k in range(MOST_POSES + 1):
        fast.placer.add_pose("r", PoseStamped(T0 + k, Pose(0, 0, 0)))
    fast.scan(0).scan(1e-6)
    assert (fast.order, fast.dropped) == ([1], {"stale": 1})


def test_a_gap_of_more_than_half_a_second_has_no_pose():
    desk = Desk().pose(0).pose(500).pose(1102)
    desk.scan(499).scan(500).scan(501).scan(1000).scan(1102)
    assert (desk.order, desk.dropped) == ([0, 1, 4], {"no_pose": 2})
    [*_, (source, kind, said)] = desk.complaints
    assert (source, kind) == ("r/s", "gap")
    assert "two poses 0.602 s apart, and mapper.pose_gap is 0.5 s" in said


def test_a_gap_closes_over_a_waiting_scan():
    desk = Desk().pose(0).scan(100).pose(600)
    assert (desk.order, desk.pending, desk.dropped) == ([], 0, {"no_pose": 1})


def test_a_scan_gives_up_when_one_that_is_60_s_newer_waits():
    desk = Desk(pose_wait=1e9).pose(0)
    for ms in (10, 20, 60_000, 60_010):
        desk.scan(ms)
    assert (desk.pending, desk.dropped) == (4, {})
    desk.scan(60_011)
    assert (desk.pending, desk.dropped) == (4, {"no_pose": 1})
    assert desk.pose(20).order == [1]


def test_scans_of_other_sensors_do_not_push_one_out():
    desk = Desk(pose_wait=1e9).pose(0).scan(10, sensor="quiet").scan(10, sensor="busy")
    desk.scan(99_000, sensor="busy").scan(99_000, robot="other")
    assert (desk.pending, desk.dropped) == (3, {"no_pose": 1})
    desk.pose(10)
    assert desk.order == [0]


def test_no_more_than_4096_scans_of_a_sensor_wait():
    desk = Desk().pose(0)
    for _ in range(MAX_WAITING_SCANS + 2):
        desk.scan(10)
    gone = MAX_WAITING_SCANS // 8 + 1  # an eighth at once
    assert (desk.pending, desk.dropped) == (MAX_WAITING_SCANS + 2 - gone, {"no_pose": gone})
    assert desk.pose(10).order == list(range(gone, MAX_WAITING_SCANS + 2))


@pytest.mark.parametrize(
    ("seqs", "integrated"),
    [
        ([0, 1, 2], [0, 1, 2]),
        ([0, 0], [0]),
        ([5, 4, 6, 5, 7, 4, 6], [5, 4, 6, 7]),
        ([3, 100, 4, 100, 4], [3, 100, 4]),
    ],
)
def test_a_seq_that_has_come_before_is_a_duplicate(seqs, integrated):
    desk = Desk().pose(0)
    for seq in seqs:
        desk.scan(0, seq=seq, run="a")
    assert desk.order == integrated
    duplicates = len(seqs) - len(integrated)
    assert desk.dropped == ({"duplicate": duplicates} if duplicates else {})


def test_seqs_are_counted_by_robot_sensor_and_run():
    desk = Desk().pose(0).pose(0, robot="q")
    for where in ({}, {"sensor": "t"}, {"robot": "q"}, {"run": "b"}):
        desk.scan(0, **{"seq": 3, "run": "a", **where})
    desk.pose(1)  # the first scan of another run waits for it
    assert desk.order == [3] * 4
    for where in ({}, {"sensor": "t"}, {"robot": "q"}, {"run": "b"}):
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
    desk.pose(100).pose(50, Pose(9, 9, 9))
    assert desk.receipts.status().poses == PoseCounts(received=4, malformed=0, late=2)
    assert desk.receipts.status().robots["r"].stamp == T0 + 100 * MS
    desk.scan(100).scan(50, sensor="t").pose(200)
    assert desk.xs == pytest.approx([0.1, 0.05, 0.15])


def test_a_new_run_begins_a_new_history():
    desk = Desk().pose(1000, run="a").pose(1100, run="a").scan(1200).scan(1300)
    desk.pose(10, Pose(-1, 0, 0), run="b")  # its clock is behind
    assert (desk.pending, desk.dropped) == (0, {"no_pose": 2})
    assert desk.receipts.status().poses == PoseCounts(received=3, malformed=0, late=0)
    desk.scan(5).scan(10).pose(20, Pose(-1.1, 0, 0), run="b").scan(15)
    assert (desk.order, desk.xs) == ([3, 4], [-1, pytest.approx(-1.05)])
    assert (desk.pending, desk.dropped) == (0, {"no_pose": 2, "stale": 1})


def test_scans_of_the_new_run_itself_may_come_before_its_first_pose():
    desk = Desk().pose(0, run="a").scan(10, run="b").scan(20, run="c").pose(5, run="b").pose(50, run="b")
    assert (desk.order, desk.dropped) == ([0], {"no_pose": 1})


def test_what_waits_for_a_robots_very_first_pose_is_given_up_too():
    # That pose is the first of a run not seen before, like any other.
    desk = Desk().scan(90, run="a").scan(100, run="a")
    assert desk.pending == 2
    desk.pose(90).pose(110)
    assert (desk.order, desk.dropped) == ([], {"no_pose": 2})
    assert desk.scan(100, run="a").xs == [pytest.approx(0.1)]


def test_no_pose_is_interpolated_between_two_runs():
    desk = Desk().pose(0, run="a").scan(10).pose(20, run="b")
    assert (desk.order, desk.dropped) == ([], {"no_pose": 1})
    desk.scan(10)
    assert desk.dropped == {"no_pose": 1, "stale": 1}


def test_runs_are_those_of_one_robot():
    desk = Desk().pose(0, run="a").scan(10).pose(0, run="b", robot="other").pose(10, run="a")
    assert (desk.order, desk.dropped) == ([0], {})


def test_expire_drops_what_has_waited_if_its_robot_sent_no_pose():
    desk = Desk()
    desk.now = 100.0
    desk.pose(0).pose(0, robot="other").scan(10).scan(10, robot="other")
    desk.now = 101.5
    desk.scan(20).pose(1, robot="other")
    desk.placer.expire(102.0)
    assert (desk.pending, desk.dropped) == (3, {})
    desk.placer.expire(102.1)
    desk.check()
    assert (desk.pending, desk.dropped) == (2, {"no_pose": 1})
    assert "mapper.pose_wait = 2 s" in desk.complaints[-1][2]
    desk.now = 103.6
    desk.scan(30)
    desk.placer.expire(103.6)
    assert (desk.pending, desk.dropped) == (1, {"no_pose": 3})


def test_scans_wait_for_poses_that_may_come_late():
    desk = Desk()
    desk.now = 100.0
    desk.pose(0).pose(0, robot="other").scan(10).scan(10, robot="other")
    desk.placer.decided.wait_on("r", math.inf)
    desk.placer.expire(200.0)
    assert (desk.pending, desk.dropped) == (1, {"no_pose": 1})
    desk.placer.decided.wait_on("r", 200.0)  # as if a pose had come then
    desk.placer.expire(202.0)
    assert desk.pending == 1
    desk.placer.expire(202.1)
    assert (desk.pending, desk.dropped) == (0, {"no_pose": 2})


def test_of_robots_whose_poses_may_come_late_no_more_are_remembered_than_may_be_there():
    decided = Desk().placer.decided
    for k in range(MAX_ROBOTS + 5):
        decided.wait_on(f"r{k % MAX_ROBOTS}" if k < MAX_ROBOTS else f"new{k}", 1.0)
    assert [decided.waits_until(name) for name in ("r0", "r4")] == [-math.inf] * 2
    assert [decided.waits_until(name) for name in ("r5", "new1004")] == [1.0] * 2


def test_expire_keeps_the_poses():
    desk = Desk().pose(0).scan(50)
    desk.placer.expire(10.0)
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
    desk = Desk(max_turn_rate=math.inf).pose(0, Pose(0, 0, -1.7e308)).pose(100, Pose(0, 0, 1.7e308))
    assert desk.scan(50, mount=Pose(0.1, 0.0, 0.0)).order == [0]


def test_the_status_says_where_a_robot_is():
    desk = Desk().pose(10, Pose(1, 2, 3)).scan(10, run="a", seq=7)
    robot = desk.receipts.status().robots["r"]
    assert (robot.pose, robot.stamp) == (Pose(1, 2, 3), T0 + 10 * MS)
    desk.scan(20, pose=Pose(4, 5, 6))
    robot = desk.receipts.status().robots["r"]
    assert (robot.pose, robot.stamp) == (Pose(4, 5, 6), T0 + 20 * MS)
