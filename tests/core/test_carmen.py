"""CARMEN logs, line by line."""

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from log_lines import flaser, odom, parsed, parsed_twice, robotlaser, same
from ogm_core.errors import BadMessage
from ogm_core.logs.carmen import CarmenLog
from ogm_core.logs.carmen_mount import mount_of_laser
from ogm_core.logs.decimals import read_decimals
from ogm_core.types import IDENTITY, Pose


def read(*lines, **options):
    """(messages, complaints) of the lines of a log."""
    quick = CarmenLog(**options, decimals=read_decimals)
    return parsed_twice(CarmenLog(**options).parse_line, quick.parse_line, *lines)


@pytest.mark.parametrize(("beams", "degrees"), [(180, 1.0), (181, 1.0), (360, 0.5), (361, 0.5)])
def test_a_flaser_line_is_read(beams, degrees):
    ranges = [0.01 * k for k in range(beams)]
    [scan], complaints = read(flaser(ranges))
    assert complaints == []
    assert (scan.robot, scan.sensor) == ("robot1", "laser")
    message = scan.message
    np.testing.assert_array_equal(message.ranges, np.array(ranges, np.float32))
    assert message.angle_min == -math.pi / 2
    assert message.angle_min + 90 / degrees * message.angle_increment == pytest.approx(0.0, abs=1e-12)
    assert (message.range_min, message.range_max) == (0.0, 80.0)
    assert (message.pose, message.mount) == (Pose(1.5, -2.5, 0.25), IDENTITY)
    assert (message.stamp, message.seq, message.run) == (32_906_800_000, 0, "")


def test_a_robotlaser_line_is_read():
    [scan], complaints = read(robotlaser([1.1, 2, 0.3], remissions=[7, 8], robot="4 5 6"))
    assert complaints == []
    assert (scan.robot, scan.sensor) == ("robot1", "laser")
    message = scan.message
    np.testing.assert_array_equal(message.ranges, np.array([1.1, 2, 0.3], np.float32))
    assert (message.angle_min, message.angle_increment, message.time_increment) == (-1.25, 0.5, 0.0)
    assert (message.range_min, message.range_max) == (0.0, 30.5)
    assert (message.pose, message.mount) == (Pose(1.5, -2.5, 0.25), IDENTITY)
    assert (message.stamp, message.seq, message.run) == (32_906_800_000, 0, "")


def test_a_robotlaser_line_may_hold_no_remissions_and_turn_clockwise():
    [scan], _ = read(robotlaser([5.0], setup="3 2.0 0 -0.25 8 0 1"))
    assert (scan.message.angle_min, scan.message.angle_increment) == (2.0, -0.25)
    np.testing.assert_array_equal(scan.message.ranges, np.float32([5.0]))


def test_range_max_replaces_that_of_both_forms():
    for line in (flaser([1] * 180), robotlaser([1, 2]), robotlaser([1, 2], setup="0 0 0 1 0 0 0")):
        [scan], complaints = read(line, range_max=12.5)
        assert (scan.message.range_max, complaints) == (12.5, [])


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"\r",
        b"# FLASER 180",
        b"#x",
        b"ODOM 1 2 3 0 0 0 1 h 1",
        b"ODOM 1",
        b"NEFF 1",
        b"PARAM a b",
        b"ROBOTLASER2 0 1",
        b"RLASER",
        b"SYNC",
        b"NMEA-GGA 1 2 3",
        b"X-IMU:RAW",
    ],
)
def test_other_carmen_lines_are_nothing(text):
    assert read(text) == ([], [])


def test_what_is_passed_over_is_counted_by_name():
    log = CarmenLog()
    lines = [b"# x", b"", b"SYNC a", b"RLASER 1", b"SYNC b", b"NEFF 3", b"RLASER 2", b"RAWLASER1", odom()]
    assert parsed(log.parse_line, *lines) == ([], [])
    assert log.unread == {"SYNC": 2, "RLASER": 2, "NEFF": 1, "RAWLASER1": 1, "ODOM": 1}
    assert log.lasers_passed_over() == "2 RLASER, 1 RAWLASER1"
    assert CarmenLog().lasers_passed_over() == ""


