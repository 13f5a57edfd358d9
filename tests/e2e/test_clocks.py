"""Robots whose clocks and poses are wrong: no wall is where none is, and `ogm build` says what is wrong."""

import math
import re

import pytest

from room import T0, S, astray, drive, pose, ranges, scan


def east(t):
    return -4 + 0.8 * t, 0.3 * math.sin(t), 0.3 * t


def north(t):
    return 0.0, -4 + 1.5 * t, 1.2


@pytest.fixture
def built(built):
    """What `ogm build` makes of messages: (cells astray, occupied cells), scans integrated, what it says."""

    build_map = built

    def build(messages, *flags, **environ):
        npz, said = build_map(messages, *flags, **environ)
        return astray(npz), int(re.search(r"(\d+) integrated", said)[1]), said

    return build


def test_a_simulator_that_begins_again(built):
    again = drive(north, 5, first_pose=1000, first_scan=1000)
    (wrong, walls), integrated, said = built(drive(lambda t: (-4 + 1.5 * t, 0.0, 0.0), 5) + again)
    assert (wrong, integrated) == (0, 100)
    assert walls > 700
    assert "r1/pose: the clock of its poses went back by 5 s" in said


@pytest.mark.parametrize("step", [0.5, 3.0])
def test_a_clock_that_is_set_back_in_mid_drive(built, step):
    log = drive(east, 10)
    for message in log:
        message["stamp"] -= round(step * S) * (message["stamp"] >= T0 + 5 * S)
    (wrong, walls), integrated, said = built(log)
    assert (wrong, integrated) == (0, 100)
    assert walls > 700
    assert f"the clock of its poses went back by {step - 0.05:g} s" in said


def test_only_scans_that_lie_across_a_step_back_are_dropped(built):
    log = drive(east, 10)
    for n, message in enumerate(log):
        message["stamp"] += 20_000_000 * (message["type"] == "scan")  # each scan waits for the next pose
        message["stamp"] -= 3 * S * (n > 148)
    assert log[148]["type"] == "scan"
    (wrong, _), integrated, said = built(log)
    assert wrong == 0
    assert integrated == 99
    assert "1 dropped: no_pose" in said


