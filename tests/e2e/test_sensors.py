"""Sensors whose messages say too little or something wrong: the map is right, or a hint names the setting."""

import math
import re

import numpy as np
import pytest

from room import STEP, T0, S, astray, drive, ranges, scan

WALL = 5.025


def p_at(npz, x, y):
    """Probability of the cell at a point; None where unknown."""
    resolution = float(npz["resolution"])
    ix, iy = (
        math.floor((value - anchor) / resolution) - int(offset)
        for value, anchor, offset in zip((x, y), npz["anchor"], npz["offset"], strict=True)
    )
    height, width = npz["log_odds"].shape
    if not (0 <= ix < width and 0 <= iy < height) or np.isnan(npz["log_odds"][iy, ix]):
        return None
    return 1 / (1 + math.exp(-npz["log_odds"][iy, ix]))


def wall_left(npz):
    """How many of 91 points on the west wall are occupied."""
    return sum((p_at(npz, -WALL, y / 10 + 0.01) or 0) > 0.65 for y in range(-45, 46))


def masked(fill, limit=25.0):
    """A robot turns once and stands; the sensor's view of its own body is hidden by a number."""
    log = []
    for k in range(60):
        theta = min(k, 20) * math.tau / 20
        measured = ranges(0.3, 0.2, theta)
        measured[135:225] = [fill] * 90
        log.append(scan(5 + k, measured, k, range_max=limit, pose=[0.3, 0.2, theta]))
    return log


def test_ranges_above_range_max_are_no_readings(built):
    hidden, _ = built(masked("nan"))
    npz, said = built(masked(26.0))
    assert wall_left(npz) == wall_left(hidden) == 41
    assert npz["log_odds"].shape == hidden["log_odds"].shape
    assert "r1/laser: 25% of its finite ranges are above its range_max of 25 m" in said
    assert "set beyond to clear" in said


def test_or_mean_that_nothing_was_there(built):
    cleared, _ = built(masked("inf"))
    npz, said = built(masked(26.0), "--sensor", "r1/*:beyond=clear")
    assert np.array_equal(npz["log_odds"], cleared["log_odds"], equal_nan=True)
    assert wall_left(npz) < 30
    assert "beyond" not in said


def test_range_max_itself_however_rounded_is_no_return(built):
    for limit, reading in ((8.1, float(np.float32(8.1))), (8.1, 8.1), (8.1, 8.1000001)):
        npz, _ = built([scan(T0, [reading] * 360, 0, range_max=limit, pose=[0, 0, 0])])
        assert p_at(npz, 8.0, 0.01) < 0.5


def own_maximum(limit):
    """A sensor that faces a wall and gives each scan's largest reading as its range_max."""
    rng = np.random.default_rng(1)
    log = []
    for k in range(50):
        angles = -0.1 + np.arange(61) * 0.2 / 60
        measured = (5.02 / np.cos(angles) + rng.normal(0, 0.01, 61)).tolist()
        range_max = float(np.float32(max(measured))) if limit is None else limit
        fields = {"angle_min": -0.1, "angle_increment": 0.2 / 60, "range_max": range_max}
        log.append(scan(5 + k, measured, k, pose=[0, 0, 0], **fields))
    return log


def test_a_range_max_that_is_each_scans_own_maximum(built):
    right, said = built(own_maximum(30.0))
    assert "range_max" not in said
    erased, said = built(own_maximum(None))
    assert "r1/laser: its range_max differs from scan to scan" in said
    npz, said = built(own_maximum(None), "--sensor", "r1/laser:range_max=30")
    assert "differs" not in said
    assert np.array_equal(npz["log_odds"], right["log_odds"], equal_nan=True)
    wall = [5.03, *[5.03] * 4], [-0.4, -0.2, 0.01, 0.2, 0.4]
    assert [p_at(npz, x, y) > 0.65 for x, y in zip(*wall, strict=True)] == [True] * 5
    assert [p_at(erased, x, y) > 0.65 for x, y in zip(*wall, strict=True)] == [False] * 5


def test_stamps_that_come_too_late(built):
    late = drive(lambda t: (0.5, 0.2, t), 10)
    for message in late:
        message["stamp"] += S // 5 * (message["type"] == "scan")
    npz, _ = built(late)
    assert astray(npz)[0] > 500
    npz, said = built(late, "--sensor", "r1/laser:time_offset=-0.2")
    assert astray(npz) == (0, astray(npz)[1])
    assert "100 integrated" in said


