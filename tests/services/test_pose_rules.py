"""Poses and scans whose clocks, runs or values are wrong: what is believed, and what is said."""

import math

import pytest

from mapper_desk import MS, T0, Desk
from ogm_core.placing.robot_poses import LATE_IN_A_ROW
from ogm_core.types import Pose, PoseStamped


def counts(desk):
    poses = desk.receipts.status().poses
    names = ("late", "restarted", "ambiguous", "outlier", "superseded")
    return {name: getattr(poses, name) for name in names if getattr(poses, name)}


def said(desk, kind):
    return [text for _, one, text in desk.complaints if one == kind]


def drive(desk, start, end, *, run="a", seq=0, x=0.0, step=50):
    """A pose every `step` ms, at 1 m/s."""
    for n, ms in enumerate(range(start, end + 1, step)):
        desk.pose(ms, Pose(x + ms / 1000, 0.0, 0.0), run=run, seq=seq + n)
    return desk


# ---- one publisher


def test_poses_of_a_replaced_run_are_refused_and_so_are_its_scans():
    desk = drive(drive(Desk(), 0, 100, run="a"), 0, 50, run="b", x=9.0)
    desk.pose(150, run="a").scan(25, run="a").scan(25, sensor="t", run="other")
    assert (counts(desk), desk.dropped, desk.xs) == (
        {"superseded": 1},
        {"superseded": 1},
        [pytest.approx(9.025)],
    )
    [text] = [text for source, _, text in desk.complaints if source == "r/pose"]
    assert "poses of run 'a' are refused, because run 'b' has replaced it: two publishers" in text


def test_a_scan_with_its_own_pose_is_never_superseded():
    desk = drive(drive(Desk(), 0, 100, run="a"), 0, 50, run="b")
    assert desk.scan(5, run="a", pose=Pose(1, 2, 3)).order == [0]


def test_poses_of_one_process_and_scans_of_another_work():
    desk = drive(Desk(), 0, 100, run="localisation").scan(50, run="driver").scan(75, run="driver")
    assert (desk.order, desk.dropped) == ([0, 1], {})


def test_a_scan_run_that_another_has_replaced_on_its_source_is_superseded():
    desk = drive(Desk(), 0, 200).scan(50, run="x").scan(60, run="y").pose(250, run="a", seq=9)
    desk.scan(70, run="x", seq=7).scan(70, run="y", seq=7)
    assert (desk.order, desk.dropped) == ([0, 1, 7], {"superseded": 1})


def test_a_replaced_run_owns_again_when_the_owners_token_was_there_and_is_gone():
    desk = drive(drive(Desk(), 0, 100, run="a"), 0, 100, run="b", x=9.0)
    desk.scan(50, run="b").pose(150, run="a", seq=5)
    desk.placer.robot_gone("r", "a")  # not the owner's
    desk.pose(200, run="a", seq=6)
    assert counts(desk) == {"superseded": 2}
    desk.placer.robot_here("r", "a")
    desk.placer.robot_here("r", "b")
    desk.placer.robot_gone("r", "b")
    desk.scan(75, run="a")  # its poses have not come yet: b's are no place for it
    assert desk.dropped == {"superseded": 1}
    desk.pose(250, run="a", seq=7).pose(300, run="a", seq=8).scan(275, run="a").pose(350, run="a", seq=9)
    assert counts(desk) == {"superseded": 2}
    assert desk.xs == [pytest.approx(9.05), pytest.approx(0.275)]
    desk.pose(400, run="b", seq=99)
    assert counts(desk) == {"superseded": 3}


def test_a_run_whose_token_was_gone_before_its_first_pose_does_not_stay_in_the_way():
    desk = drive(Desk(), 0, 100, run="a")
    desk.placer.robot_here("r", "b")
    desk.placer.robot_gone("r", "b")
    desk.pose(120, run="b").pose(150, run="a", seq=9).pose(200, run="a", seq=10).scan(175, run="a")
    assert (counts(desk), desk.xs) == ({}, [pytest.approx(0.175)])


