"""Beams that end at another robot are skipped: which robots, where they are then, and when nobody knows."""

import math

import numpy as np

from mapper_desk import T0, Desk
from ogm_core.grid_settings import GridSettings
from ogm_core.placing.robot_rules import RobotRule, RobotRules
from ogm_core.sensor_models.hits import hits_at_robots
from ogm_core.types import Pose, PoseStamped

NAN = math.nan


def desk(radii=(("b", 0.5),), settings=None, **rules):
    return Desk(radii=radii, mark_hits=hits_at_robots(settings or GridSettings()), **rules)


def stands(found, robot, x, y, *times, **fields):
    """A robot stands at (x, y), as poses at these ms say."""
    for ms in times:
        found.pose(ms, Pose(x, y, 0.0), robot=robot, **fields)
    return found


def seen(found, ms, ranges, robot="a", sensor="s", **fields):
    """What of a robot's scan the map gets: its ranges."""
    before = len(found.sink.scans)
    found.scan(
        ms,
        robot=robot,
        sensor=sensor,
        **{"angle_increment": math.pi / 2, "ranges": np.array(ranges, np.float32), **fields},
    )
    (scan,) = found.sink.scans[before:]
    return [round(r, 3) for r in scan.ranges.tolist()]


def both(**options):
    """Robot a in the origin, robot b two metres east of it, both since 0 and at 100 ms."""
    found = desk(**options)
    stands(found, "b", 2.0, 0.0, 0, 100)
    return stands(found, "a", 0.0, 0.0, 0, 100)


def test_a_hit_within_the_radius_of_another_robot_is_no_reading():
    found = both()
    assert seen(found, 100, [1.4, 1.6, 1.6, 1.6]) == [1.4, 1.6, 1.6, 1.6]
    assert str(seen(found, 100, [1.6, 1.6, 1.6, 1.6])) == "[nan, 1.6, 1.6, 1.6]"
    assert str(seen(found, 100, [2.4, 2.4, 2.4, 2.4])) == "[nan, 2.4, 2.4, 2.4]"
    assert seen(found, 100, [2.6, 2.4, 2.4, 2.4]) == [2.6, 2.4, 2.4, 2.4]
    counts = found.receipts.status()
    assert (counts.scans.beams_on_robots, counts.robots["a"].sources["s"].beams_on_robots) == (2, 2)


def test_a_beam_that_is_no_hit_stays_what_it_is():
    found = stands(desk(), "b", 7.99, 0.0, 0, 100)
    stands(found, "a", 0.0, 0.0, 0, 100)
    assert seen(found, 100, [7.96, 1, 1, 1])[0] == 7.96  # range_max - alpha / 2 = 7.95: no return
    assert str(seen(found, 100, [7.94, 1, 1, 1])[0]) == "nan"
    assert seen(found, 100, [math.inf, 1, 1, 1])[0] == math.inf
    near = both(settings=GridSettings(reach=1.5))
    assert seen(near, 100, [1.6, 1, 1, 1])[0] == 1.6  # past the reach it is no return, too
    assert str(seen(near, 100, [1.6, 1, 1, 1], reach=1.7)[0]) == "nan"


def test_no_robot_is_another_to_itself_whichever_sensor_it_is():
    found = stands(desk((("*", 3.0),)), "a", 0.0, 0.0, 0, 100)
    assert seen(found, 100, [1, 1, 1, 1]) == [1, 1, 1, 1]
    assert seen(found, 100, [1, 1, 1, 1], sensor="rear") == [1, 1, 1, 1]
    stands(found, "b", 0.0, 2.0, 0, 100)
    assert str(seen(found, 100, [4, 1, 4, 4], sensor="rear")) == "[4.0, nan, 4.0, 4.0]"
    sources = found.receipts.status().robots["a"].sources
    assert (sources["s"].beams_on_robots, sources["rear"].beams_on_robots) == (0, 1)


def test_the_sensor_s_own_mount_counts():
    found = both()
    mounted = {"mount": Pose(1.0, 0.0, math.pi)}
    assert str(seen(found, 100, [1.0, 1.0, 1.0, 1.0], **mounted)) == "[1.0, 1.0, nan, 1.0]"


def test_a_robot_is_where_it_was_between_two_poses():
    found = stands(desk(), "a", 0.0, 0.0, 0, 100)
    found.pose(0, Pose(2.0, 0.0, 0.0), robot="b").pose(100, Pose(4.0, 0.0, 0.0), robot="b")
    assert seen(found, 0, [3, 1, 1, 1])[0] == 3
    assert str(seen(found, 0, [2, 1, 1, 1])[0]) == "nan"
    assert str(seen(found, 50, [3, 1, 1, 1])[0]) == "nan"