def test_only_so_many_names_are_told_apart():
    log = CarmenLog()
    parsed(log.parse_line, *[b"NAME%d" % (k % 1000) for k in range(1100)])
    assert (len(log.unread), log.unread["NAME7"], log.unread["others"]) == (51, 2, 1000)


@pytest.mark.parametrize(
    ("first", "second", "unread"),
    [
        (flaser([1] * 180), robotlaser([1] * 180), {"ROBOTLASER1": 3}),
        (robotlaser([1] * 180), flaser([1] * 180), {"FLASER": 3}),
    ],
)
def test_of_two_forms_of_one_laser_only_the_first_is_read(first, second, unread):
    """A log that holds both holds every sweep twice."""
    log = CarmenLog()
    messages, complaints = parsed(log.parse_line, *[first, second] * 3)
    assert (len(messages), complaints, log.unread) == (3, [], unread)
    assert messages[0].message.range_max == (80.0 if first.startswith(b"FLASER") else 30.5)


def test_a_malformed_line_does_not_settle_which_form_is_read():
    messages, complaints = read(flaser([1] * 90), robotlaser([1] * 90), flaser([1] * 180))
    assert len(messages) == 1
    assert messages[0].message.ranges.size == 90
    assert [number for number, _ in complaints] == [1]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (b"what is this", "not a CARMEN message"),
        (b"\xff\x00", "not a CARMEN message"),
        (b'{"type": "pose"}', "not a CARMEN message"),
        (b"A" * 65, "not a CARMEN message"),
        (b"-GGA", "not a CARMEN message"),
        (b"FLASER", "FLASER: num_readings: missing, the line has only 1 fields"),
        (flaser([1] * 90), "FLASER: the bearings of 90 beams are not known .*`PARAM laser_front_laser_res"),
        (b"FLASER 1e2 1", "FLASER: num_readings: a whole number is needed, got b'1e2'"),
        (flaser([1] * 180)[:-5], "FLASER: 191 fields are needed for 180 beams, got 190"),
        (flaser([1] * 180) + b" 1", "FLASER: 191 fields are needed for 180 beams, got 192"),
        (flaser([1] * 179 + ["x"]), r"FLASER: ranges\[179\]: a number is needed, got b'x'"),
        (flaser([1] * 179 + ["1_0"]), r"FLASER: ranges\[179\]: a number is needed, got b'1_0'"),
        (flaser([1] * 180, pose="nan 0 0"), "FLASER: laser_pose_x: a finite number is needed, got nan"),
        (flaser([1] * 180, pose="0 0 inf"), "FLASER: laser_pose_theta: a finite number"),
        (flaser([1] * 180, odometry="1 b c"), "FLASER: robot_pose_y: a number is needed, got b'b'"),
        (flaser([1] * 180, ipc_time="now"), "FLASER: ipc_time: a number is needed"),
        (flaser([1] * 180, ipc_time="nan"), "FLASER: ipc_time: a finite number"),
        (flaser([1] * 180, ipc_time="1e300"), "FLASER: ipc_time: a finite number|FLASER: stamp: "),
        (flaser([1] * 180, ipc_time="1e10"), "FLASER: stamp: 0 to"),
    ],
)
def test_a_malformed_carmen_line_is_named_and_passed_over(text, reason):
    good = flaser([1] * 180)
    messages, complaints = read(good, text, good)
    assert len(messages) == 2
    [(number, said)] = complaints
    assert number == 2
    assert re.match(reason, said), said


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (b"ROBOTLASER1", "num_readings: missing, the line has only 1 fields"),
        (b"ROBOTLASER1 0 -1.5 3 0.1 30 0.01 0 5 1 2", "num_remissions: missing, the line has only 11 fields"),
        (robotlaser([1, 2]).replace(b" 2 1 2 ", b" 2.0 1 2 "), "num_readings: a whole .* got b'2.0'"),
        (robotlaser([1, 2]).replace(b" 2 1 2 ", b" -2 1 2 "), "num_readings: a whole .* got b'-2'"),
        (robotlaser([1, 2]).replace(b" 2 1 2 ", b" %s 1 2 " % (b"9" * 5000)), "num_readings: a whole"),
        (robotlaser([1, 2]).replace(b" 2 1 2 0 ", b" 2 1 2 0.5 "), "num_remissions: a whole"),
        (robotlaser([1, 2]).replace(b" 2 1 2 0 ", b" 3 1 2 0 "), "num_remissions: a whole .* got b'1.5'"),
        (
            robotlaser([1, 2], remissions=[4]) + b" 1",
            "27 fields are needed for 2 readings and 1 rem.*, got 28",
        ),
        (robotlaser([1, 2], safety="0 0 0 0"), "26 fields are needed for 2 readings and 0 rem.*, got 25"),
        (robotlaser([]), "ranges: 1 to 200000 beams are needed, got 0"),
        (robotlaser([1, "x"]), r"ranges\[1\]: a number is needed, got b'x'"),
        (robotlaser([1], remissions=[1, "y"]), r"remissions\[1\]: a number is needed, got b'y'"),
        (robotlaser([1], setup="SICK 0 3 0.5 30 0 0"), "laser_type: a number is needed, got b'SICK'"),
        (robotlaser([1], setup="0 nan 3 0.5 30 0 0"), "start_angle: a finite number is needed, got nan"),
        (robotlaser([1], setup="0 0 wide 0.5 30 0 0"), "field_of_view: a number"),
        (
            robotlaser([1], setup="0 0 3 -inf 30 0 0"),
            "angular_resolution: a finite number is needed, got -inf",
        ),
        (robotlaser([1], setup="0 0 3 0 30 0 0"), "angular_resolution: it must not be 0"),
        (robotlaser([1] * 9, setup="0 0 3 1e308 30 0 0"), "angle_increment: the last beam's bearing"),
        (robotlaser([1], setup="0 0 3 1 0 0 0"), "maximum_range: above 0 .*, got 0 .--range-max replaces it"),
        (robotlaser([1], setup="0 0 3 1 -8 0 0"), "maximum_range: above 0 .*, got -8"),
        (robotlaser([1], setup="0 0 3 1 1e4 0 0"), "maximum_range: .* at most 1000 m is needed, got 10000"),
        (robotlaser([1], setup="0 0 3 1 inf 0 0"), "maximum_range: a finite number"),
        (robotlaser([1], pose="0 inf 0"), "laser_pose_y: a finite number"),
        (robotlaser([1], robot="0 0 x"), "robot_pose_theta: a number"),
        (robotlaser([1], safety="0 0 0 0 ?"), "turn_axis: a number"),
        (robotlaser([1], ipc_time="inf"), "ipc_time: a finite number"),
    ],
)
def test_a_malformed_robotlaser_line_names_its_field(text, reason):
    good = robotlaser([1])
    messages, [(number, said)] = read(good, text, good)
    assert (len(messages), number) == (2, 2)
    assert re.match(f"ROBOTLASER1: {reason}", said), said