@pytest.mark.parametrize("stamp", [lambda stamp: 0, lambda stamp: stamp // S * S])
def test_stamps_that_repeat(built, stamp):
    log = [message | {"stamp": stamp(message["stamp"])} for message in drive(east, 10)]
    (wrong, _), integrated, said = built(log)
    assert wrong == 0
    assert 1 <= integrated <= 11
    assert "stamps repeat" in said


@pytest.mark.parametrize("seq", [100, 10**6])
def test_one_pose_that_is_a_year_ahead(built, seq):
    log = drive(east, 10)
    for message in log[100:]:
        message["seq"] += 1000
    year = pose(T0 + 365 * 86_400 * S, (0.0, 0.0, 0.0), seq)
    (wrong, _), integrated, _ = built([*log[:100], year, *log[100:]])
    assert wrong == 0
    assert integrated >= (99 if seq == 100 else 97)


def test_poses_once_a_second_need_a_larger_pose_gap(built):
    log = drive(east, 10, poses=1, scans=40)
    _, integrated, said = built(log)
    assert integrated == 10  # those at the poses' own stamps
    assert "two poses 1 s apart, and mapper.pose_gap is 0.5 s" in said
    (wrong, _), integrated, _ = built(log, OGM_MAPPER__POSE_GAP="1.5")
    assert (wrong, integrated) == (0, 400)


def test_poses_of_a_robot_that_says_where_it_is_after_every_quarter_of_a_metre(built):
    log, last = [], -9.0
    for message in drive(lambda t: (-4 + 0.3 * min(t, 8), 0.0, 0.0), 12):
        if message["type"] == "pose":
            if message["x"] - last < 0.25:
                continue
            last = message["x"]
        log.append(message)
    _, integrated, said = built(log)
    assert integrated < 20
    assert "mapper.pose_gap is 0.5 s" in said
    (wrong, _), integrated, said = built(log, OGM_MAPPER__POSE_GAP="1")
    assert wrong == 0
    assert integrated >= 76  # all but those after the last pose
    assert "while the robot stands" in said


def test_a_robot_that_stands_is_mapped_whatever_the_gap(built):
    log = [pose(T0, (1, 1, 0.3), 0), *(scan(T0 + n * S, ranges(1, 1, 0.3), n) for n in range(1, 3))]
    (wrong, _), integrated, _ = built([*log, pose(T0 + 60 * S, (1.005, 1, 0.305), 1)])
    assert (wrong, integrated) == (0, 2)


def test_a_jump_that_no_robot_drives(built):
    def path(t):
        x, y, theta = 0.3 * t - 1, 0.1 * t, 0.2 * t
        return (x + 2.1, y, theta + 1.5) if t >= 2.5 else (x, y, theta)

    log = [
        message
        for message in drive(path, 5, poses=10, scans=20)
        if not 2.4 < (message["stamp"] - T0) / S < 2.45
    ]
    (wrong, walls), integrated, said = built(log, OGM_MAPPER__MAX_SPEED="5")
    assert wrong == 0
    assert walls > 700
    assert integrated >= 95
    assert "mapper.max_speed" in said


def test_the_first_scan_of_a_new_time_comes_before_its_pose_while_one_of_the_old_still_waits(built):
    there = drive(lambda t: (t / 5, 0.0, 0.0), 5, start=T0 + 100 * S)
    waits = scan(T0 + 105 * S + 40_000_000, ranges(1.0, 0.0, 0.0), 900)
    first = scan(T0 + 30_000_000, ranges(4.006, 0.0, 0.0), 901)
    again = drive(lambda t: (4 + t / 5, 0.0, 0.0), 5, first_pose=1000, first_scan=1000)
    (wrong, _), integrated, said = built([*there, waits, first, *again])
    assert (wrong, integrated) == (0, 101)
    assert "1 dropped: no_pose" in said


def test_one_bad_pose_does_not_end_the_mapping(built):
    log = drive(lambda t: (t / 5, 0.0, 0.0), 2)
    bad = next(n for n, message in enumerate(log) if message["stamp"] == T0 + S and message["type"] == "pose")
    log[bad] |= {"x": 485.0}
    (wrong, _), integrated, said = built(log)
    assert (wrong, integrated) == (0, 20)
    assert "a pose is dropped, no robot gets there (485 m" in said


def test_two_publishers_without_runs(built):
    mine = drive(lambda t: (-4 + 1.5 * t, 0.0, 0.0), 5, run="")
    theirs = drive(lambda t: (30 - 1.5 * t, 0.0, 0.0), 5, start=T0 + 7_000_000, run="")
    theirs = [message for message in theirs if message["type"] == "pose"]
    _, integrated, said = built(sorted(mine + theirs, key=lambda message: message["stamp"]))
    assert integrated <= 50
    assert "r1/pose: poses contradict each other" in said
    assert "two publishers under one name?" in said


def test_a_publisher_that_numbers_anew_under_its_old_run(built):
    first = drive(east, 5)
    again = drive(lambda t: east(t + 5), 5, start=T0 + 5 * S, first_pose=1000)  # the scans begin with 0 again
    (wrong, _), integrated, said = built([*first, *again])
    assert (wrong, integrated) == (0, 50)
    assert "10 scans in a row have the run and seqs of scans before" in said


def test_each_way_to_have_no_pose_is_told(built):
    log = drive(east, 4)
    gap = [
        message for message in log if message["type"] == "scan" or not T0 + S < message["stamp"] < T0 + 2 * S
    ]
    again = next(
        n for n, message in enumerate(gap) if message["stamp"] == T0 + 3 * S and message["type"] == "pose"
    )
    gap.insert(again + 1, gap[again] | {"x": gap[again]["x"] + 0.02})
    _, _, said = built(
        [*gap, scan(T0 + 4 * S + 10**9, ranges(0, 0, 0), 500), scan(T0 + 9 * S, ranges(0, 0, 0), 501)]
    )
    for words in (
        "mapper.pose_gap is 0.5 s",
        "has the stamp of another",
        "the log ends before",
        "ahead of the robot's",
    ):
        assert words in said


@pytest.mark.parametrize("runs", [("a", "b"), ("first", "")])
def test_two_publishers_of_one_name(built, runs):
    mine = drive(lambda t: (-4 + 1.5 * t, 0.0, 0.0), 5, run=runs[0])
    theirs = drive(north, 5, start=T0 + 7_000_000, run=runs[1])
    both = sorted(mine + theirs, key=lambda message: message["stamp"])
    (wrong, walls), integrated, said = built(both)
    assert wrong == 0
    assert walls > 300
    assert integrated >= 49  # one of the two
    assert "two publishers under one name?" in said


def test_poses_of_one_process_and_scans_of_another(built):
    log = [message | {"run": message["type"]} for message in drive(east, 5)]
    (wrong, _), integrated, said = built(log)
    assert (wrong, integrated) == (0, 50)
    assert "superseded" not in said
