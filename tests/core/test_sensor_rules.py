"""What a scan becomes by the rules of its sensor."""

import math

import numpy as np
import pytest

from ogm_core.errors import BadMessage
from ogm_core.placing.sensor_rules import SensorRule, SensorRules
from ogm_core.types import Pose, Scan

INF, NAN = math.inf, math.nan


def scan(ranges=(1.0,), **fields):
    values = {"stamp": 10**9, "angle_min": -1.0, "angle_increment": 0.5, "range_min": 0.1, "range_max": 8.0}
    return Scan(ranges=np.array(ranges, np.float32), **(values | fields))


def read(one, **rule):
    return SensorRules([SensorRule("*", **rule)]).read("r/s", one)


def test_a_scan_that_no_rule_changes_is_itself():
    one = scan()
    for rules in ([], [SensorRule("q/*", range_min=0.5)], [SensorRule("*")]):
        assert SensorRules(rules).read("r/s", one) is one


def test_each_key_comes_from_the_first_rule_that_matches_and_has_it():
    rules = SensorRules(
        [
            SensorRule("r1/*", range_min=0.2),
            SensorRule("*/front", range_min=0.3, range_max=5.0),
            SensorRule("*", range_max=6.0, time_offset=0.5),
        ]
    )
    found = {source: rules.read(source, scan()) for source in ("r1/front", "r1/rear", "r2/front", "r2/rear")}
    assert {source: (one.range_min, one.range_max) for source, one in found.items()} == {
        "r1/front": (0.2, 5.0),
        "r1/rear": (0.2, 6.0),
        "r2/front": (0.3, 5.0),
        "r2/rear": (0.1, 6.0),
    }
    assert {one.stamp for one in found.values()} == {1_500_000_000}


def test_globs_that_matched_nothing_are_known():
    rules = SensorRules([SensorRule("r1/*"), SensorRule("r?/front"), SensorRule("x/[ab]")])
    assert rules.unmatched == ["r1/*", "r?/front", "x/[ab]"]
    rules.read("r2/front", scan())
    assert rules.unmatched == ["r1/*", "x/[ab]"]


def test_what_lies_beyond_range_max_is_nothing_there():
    readings = [7.9, 8.0, 8.000001, 8.1, 1e30, INF, NAN, -INF]
    assert read(scan(readings), beyond="clear").ranges.tolist()[:6] == [
        *scan(readings[:3]).ranges,
        INF,
        INF,
        INF,
    ]
    assert read(scan(readings), beyond="clear", range_max=8.1).ranges.tolist()[3] == np.float32(8.1)
    one = scan(readings)
    assert read(one, beyond="skip").ranges is one.ranges


def test_no_return_is_ignored_be_it_inf_or_range_max():
    readings = [1.0, 7.9, 8.0, 8.5, INF]
    found = read(scan(readings), ignore_no_return=True).ranges
    assert np.isnan(found).tolist() == [False, False, True, True, True]
    limit = 5.6  # its float32 is smaller
    assert np.isnan(read(scan([5.6], range_max=limit), ignore_no_return=True).ranges).all()
    assert not found.flags.writeable


def test_the_other_keys():
    one = scan(time_increment=0.001, mount=Pose(1, 2, 3))
    found = read(
        one, upside_down=True, mount=Pose(0, 0, 1), deskew="off", clear_range=2.0, reach=4.0, time_offset=-1.5
    )
    assert (found.angle_min, found.angle_increment, found.mount) == (1.0, -0.5, Pose(0, 0, 1))
    assert (found.time_increment, found.clear_range, found.reach, found.stamp) == (
        0.0,
        2.0,
        4.0,
        -500_000_000,
    )
    same = read(one, upside_down=False, deskew="auto", ignore_no_return=False, range_min=0.2)
    assert (same.angle_min, same.time_increment, same.range_min) == (-1.0, 0.001, 0.2)


def test_a_reversed_sweep_began_with_its_last_beam():
    one = scan([1.0, 2.0, 3.0], stamp=10**9, time_increment=0.001)
    found = read(one, deskew="reversed", time_offset=-0.5)
    assert (found.stamp, found.end_stamp, found.time_increment) == (502_000_000, 500_000_000, -0.001)
    assert read(found, deskew="reversed").stamp == found.stamp
    with pytest.raises(BadMessage, match="stamp: by the settings of sensors past"):
        read(scan([1.0, 2.0], stamp=2**63 - 1, time_increment=0.001), deskew="reversed")


def test_a_range_min_that_is_not_below_the_scans_range_max_is_an_error():
    with pytest.raises(
        BadMessage, match=r"range_min: by the settings of sensors 9 m, not below range_max = 8 m"
    ):
        read(scan(), range_min=9.0)


def test_a_stamp_that_an_offset_moves_past_the_end_of_time_is_an_error():
    assert read(scan(stamp=2**63 - 1), time_offset=-1.0).stamp == 2**63 - 1 - 10**9
    with pytest.raises(BadMessage, match="stamp: by the settings of sensors past"):
        read(scan(stamp=2**63 - 1), time_offset=1.0)