def test_max_beams_holds_for_both_forms():
    messages, complaints = read(flaser([1] * 180), robotlaser([1] * 5), robotlaser([1] * 4), max_beams=4)
    assert [message.message.ranges.size for message in messages] == [4]
    assert [said for _, said in complaints] == [
        "FLASER: ranges: 1 to 4 beams are needed, got 180",
        "ROBOTLASER1: ranges: 1 to 4 beams are needed, got 5",
    ]


@pytest.mark.parametrize("line", [flaser, robotlaser])
def test_carmen_ranges_may_be_any_float(line):
    [scan], _ = read(line(["nan", "inf", "-inf", "0", "-1", "81.83", "1e39"] + [1] * 173))
    expected = np.array([np.nan, np.inf, -np.inf, 0, -1, np.inf, np.inf], np.float32)
    np.testing.assert_array_equal(scan.message.ranges[:7], expected)


@pytest.mark.parametrize("line", [flaser, robotlaser])
def test_ranges_at_or_above_the_maximum_are_no_returns(line):
    """Compared as the float32 that ranges are: of 80.99 that is below the number that the log says."""
    assert float(np.float32(80.99)) < 80.99
    [scan], _ = read(line(["80.98", "80.99", "81", "-inf", "nan"] + [1] * 175), range_max=80.99)
    expected = np.array([80.98, np.inf, np.inf, -np.inf, np.nan, 1], np.float32)
    np.testing.assert_array_equal(scan.message.ranges[:6], expected)
    assert not scan.message.ranges.flags.writeable