def test_a_sensor_is_its_first_publishers_again_when_the_second_is_gone():
    desk = drive(drive(Desk(), 0, 500, run="a").scan(100, run="a"), 0, 500, run="b").scan(200, run="b")
    desk.pose(550, run="b", seq=50).placer.robot_gone("r", "b")
    drive(desk, 600, 1200, run="a", seq=50)
    for ms in range(700, 1100, 10):
        desk.scan(ms, run="a")
    drive(desk, 1250, 1300, run="a", seq=90)
    assert (len(desk.order), desk.dropped) == (42, {})


def test_where_no_token_was_seen_a_replaced_run_stays_replaced():
    desk = drive(drive(Desk(), 0, 100, run="a"), 0, 100, run="b")
    for ms in range(200, 10_000, 100):
        desk.pose(ms, run="a")
    assert counts(desk) == {"superseded": 98}


def test_the_eight_replaced_runs_heard_last_are_remembered():
    desk = Desk()
    for k in range(10):
        desk.pose(k, run=f"run{k}")
    desk.pose(50, run="run1")  # of 1 to 8 the one heard longest ago, but heard again now
    desk.pose(60, run="new")  # replaces run9, so that run2 is forgotten
    assert counts(desk) == {"superseded": 1}
    desk.pose(70, run="run1")
    assert counts(desk) == {"superseded": 2}
    desk.pose(80, run="run2").pose(90, run="run2").scan(85)
    assert (counts(desk), desk.order) == ({"superseded": 2}, [0])


# ---- the poses' clock


@pytest.mark.parametrize("back", [150, 500, 3000, 1_000_000])
def test_a_clock_that_goes_back_begins_a_new_history(back):
    desk = drive(Desk(), 2000, 3000, seq=0).scan(3020, seq=1, run="a")
    drive(desk, 3050 - back, 3300 - back, seq=100, x=back / 1000)
    assert (counts(desk), desk.dropped) == ({"restarted": 1}, {"no_pose": 1})
    desk.scan(3060 - back, seq=2, run="a")
    drive(desk, 3350 - back, 3400 - back, seq=200, x=back / 1000)
    assert desk.xs == [pytest.approx(3.06)]
    [text] = said(desk, "restarted")
    assert f"went back by {(back - 50) / 1000:g} s" in text


def test_jitter_of_up_to_50_ms_is_late_whatever_its_seq():
    desk = drive(Desk(), 0, 100, seq=0).pose(50, Pose(9, 9, 9), run="a", seq=50)
    assert (counts(desk), len(said(desk, "late"))) == ({"late": 1}, 1)
    desk.pose(50 - 1e-6, Pose(9, 9, 9), run="a", seq=51)
    assert counts(desk) == {"late": 1, "restarted": 1}


def test_a_pose_that_was_overtaken_is_late():
    desk = drive(Desk(), 0, 1000, seq=0).pose(500, Pose(9, 9, 9), run="a", seq=10).scan(500, run="a")
    assert (counts(desk), desk.xs) == ({"late": 1}, [0.5])


def test_of_a_publisher_without_run_or_with_a_seq_that_stays_0_every_earlier_pose_is_a_restart():
    for run, seq in (("", 7), ("a", 0)):
        desk = Desk().pose(0, run=run, seq=seq).pose(1000, run=run, seq=seq).pose(500, run=run, seq=seq)
        assert counts(desk) == {"restarted": 1}


def test_the_fifth_late_pose_of_a_rising_row_begins_a_new_history():
    desk = drive(Desk(), 0, 1000, seq=100)
    for k in range(LATE_IN_A_ROW - 1):
        desk.pose(300 + k, run="a", seq=k)
    desk.pose(300, run="a", seq=4)  # does not rise: a row of its own
    assert counts(desk) == {"late": 5}
    for k in range(1, 4):
        desk.pose(300 + k, run="a", seq=4 + k)
    assert counts(desk) == {"late": 8}
    desk.pose(304, run="a", seq=9)
    assert counts(desk) == {"late": 8, "restarted": 1}
    assert desk.scan(304, run="a").order == [0]


