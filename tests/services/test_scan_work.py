"""How large scan messages are taken to be, and how long a robot's cells."""

import math

import msgpack
import numpy as np
import pytest

from ogm_core.grid_settings import GridSettings
from ogm_core.placing.sensor_rules import SensorRule, SensorRules
from ogm_core.wire.keys import Source
from ogm_services.mapper.intake.work import BYTE_CELLS, FIRST_RATE, MESSAGE_CELLS, CellRate, ScanSizes

SOURCE = Source("r", "s")


def sizes(*rules, **settings):
    return ScanSizes(GridSettings(0.1, **settings), SensorRules(rules))


def cells(sizes, payload, source=SOURCE):
    """Of the map alone: without what any message of its length takes."""
    return sizes.cells(source, payload) - MESSAGE_CELLS - BYTE_CELLS * len(payload)


def message(fields, ranges, **more):
    return msgpack.packb(fields.scan(ranges, range_max=30.0) | more)


def test_it_is_read_off_the_ranges(fields):
    short, long = message(fields, [1.0] * 100), message(fields, [29.0] * 100)
    assert len(short) == len(long)
    assert cells(sizes(), short) == pytest.approx(1_000)
    assert cells(sizes(), long) == pytest.approx(29_000)


def test_fields_that_look_like_others_fool_nobody(fields):
    long = fields.scan([29.0] * 100, range_max=30.0)
    names = b"\xa9range_max\xcb" + b"\0" * 8 + b"\xa6ranges\xc4\x04\0\0\0\0"
    assert cells(sizes(), msgpack.packb({"a": names} | long)) == pytest.approx(29_000)
    assert cells(sizes(), msgpack.packb(long | {"z": names})) == pytest.approx(29_000)


def test_settings_of_the_sensor_count(fields):
    payload = message(fields, [20.0, math.inf, 40.0])
    assert cells(sizes(), payload) == pytest.approx(200 + 300)
    assert cells(sizes(SensorRule("r/*", range_max=50.0)), payload) == pytest.approx(200 + 500 + 400)
    assert cells(sizes(SensorRule("r/*", beyond="clear")), payload) == pytest.approx(200 + 300 + 300)
    assert cells(sizes(SensorRule("r/*", reach=5.0)), payload) == pytest.approx(50 + 50)
    assert cells(sizes(SensorRule("r/*", clear_range=1.0)), payload) == pytest.approx(200 + 10)
    assert cells(sizes(SensorRule("r/*", range_min=25.0)), payload) == pytest.approx(300)
    assert cells(sizes(SensorRule("q/*", reach=5.0)), payload) == pytest.approx(200 + 300)


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\xc1" * 1000,
        b"\x90" * 1000,
        msgpack.packb([1, 2]),
        msgpack.packb({}),
        msgpack.packb({"ranges": b"1234"}),
        msgpack.packb({"ranges": "text", "angle_increment": 1.0, "range_min": 0.0, "range_max": 1.0}),
        msgpack.packb({"ranges": b"123", "angle_increment": 1.0, "range_min": 0.0, "range_max": 1.0}),
        msgpack.packb({"ranges": b"1234", "angle_increment": 1.0, "range_min": None, "range_max": 1.0}),
        msgpack.packb({"ranges": b"1234", "angle_increment": "x", "range_min": 0.0, "range_max": 1.0}),
    ],
    ids=range(10),
)
def test_what_is_no_scan_is_as_large_as_its_bytes(payload):
    assert cells(sizes(), payload) == 0.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, -1e300, 1e300])
def test_what_no_scan_may_say_makes_it_no_larger(fields, value):
    for name in ("range_min", "range_max", "angle_increment"):
        for model in ("beam", "sector"):
            found = sizes(sensor_model=model).cells(SOURCE, message(fields, [1.0, math.inf], **{name: value}))
            assert MESSAGE_CELLS < found < MESSAGE_CELLS + 300_000  # a circle of 30 m


def test_ranges_where_bytes_happen_to_lie_oddly(fields):
    for more in range(8):
        payload = msgpack.packb({"x" * more: 0} | fields.scan(np.arange(1.0, 20.0)))
        assert cells(sizes(), payload) == pytest.approx(10 * np.arange(1, 9).sum())


def test_a_rate_is_that_of_the_newest_scans():
    rate = CellRate()
    assert rate.value == FIRST_RATE
    for seconds in (0.001, 0.002, 0.003, 0.004, 0.005):
        rate.measured(1e6, seconds)
    assert rate.value == pytest.approx(3.5e-9)
    rate.measured(1e9, 1.0)  # large ones count for what they are
    assert rate.value == pytest.approx(1.012 / 1.003e9)