def test_a_sensor_that_says_inf_for_what_it_could_not_read(built):
    rng = np.random.default_rng(2)
    log = drive(lambda t: (0.3 * t - 1, 0.2, 0.1 * t), 10)
    for message in log:
        if message["type"] == "scan":
            invalid = rng.random(360) < 2 / 3
            message |= {
                "ranges": ["inf" if bad else r for bad, r in zip(invalid, message["ranges"], strict=True)]
            }
            message["range_max"] = 6.0
    npz, said = built(log)
    assert wall_left(npz) < 20
    assert re.search(r"r1/laser: \d+% of its beams have no return, .* set ignore_no_return for it", said)
    npz, said = built(log, OGM_SENSORS="*/laser:ignore_no_return=true")
    assert wall_left(npz) > 60
    assert astray(npz)[0] == 0
    assert "no return" not in said


def test_a_room_with_open_doors_is_no_such_sensor(built):
    log = drive(lambda t: (0.3 * t - 1, 0.2, 0.1 * t), 10)
    for message in log:
        if message["type"] == "scan":
            message["range_max"] = 5.5  # most beams see nothing, the others the walls
            message["ranges"] = [r if r < 5.3 else "inf" for r in message["ranges"]]
    _, said = built(log)
    assert "ignore_no_return" not in said


def test_upside_down_and_mounted_elsewhere(built):
    right, _ = built(drive(lambda t: (0.1 * t, 0.0, 0.4), 5))
    upside_down = drive(lambda t: (0.1 * t, 0.0, 0.4), 5)
    for message in upside_down:
        if message["type"] == "scan":
            message["ranges"] = [message["ranges"][-k] for k in range(360)]
            message["mount"] = [1.0, 2.0, 3.0]
    assert astray(built(upside_down)[0])[0] > 500
    npz, _ = built(upside_down, "--sensor", "r1/laser:mount=0,0,0,upside_down=true")
    assert np.array_equal(npz["log_odds"], right["log_odds"], equal_nan=True)


def test_reach_clear_range_and_range_min_of_one_sensor(built):
    log = [scan(T0, ["inf"] * 360, 0, range_max=10.0, pose=[0, 0, 0])]
    log += [message | {"sensor": "other"} for message in log]
    npz, _ = built(log, "--sensor", "*/other:reach=2", "--sensor", "r1/laser:clear_range=3")
    assert (p_at(npz, 2.9, 0.01) < 0.5, p_at(npz, 3.1, 0.01)) == (True, None)
    near = [scan(T0, [0.5] * 360, 0, pose=[0, 0, 0]), scan(T0, ranges(0, 0, 0), 1, pose=[0, 0, 0])]
    npz, _ = built(near, "--sensor", "r1/laser:range_min=0.6")
    assert p_at(npz, 0.51, 0.01) < 0.5


def test_bearings_in_degrees_and_stamps_in_seconds_are_hinted_at(built):
    log = [
        scan(1_700_000_000 + k // 10, ranges(0, 0, 0), k, pose=[0, 0, 0], angle_increment=1.0)
        for k in range(20)
    ]
    _, said = built(log)
    assert "its bearings go 57" in said
    assert "its stamps look like s since 1970" in said
    _, said = built([scan(T0 + k * S // 10, ranges(0, 0, 0), k, pose=[0, 0, 0]) for k in range(20)])
    assert said.count("\n") == 1


def test_wide_increments_with_the_sector_model_are_hinted_at(built):
    log = [scan(T0, ranges(0, 0, 0)[::6], 0, pose=[0, 0, 0], angle_increment=6 * STEP)]
    _, said = built(log, "--sensor-model", "sector")
    assert "its bearings are 6 degrees apart" in said
    _, said = built(log)
    assert "degrees" not in said


@pytest.mark.parametrize("model", ["beam", "sector"])
def test_a_sensor_of_one_beam(built, model):
    log = [
        scan(T0 + k * S, [2.02], k, pose=[0, 0, k * 0.01], angle_increment=0.0, time_increment=0.0)
        for k in range(5)
    ]
    log.insert(0, scan(T0, ranges(0, 0, 0), 9, pose=[0, 0, 0]))
    npz, said = built(log, "--sensor-model", model)
    assert "6 integrated" in said
    if model == "beam":
        assert p_at(npz, 2.01, 0.001) > 0.5


def test_a_glob_that_fits_no_sensor_is_told(built):
    _, said = built(drive(lambda t: (0.1 * t, 0.0, 0.4), 1), "--sensor", "r2/*:range_min=0.2")
    assert "sensors: r2/*: no sensor of this log is called so" in said


def test_deskew_false_takes_a_scan_at_its_stamp(built):
    log = drive(lambda t: (0.0, 0.0, t), 3)
    slow = [message | ({"time_increment": 0.0002} if message["type"] == "scan" else {}) for message in log]
    right, _ = built(log)
    npz, _ = built(slow, "--sensor", "*:deskew=false")
    assert astray(right)[0] == astray(npz)[0] == 0
    assert astray(built(slow)[0])[0] > 100