def test_one_pose_of_the_far_future_costs_the_scans_around_it():
    desk = drive(Desk(), 0, 1000, seq=0).pose(1e9, run="a", seq=21).scan(1010, run="a")
    drive(desk, 1050, 2000, seq=22)
    for ms in range(1100, 2000, 100):
        desk.scan(ms, run="a")
    assert (len(desk.order), desk.dropped) == (9, {"no_pose": 1})


def test_different_poses_of_one_stamp_place_nothing():
    desk = Desk().pose(0, Pose(0, 0, 0)).scan(0).pose(0, Pose(0.02, 0, 0)).scan(0)
    assert (desk.xs, counts(desk), desk.dropped) == ([0.0], {"ambiguous": 1}, {"no_pose": 1})
    assert "stamps repeat" in said(desk, "ambiguous")[0]
    desk.scan(40).pose(50, Pose(0.05, 0, 0)).scan(50).pose(100)
    assert (desk.xs, desk.dropped) == ([0.0, 0.05], {"no_pose": 2})


def test_of_nearly_equal_poses_of_one_stamp_the_first_stays():
    turn = math.radians(0.49)
    desk = Desk().pose(0, Pose(0, 0, 0)).pose(0, Pose(0.0099, 0, turn)).scan(0)
    assert (desk.xs, counts(desk)) == ([0], {"late": 1})
    desk.pose(0, Pose(0, 0, math.radians(0.51)))
    assert counts(desk) == {"late": 1, "ambiguous": 1}


# ---- poses that no robot reaches


def test_an_outlier_is_dropped_and_its_neighbours_are_joined():
    desk = (
        drive(Desk(), 0, 1000)
        .pose(1050, Pose(485, 0, 0), run="a", seq=21)
        .scan(1050, run="a")
        .scan(1060, run="a")
    )
    assert (desk.order, desk.pending) == ([], 2)
    assert desk.receipts.status().robots["r"].stamp == T0 + 1000 * MS
    drive(desk, 1100, 1200, seq=22)
    assert desk.xs == pytest.approx([1.05, 1.06])
    assert counts(desk) == {"outlier": 1}
    assert "484 m" in said(desk, "outlier")[0]


def test_more_than_one_outlier_in_five_poses_is_told_as_two_publishers():
    desk = drive(Desk(), 0, 1000)
    desk.pose(1050, Pose(50, 0, 0), run="a").pose(1100, run="a").pose(1150, Pose(50, 0, 0), run="a").pose(
        1200, run="a"
    )
    assert counts(desk) == {"outlier": 2}
    assert len(said(desk, "outlier")) == 1
    assert "two publishers" in said(desk, "contradiction")[0]


def test_a_real_jump_begins_a_new_history_and_nothing_is_placed_across_it():
    desk = drive(Desk(), 0, 1000).scan(1050, run="a").pose(1100, Pose(13.2, 0.0, 1.5), run="a", seq=21)
    assert desk.pending == 1
    desk.pose(1150, Pose(13.25, 0.0, 1.5), run="a", seq=22).scan(1125, run="a")
    assert (desk.xs, desk.dropped, counts(desk)) == ([pytest.approx(13.225)], {"no_pose": 1}, {})
    assert "12.2 m and 1.5 rad within 0.1 s" in said(desk, "jumped")[0]
    assert "mapper.max_speed" in said(desk, "jumped")[0]


def test_a_pose_between_two_that_no_robot_joins_begins_a_new_history_alone():
    desk = (
        drive(Desk(), 0, 1000)
        .pose(1050, Pose(2.6, 0, 0), run="a")
        .scan(1060, run="a")
        .pose(1150, Pose(2, 0, 0), run="a")
    )
    assert (desk.dropped, counts(desk)) == ({"no_pose": 1}, {})
    desk.scan(1050, run="a", sensor="t").scan(1150, run="a", sensor="u")
    assert (desk.xs, desk.dropped) == ([2], {"no_pose": 1, "stale": 1})