def test_else_it_is_where_its_newest_pose_says_for_half_a_second():
    found = stands(desk(), "b", 2.0, 0.0, 0)
    stands(found, "a", 0.0, 0.0, 500, 501)
    assert str(seen(found, 500, [2, 1, 1, 1])[0]) == "nan"
    assert seen(found, 501, [2, 1, 1, 1])[0] == 2
    before = stands(desk(), "b", 2.0, 0.0, 1000)
    stands(before, "a", 0.0, 0.0, 499, 500)
    assert str(seen(before, 500, [2, 1, 1, 1])[0]) == "nan"
    assert seen(before, 499, [2, 1, 1, 1])[0] == 2


def test_between_poses_that_are_not_joined_only_the_newest_says_where_it_was():
    found = stands(desk(), "a", 0.0, 0.0, 0, 200, 400, 700)
    found.pose(0, Pose(2.0, 0.0, 0.0), robot="b").pose(700, Pose(4.0, 0.0, 0.0), robot="b")
    assert str(seen(found, 0, [2, 1, 1, 1])[0]) == "nan"
    assert seen(found, 199, [4, 1, 1, 1])[0] == 4
    assert str(seen(found, 200, [4, 1, 1, 1])[0]) == "nan"


def test_a_pose_whose_stamp_is_ambiguous_says_nothing():
    found = stands(desk(), "a", 0.0, 0.0, 0, 100)
    found.pose(100, Pose(2.0, 0.0, 0.0), robot="b").pose(100, Pose(3.0, 0.0, 0.0), robot="b")
    assert seen(found, 100, [2, 1, 1, 1])[0] == 2


def test_a_pose_that_is_not_believed_yet_says_nothing():
    found = both()
    found.pose(150, Pose(90.0, 0.0, 0.0), robot="b")
    assert str(seen(found, 100, [2, 1, 1, 1])[0]) == "nan"
    stands(found, "a", 0.0, 0.0, 150)
    assert str(seen(found, 150, [2, 1, 1, 1])[0]) == "nan"


def test_what_is_skipped_depends_on_what_has_come_before():
    early, late = desk(), desk()
    for found in (early, late):
        stands(found, "a", 0.0, 0.0, 0, 100)
        found.pose(0, Pose(2.0, 0.0, 0.0), robot="b")
    early.pose(100, Pose(4.0, 0.0, 0.0), robot="b")
    assert str(seen(early, 100, [4, 1, 1, 1])[0]) == "nan"
    assert seen(late, 100, [4, 1, 1, 1])[0] == 4


def test_a_scan_that_waits_is_cleared_when_its_pose_comes():
    found = stands(desk(), "b", 2.0, 0.0, 0, 100)
    stands(found, "a", 0.0, 0.0, 0)
    found.scan(100, robot="a", angle_increment=math.pi / 2, ranges=np.array([2, 1, 1, 1], np.float32))
    assert found.pending == 1
    stands(found, "a", 0.0, 0.0, 100)
    assert str(found.sink.scans[0].ranges.tolist()) == "[nan, 1.0, 1.0, 1.0]"


def test_each_beam_of_a_sweep_has_its_own_time():
    """Robot b passes 2 m north, 1 m/s eastwards: it is seen where it is when the beam is taken."""
    found = desk((("b", 0.05),))
    stands(found, "a", 0.0, 0.0, 0, 1000, 2000)
    for ms in range(0, 2100, 100):
        found.pose(ms, Pose(ms / 1000 - 1.0, 2.0, 0.0), robot="b")
    places = [(-0.8 + 0.2 * k, 2.0) for k in range(9)]  # 200 ms between beams, from 200 ms on
    bearings = [math.atan2(y, x) for x, y in places]
    ends = [math.hypot(x, y) for x, y in places]
    for k, bearing in enumerate(bearings):
        # One sweep for each, in which all beams look there: only that which is taken then sees the robot.
        ranges = seen(
            *(found, 200, [ends[k]] * 9),
            angle_increment=1e-9,
            mount=Pose(0.0, 0.0, bearing),
            time_increment=0.2,
        )
        assert [math.isnan(r) for r in ranges] == [n == k for n in range(9)]


def test_a_sweep_that_outlasts_the_poses_of_another_robot_takes_its_newest_for_half_a_second():
    found = stands(desk(), "b", 2.0, 0.0, 0, 100)
    stands(found, "a", 0.0, 0.0, *range(0, 1100, 100))
    ranges = seen(found, 0, [2.0] * 11, angle_increment=1e-9, time_increment=0.1)
    assert [math.isnan(r) for r in ranges] == [k <= 6 for k in range(11)]


def test_a_pose_that_stands_alone_says_where_it_was_at_its_very_stamp():
    found = stands(desk(), "b", 2.0, 0.0, 0)
    for ms in (700, 1400, 2100):  # farther apart than poses are joined, and not nearly equal
        found.pose(ms, Pose(2.0 + ms / 10_000, 0.0, 0.0), robot="b")
    stands(found, "a", 0.0, 0.0, *range(0, 2200, 100))
    ranges = seen(found, 600, [2.0] * 3, angle_increment=1e-9, time_increment=0.1)
    assert [math.isnan(r) for r in ranges] == [False, True, False]
    assert str(seen(found, 700, [2, 1, 1, 1])[0]) == "nan"


