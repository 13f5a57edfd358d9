"""CARMEN logs, line by line."""

import math
import re

import numpy as np
import pytest

from log_lines import flaser, parsed
from ogm_core.recordings import read_carmen
from ogm_core.types import IDENTITY, Pose


@pytest.mark.parametrize(("beams", "degrees"), [(180, 1.0), (181, 1.0), (360, 0.5), (361, 0.5)])
def test_a_flaser_line_is_read(beams, degrees):
    ranges = [0.01 * k for k in range(beams)]
    [scan], complaints = parsed(read_carmen, flaser(ranges))
    assert complaints == []
    assert (scan.robot, scan.sensor) == ("robot1", "laser")
    message = scan.message
    np.testing.assert_array_equal(message.ranges, np.array(ranges, np.float32))
    assert message.angle_min == -math.pi / 2
    assert message.angle_min + 90 / degrees * message.angle_increment == pytest.approx(0.0, abs=1e-12)
    assert (message.range_min, message.range_max) == (0.0, 80.0)
    assert (message.pose, message.mount) == (Pose(1.5, -2.5, 0.25), IDENTITY)
    assert (message.stamp, message.seq, message.run) == (32_906_800_000, 0, "")


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"\r",
        b"# FLASER 180",
        b"#x",
        b"ODOM 1 2 3 0 0 0 1 h 1",
        b"NEFF 1",
        b"PARAM a b",
        b"ROBOTLASER1 0 1",
        b"SYNC",
    ],
)
def test_other_carmen_lines_are_nothing(text):
    assert parsed(read_carmen, text) == ([], [])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (b"what is this", "not a CARMEN message"),
        (b"\xff\x00", "not a CARMEN message"),
        (b'{"type": "pose"}', "not a CARMEN message"),
        (b"FLASER", "FLASER: 180, 181, 360 or 361 .* got b''"),
        (flaser([1] * 90), "FLASER: 180, 181, 360 or 361 .* got b'90'"),
        (b"FLASER 1e2 1", "FLASER: 180, 181, 360 or 361"),
        (flaser([1] * 180)[:-5], "FLASER: 180 beams need 191 fields, got 190"),
        (flaser([1] * 180) + b" 1", "FLASER: 180 beams need 191 fields, got 192"),
        (flaser([1] * 179 + ["x"]), "FLASER: a field is not a number"),
        (flaser([1] * 180, pose="nan 0 0"), r"pose\[0\]: a finite number"),
        (flaser([1] * 180, pose="0 0 inf"), r"pose\[2\]: a finite number"),
        (flaser([1] * 180, odometry="a b c"), "FLASER: a field is not a number"),
        (flaser([1] * 180, ipc_time="-1"), "stamp: "),
        (flaser([1] * 180, ipc_time="nan"), "ipc_time: a finite number"),
        (flaser([1] * 180, ipc_time="1e300"), "ipc_time: a finite number|stamp: "),
        (flaser([1] * 180, ipc_time="1e10"), "stamp: 0 to"),
    ],
)
def test_a_malformed_carmen_line_is_named_and_passed_over(text, reason):
    good = flaser([1] * 180)
    messages, complaints = parsed(read_carmen, good, text, good)
    assert len(messages) == 2
    [(number, said)] = complaints
    assert number == 2
    assert re.match(reason, said), said


def test_carmen_ranges_may_be_any_float():
    [scan], _ = parsed(read_carmen, flaser(["nan", "inf", "-inf", "0", "-1", "81.83", "1e39"] + [1] * 173))
    expected = np.array([np.nan, np.inf, -np.inf, 0, -1, 81.83, np.inf], np.float32)
    np.testing.assert_array_equal(scan.message.ranges[:7], expected)


def test_hosts_and_logger_times_are_not_looked_at():
    [scan], _ = parsed(read_carmen, flaser([1] * 180, tail="h\xf6st never"))
    assert scan.message.pose == Pose(1.5, -2.5, 0.25)