def test_of_two_wild_poses_the_first_is_dropped_and_the_second_is_judged_by_the_next():
    desk = drive(Desk(), 0, 1000).pose(1050, Pose(50, 0, 0), run="a").pose(1100, Pose(-50, 0, 0), run="a")
    assert counts(desk) == {"outlier": 1}
    desk.pose(1150, run="a").scan(1075, run="a")
    assert (counts(desk), desk.xs) == ({"outlier": 2}, [pytest.approx(1.075)])


def test_max_speed_and_max_turn_rate_are_the_limits():
    def jumps(dx, turn, **rules):
        desk = (
            Desk(**rules)
            .pose(0, Pose(0, 0, 3.0))
            .pose(100, Pose(dx, 0, 3.0 + turn))
            .pose(101, Pose(dx, 0, 3.0 + turn))
        )
        return bool(said(desk, "jumped"))

    assert (jumps(2.04, 1.09), jumps(2.06, 0.0), jumps(0.0, 1.11), jumps(0.0, -1.11)) == (
        False,
        True,
        True,
        True,
    )
    assert not jumps(500.0, 3.0, max_speed=math.inf, max_turn_rate=math.inf)
    assert (jumps(0.14, 0.0, max_speed=1.0), jumps(0.16, 0.0, max_speed=1.0)) == (False, True)


def test_nearly_equal_poses_are_joined_whatever_the_gap():
    desk = Desk().pose(0, Pose(1, 0, 0)).scan(1000).pose(300_000, Pose(1.009, 0, 0))
    assert desk.xs == [pytest.approx(1.0, abs=1e-4)]
    desk.pose(600_000, Pose(1.02, 0, 0)).scan(450_000)
    assert desk.dropped == {"no_pose": 1}


def test_pose_gap_is_a_setting():
    desk = Desk(pose_gap=1.5).pose(0).scan(700).pose(1500).pose(3001)
    assert (desk.xs, desk.scan(2000).dropped) == ([pytest.approx(0.7)], {"no_pose": 1})
    assert "1.501 s apart, and mapper.pose_gap is 1.5 s" in said(desk, "gap")[0]


# ---- the scans' clock


def test_a_pose_that_is_sent_again_and_again_does_not_keep_scans_waiting():
    desk = Desk()
    for second in range(10):
        desk.now = float(second)
        desk.pose(0, run="a").scan(100 + second, run="a")
        desk.placer.expire(desk.now)
    assert desk.pending <= 3
    assert desk.dropped == {"no_pose": 10 - desk.pending}


def test_a_robot_of_which_no_pose_ever_came_is_told_of_the_names_that_have_poses():
    desk = Desk().pose(0, robot="amcl").scan(0, robot="lidar").scan(0, robot="r")
    desk.placer.expire(100.0)
    assert "no pose of robot lidar has ever come (there are poses of amcl)" in said(desk, "no pose ever")[0]
    desk.pose(0).scan(10).placer.finish()
    assert "the log ends before" in said(desk, "log ended")[0]


def test_stamps_that_are_years_apart_are_no_question_of_clocks():
    desk = Desk()
    desk.placer.add_pose("r", PoseStamped(1_700_000_000, Pose(0, 0, 0)))
    desk.scan(0)
    assert "one of the two is not in ns" in said(desk, "ahead")[0]
    assert "not in ns" not in said(drive(Desk(), 0, 1000).scan(4000, run="a"), "ahead")[0]


def test_a_scan_far_ahead_of_the_poses_is_not_waited_for():
    desk = drive(Desk(), 0, 1000).scan(3000, run="a").scan(3001, run="a", sensor="t")
    assert (desk.pending, desk.dropped) == (1, {"no_pose": 1})
    assert "2.001 s ahead" in said(desk, "ahead")[0]