def test_robots_whose_stamps_are_more_than_a_second_apart_are_walls_to_each_other():
    found = stands(desk(), "b", 2.0, 0.0, 1000, 1100)
    stands(found, "a", 0.0, 0.0, 100)
    assert str(seen(stands(found, "b", 2.0, 0.0, 1100), 100, [2, 1, 1, 1])[0]) == "2.0"  # 0.5 s is the end
    near = stands(desk(), "b", 2.0, 0.0, *range(0, 1200, 100))
    stands(near, "a", 0.0, 0.0, 100)
    assert str(seen(near, 100, [2, 1, 1, 1])[0]) == "nan"
    assert seen(stands(near, "b", 2.0, 0.0, 1101), 100, [2, 1, 1, 1])[0] == 2


def test_a_pair_whose_clocks_differ_is_told_of_once_the_other_robot_has_gone_on():
    found = desk()
    for n in range(30):
        stands(found, "b", 2.0, 0.0, 5000 + 100 * n)
        stands(found, "a", 0.0, 0.0, 100 * n)
        seen(found, 100 * n, [2, 1, 1, 1])
        hints = found.receipts.status().robots["a"].sources["s"].hints
        assert hints == (["robot_clock"] if n >= 10 else [])
    (told,) = [entry for entry in found.complaints if entry[1] == "hint robot_clock"]
    assert told[0] == "a/s"
    assert "that of b are 5 s apart" in told[2]
    assert found.receipts.status().scans.beams_on_robots == 0


def test_a_robot_that_has_fallen_silent_needs_no_clock_set():
    found = stands(desk(), "b", 2.0, 0.0, 0)
    for n in range(40):
        stands(found, "a", 0.0, 0.0, 100 * n)
        seen(found, 100 * n, [2, 1, 1, 1])
    assert found.receipts.status().robots["a"].sources["s"].hints == []
    assert found.receipts.status().scans.beams_on_robots == 6


def test_scans_with_poses_of_their_own_are_cleared_by_their_stamps():
    found = stands(desk(), "b", 2.0, 0.0, 0, 100)
    assert str(seen(found, 100, [2, 1, 1, 1], pose=Pose(0.0, 0.0, 0.0))[0]) == "nan"
    assert seen(found, 700, [2, 1, 1, 1], pose=Pose(0.0, 0.0, 0.0))[0] == 2
    assert seen(found, 1101, [2, 1, 1, 1], pose=Pose(0.0, 0.0, 0.0))[0] == 2
    stands(found, "a", 0.0, 0.0, 100)
    stands(found, "b", 2.0, 0.0, 1102)
    assert str(seen(found, 1102, [2, 1, 1, 1], pose=Pose(0.0, 0.0, 0.0))[0]) == "nan"


def test_after_a_restart_the_same_beams_are_skipped():
    """The state has the poses of all robots: what comes after it finds them where they were."""
    first = stands(desk((("*", 0.4),)), "b", 2.0, 0.0, 0, 100, 200)
    stands(first, "a", 0.0, 0.0, 0, 100, 200)
    second = desk((("*", 0.4),))
    second.placer.restore(first.placer.state())
    for found in (first, second):
        stands(found, "a", 0.0, 0.0, 300)
        assert str(seen(found, 100, [2, 1, 1, 1], seq=7)[0]) == "nan"
        assert str(seen(found, 300, [2, 1, 1, 1], seq=8)[0]) == "nan"


def test_nothing_is_looked_for_where_no_robot_has_a_radius():
    found = both(radii=(("b", None),))
    assert found.placer._other_robots is None
    assert seen(found, 100, [2, 1, 1, 1])[0] == 2


def test_the_first_rule_that_matches_and_has_a_radius_holds():
    rules = RobotRules([RobotRule("r1"), RobotRule("r?", 0.3), RobotRule("r*", 0.5), RobotRule("x", 1.0)])
    assert [rules.radius_of(name) for name in ("r1", "r2", "r10", "cart")] == [0.3, 0.3, 0.5, None]
    assert rules.unmatched == ["x"]
    assert rules
    assert not RobotRules([RobotRule("r1")])


def test_the_scan_that_came_is_not_changed():
    found = both()
    ranges = np.array([2, 1, 1, 1], np.float32)
    found.receipts.pose_received("a")
    found.placer.add_pose("a", PoseStamped(T0 + 200_000_000, Pose(0.0, 0.0, 0.0)))
    seen(found, 100, ranges)
    assert ranges.tolist() == [2, 1, 1, 1]
    assert not found.sink.scans[-1].ranges.flags.writeable
