"""Scans of a caller's own values: what is accepted, and that it is what a mapper would receive."""

import math
from fractions import Fraction

import numpy as np
import pytest

from ogm_core.errors import BadMessage
from ogm_core.types import IDENTITY, Pose
from ogm_core.wire.messages import decode_scan, encode_scan
from ogm_core.wire.values import scan_of

SWEEP = {"angle_min": -0.5, "angle_increment": 0.25, "range_min": 0.1, "range_max": 8}
READINGS = [2, 1.5, math.inf, math.nan]


def fields(scan):
    names = [name for name in scan.__slots__ if name != "ranges"]
    return {name: getattr(scan, name) for name in names}


@pytest.mark.parametrize("kind", [list, tuple, np.array, lambda values: np.array(values, np.float32)])
def test_readings_of_any_kind_are_float32_that_nobody_may_change(kind):
    mine = kind(READINGS)
    scan = scan_of(mine, **SWEEP)
    assert scan.ranges.dtype == np.float32
    np.testing.assert_array_equal(scan.ranges, np.array(READINGS, np.float32))
    assert not scan.ranges.flags.writeable
    assert not np.shares_memory(scan.ranges, mine)


def test_what_is_not_given_is_zero():
    scan = scan_of(READINGS, **SWEEP)
    assert (scan.stamp, scan.seq, scan.run, scan.time_increment) == (0, 0, "", 0.0)
    assert (scan.mount, scan.pose) == (IDENTITY, None)
    assert (scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max) == (-0.5, 0.25, 0.1, 8.0)


def test_numbers_of_any_kind_become_those_that_a_mapper_would_receive():
    given = {"stamp": np.int64(7), "time_increment": np.float64(1e-3), "seq": 3, "run": "r"}
    poses = {"mount": np.array([1, 2, 3]), "pose": (Fraction(1, 2), 0, np.float32(0.25))}
    scan = scan_of(READINGS, **SWEEP, **given, **poses)
    received = decode_scan(encode_scan(scan))
    assert fields(scan) == fields(received)
    np.testing.assert_array_equal(scan.ranges, received.ranges)
    assert (scan.mount, scan.pose) == (Pose(1.0, 2.0, 3.0), Pose(0.5, 0.0, 0.25))
    assert {type(value) for value in (*scan.mount, *scan.pose, scan.range_max)} == {float}
    assert (type(scan.stamp), scan.stamp, scan.end_stamp) == (int, 7, 3_000_007)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ranges": []}, "ranges: 1 to"),
        ({"ranges": [[1.0]]}, r"ranges: .*\(1, 1\)"),
        ({"ranges": [1.0, "far"]}, "ranges: numbers"),
        ({"angle_increment": 0}, "angle_increment: it must not be 0"),
        ({"angle_min": 10**400}, "angle_min: a finite number is needed"),
        ({"range_max": None}, "range_max: a number is needed, got NoneType"),
        ({"range_min": 9.0}, "range_min < range_max"),
        ({"stamp": 0.5}, "stamp: a whole number"),
        ({"stamp": -1}, "stamp: 0 to"),
        ({"mount": [0.0, 0.0]}, r"mount: \[x, y, theta\]"),
        ({"pose": [0.0, math.inf, 0.0]}, r"pose\[1\]: a finite number"),
    ],
)
def test_what_a_mapper_would_refuse_is_refused(change, message):
    with pytest.raises(BadMessage, match=message):
        scan_of(**{"ranges": READINGS, **SWEEP, **change})