def test_after_a_restart_what_is_ahead_of_the_new_poses_is_not_waited_for():
    desk = drive(Desk(), 100_000, 101_000, seq=0).scan(101_010, run="a", seq=0)
    drive(desk, 0, 100, seq=50).scan(101_020, run="a", seq=1)
    assert (desk.pending, desk.dropped) == (0, {"no_pose": 2})


def test_the_first_scan_after_a_clock_went_back_waits_for_its_new_pose():
    desk = drive(Desk(), 0, 5000, seq=0).scan(4990, run="a", seq=0).scan(5010, run="a", seq=1)
    desk.scan(100, run="a", seq=2)  # of the new time, before its pose
    assert (desk.xs, desk.dropped, desk.pending) == ([pytest.approx(4.99)], {"no_pose": 1}, 1)
    assert "clock of this sensor went back by 4.91 s" in said(desk, "stepped back")[0]
    drive(desk, 50, 150, seq=200, x=100.0)
    assert desk.xs[1:] == [pytest.approx(100.1)]


def test_the_pose_after_a_sensors_step_back_begins_a_new_history_even_if_it_is_later():
    desk = drive(Desk(), 0, 100, seq=0).scan(90, run="a", seq=0)
    desk.scan(20, run="a", seq=1).pose(110, run="a", seq=9)
    assert (counts(desk), desk.dropped) == ({}, {"stale": 1})
    desk.scan(100, run="a", seq=2)
    assert desk.dropped == {"stale": 2}


def test_a_late_scan_is_no_step_back():
    desk = (
        drive(Desk(), 0, 1000)
        .scan(900, run="a", seq=7)
        .scan(500, run="a", seq=3)
        .scan(850.000001, run="a", seq=8)
    )
    assert (desk.order, said(desk, "stepped back")) == ([7, 3, 8], [])


def test_the_first_scan_of_another_run_waits_for_a_pose():
    desk = drive(Desk(), 0, 1000).scan(500, run="x").scan(600, run="y")
    assert (desk.order, desk.pending) == ([0], 1)
    desk.pose(990, Pose(0, 0, 0), run="a", seq=1)  # late: not taken
    assert desk.pending == 1
    desk.pose(1050, run="a", seq=50)
    assert desk.order == [0, 1]


# ---- numbers


def test_ten_duplicates_whose_stamps_rise_are_warned_of():
    desk = drive(Desk(), 0, 1000)
    for ms in range(0, 200, 10):
        desk.scan(ms, run="a", seq=ms)
    for n, ms in enumerate(range(500, 600, 10)):
        assert said(desk, "renumbered") == []
        desk.scan(ms, run="a", seq=10 * n)
    assert "begun anew" in said(desk, "renumbered")[0]
    assert desk.dropped == {"duplicate": 10}


def test_a_seq_that_is_far_above_moves_nothing_until_five_rise_in_a_row():
    desk = drive(Desk(), 0, 1000).scan(0, run="a", seq=5)
    desk.scan(10, run="a", seq=2**63).scan(20, run="a", seq=6).scan(30, run="a", seq=6)
    assert (desk.order, desk.dropped) == ([5, 2**63, 6], {"duplicate": 1})
    far = [5_000_000, 5_000_001, 9_000_000, 9_000_001, 2**62]
    for n, seq in enumerate(far):
        desk.scan(40 + n, run="a", seq=seq)
    for n, seq in enumerate((*far, 7)):
        desk.scan(50 + n, run="a", seq=seq)
    assert desk.order[3:] == [*far, 7]
    assert desk.dropped == {"duplicate": 6}


def test_gaps_are_remembered():
    desk = drive(Desk(), 0, 1000)
    for seq in (*range(0, 4000, 2), *range(3999, 1953, -2)):
        desk.scan(500, run="a", seq=seq)
    assert desk.dropped == {}
    desk.scan(500, run="a", seq=1).scan(
        500, run="a", seq=3000
    )  # the one was never seen, but its gap is forgotten
    assert desk.dropped == {"duplicate": 2}