def test_the_maximum_is_the_lines_own_unless_it_is_given():
    for text, least in ((flaser([79.99, 80] * 90), 80.0), (robotlaser([30.49, 30.5]), 30.5)):
        [scan], _ = read(text)
        assert scan.message.range_max == least
        assert np.isinf(scan.message.ranges[:2]).tolist() == [False, True]


@pytest.mark.parametrize("line", [flaser, robotlaser])
@pytest.mark.parametrize("time", ["-1", "-0.25", "-1e9"])
def test_a_sweep_before_all_time_is_placed_by_its_own_pose(line, time):
    [scan], complaints = read(line([1] * 180, ipc_time=time))
    assert complaints == []
    assert (scan.message.stamp, scan.message.pose) == (0, Pose(1.5, -2.5, 0.25))


@pytest.mark.parametrize("line", [flaser, robotlaser])
def test_a_sweep_before_all_time_has_no_place_among_odometry(line):
    messages, [(_, said)] = read(line([1] * 180, ipc_time="-1"), mount=IDENTITY)
    assert messages == []
    assert said.startswith(f"{line([]).split()[0].decode()}: stamp: 0 to")


RESOLUTION = b"PARAM laser_front_laser_resolution %s 1071078718.4 merci 1071078718.4"


@pytest.mark.parametrize(
    ("beams", "degrees", "first"), [(401, "0.25", -50), (541, "0.5", -135), (90, "2", -90)]
)
def test_the_step_of_another_laser_is_the_logs_parameter(beams, degrees, first):
    other = b"PARAM laser_rear_laser_resolution 3 h 0"
    [scan], complaints = read(other, RESOLUTION % degrees.encode(), RESOLUTION % b"7", flaser([1] * beams))
    assert complaints == []
    assert math.degrees(scan.message.angle_increment) == pytest.approx(float(degrees))
    assert math.degrees(scan.message.angle_min) == pytest.approx(first)
    assert scan.message.ranges.size == beams


def test_the_steps_of_the_lms_are_what_they_are_whatever_a_parameter_says():
    [scan], _ = read(RESOLUTION % b"0.25", flaser([1] * 180))
    assert math.degrees(scan.message.angle_increment) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("beams", "degrees", "doubted"), [(180, b"1", False), (181, b"0.5", True), (361, b"0.5", False)]
)
def test_a_parameter_that_contradicts_the_steps_of_the_lms_is_told(beams, degrees, doubted):
    log = CarmenLog()
    for line in (RESOLUTION % degrees, flaser([1] * beams)):
        log.parse_line(line)
    assert log.doubt.startswith("its 181 beams are taken as 1 degrees apart") == doubted
    assert bool(log.doubt) == doubted


@pytest.mark.parametrize("value", [b"", b"auto", b"0", b"-1", b"nan", b"inf", b"0_5"])
def test_a_step_that_is_none_is_none(value):
    messages, [(_, said)] = read(RESOLUTION % value, flaser([1] * 541))
    assert messages == []
    assert re.match("FLASER: the bearings of 541 beams are not known", said), said


def test_beams_that_go_round_more_than_once_are_refused():
    messages, [(_, said)] = read(RESOLUTION % b"1", flaser([1] * 361), flaser([1] * 362))
    assert len(messages) == 1
    assert said.startswith(
        "FLASER: 362 beams, 1 degrees apart by PARAM laser_front_laser_resolution, go round"
    )


@pytest.mark.parametrize("line", [flaser, robotlaser])
def test_hosts_and_logger_times_are_not_looked_at(line):
    [scan], _ = read(line([1] * 180, tail="h\xf6st never"))
    assert scan.message.pose == Pose(1.5, -2.5, 0.25)


PARAMETER = b"PARAM robot_frontlaser_offset 0 h 0"
STRANGE = [
    b"nan",
    b"-inf",
    b"1e999",
    b"1e308",
    b"-0",
    b"\xff\xfe",
    b"x",
    b"0x1",
    b"9" * 400,
    b"-1",
    b"1.5",
    b"FLASER",
]


@given(
    line=st.sampled_from([flaser([1] * 180), robotlaser([1, 2, 3], remissions=[4]), odom()]),
    changes=st.lists(st.tuples(st.integers(-30, 30), st.sampled_from(STRANGE)), max_size=4),
    dropped=st.integers(0, 12),
)
def test_any_line_is_read_or_refused_as_malformed(line, changes, dropped):
    tokens = line.split()
    for at, token in changes:
        tokens[at % len(tokens)] = token
    log = CarmenLog(mount=IDENTITY)
    messages, complaints = parsed(log.parse_line, b" ".join(tokens[dropped:]))
    assert len(messages) + len(complaints) + log.unread.total() <= 1
    mount = mount_of_laser([b" ".join(tokens), odom(), PARAMETER], CarmenLog(mount=IDENTITY))
    assert all(map(math.isfinite, mount))


@pytest.mark.parametrize("text", [flaser([1.5] * 180), robotlaser([1.5, 2, 81.83], remissions=[7, 8])])
def test_plain_ranges_are_read_at_once(text):
    read_of = []

    def decimals(text, count):
        read_of.append((count, text[:3]))
        return read_decimals(text, count)

    scan = CarmenLog(decimals=decimals).parse_line(text).message
    assert read_of == [(scan.ranges.size, b"1.5")]
    assert same(CarmenLog().parse_line(text), CarmenLog(decimals=read_decimals).parse_line(text))


@pytest.mark.parametrize("form", [flaser, robotlaser])
@pytest.mark.parametrize(
    "odd", ["1e1", "+1", "01", ".5", "1.", "-0", "nan", "inf", "1.234567890123456789", "1_0", "x"]
)
@pytest.mark.parametrize("at", [0, 179])
def test_odd_ranges_are_read_as_they_always_were(form, odd, at):
    ranges = [2.5] * 180
    ranges[at] = odd
    read(form(ranges))
    read(form(ranges).replace(b" ", b"\t"), form(ranges)[:-20])


@pytest.mark.parametrize("count", ["0180", "179", "181", "180.0", "0", "-180", "200001", "9999999999"])
def test_a_count_that_is_wrong_is_told_as_it_always_was(count):
    for form in (flaser, robotlaser):
        read(form([2.5] * 180).replace(b" 180 ", f" {count} ".encode()))


@pytest.mark.parametrize("glue", [b"-", b".", b"e", b"_", b"+"])
def test_a_range_that_runs_into_the_pose_is_not_cut_off(glue):
    line = flaser([3.75] * 180, pose="1.5 -2.5 0.25")
    messages, complaints = read(line.replace(b"3.75 1.5", b"3.75" + glue + b"1.5"))
    assert (len(messages), len(complaints)) == (0, 1)


def test_no_room_is_made_for_more_beams_than_are_allowed():
    counts = []

    def decimals(_, count):
        counts.append(count)

    log = CarmenLog(decimals=decimals, max_beams=180)
    for count in (b"181", b"999999999"):
        with pytest.raises(BadMessage):
            log.parse_line(robotlaser([1.5, 2.0]).replace(b" 2 ", b" " + count + b" ", 1))
    assert counts == []
    log.parse_line(flaser([2.5] * 180))
    assert counts == [180]
