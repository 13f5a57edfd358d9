"""ROS 2's laser scans as scans of the mapper: any number of beams, any way up, and no range changed."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import naive_cdr
import naive_tf
from ogm_core.errors import BadMessage, Tilted
from ogm_core.ros2.cdr import LaserScan, decode_laser_scan
from ogm_core.ros2.laser_scan import first_beam, mounted_scan
from ogm_core.ros2.transform import IDENTITY, Transform
from ogm_core.types import Pose
from ogm_core.wire.messages import decode_scan, encode_scan

STAMP = 5 * 10**9


def turned(roll=0.0, pitch=0.0, yaw=0.0, x=0.0, y=0.0):
    """A mount turned as URDF says: roll about x, then pitch about y, then yaw about z of the base."""

    def about(axis, angle):
        half = [math.sin(angle / 2) if n == axis else 0.0 for n in range(3)]
        return Transform(0, 0, 0, *half, math.cos(angle / 2))

    return (
        Transform(x, y, 0.1, 0, 0, 0, 1)
        .compose(about(2, yaw))
        .compose(about(1, pitch))
        .compose(about(0, roll))
    )


def message(ranges=(1.0, 2.0, 3.0), **given):
    values = {
        "stamp": STAMP,
        "frame": "laser",
        "angle_min": -1.0,
        "angle_increment": 0.5,
        "time_increment": 0.0,
        "range_min": 0.1,
        "range_max": 30.0,
        "ranges": np.array(ranges, np.float32),
    }
    return LaserScan(**values | given)


def bearings(scan):
    """Where the beams point in the base frame."""
    return scan.mount.theta + scan.angle_min + np.arange(scan.ranges.size) * scan.angle_increment


def true_bearings(sent, mount):
    """The same by matrices: each beam's direction, turned in 3D, seen from above."""
    angles = sent.angle_min + np.arange(sent.ranges.size) * sent.angle_increment
    ends = naive_tf.matrix(mount)[:3, :3] @ np.stack((np.cos(angles), np.sin(angles), np.zeros(angles.size)))
    return np.arctan2(ends[1], ends[0])


def off(one, other):
    return np.abs(np.angle(np.exp(1j * (one - other)))).max()


@pytest.mark.parametrize("yaw", [0.0, 1.0, math.pi, -2.5])
@pytest.mark.parametrize(
    ("roll", "pitch"), [(0, 0), (math.pi, 0), (0, math.pi), (-math.pi, 0), (math.pi, math.pi)]
)
def test_level_sensors_point_where_they_do_whichever_way_up(roll, pitch, yaw):
    sent, mount = message(range(12)), turned(roll, pitch, yaw, x=0.2, y=-0.3)
    scan = mounted_scan(sent, mount)
    assert off(bearings(scan), true_bearings(sent, mount)) < 1e-9
    assert (scan.mount.x, scan.mount.y) == (0.2, -0.3)
    upside_down = (roll == 0) != (pitch == 0)
    assert scan.angle_increment == (-0.5 if upside_down else 0.5)


@given(st.floats(-math.pi, math.pi), st.floats(-0.17, 0.17), st.booleans())
def test_up_to_ten_degrees_of_tilt_move_a_beam_little(yaw, tilt, upside_down):
    sent, mount = message(range(12)), turned(tilt + (math.pi if upside_down else 0.0), 0.0, yaw)
    assert off(bearings(mounted_scan(sent, mount)), true_bearings(sent, mount)) < 0.008


@pytest.mark.parametrize("flip", [0.0, math.pi])
@pytest.mark.parametrize("axis", ["roll", "pitch"])
def test_more_than_ten_degrees_of_tilt_are_refused(axis, flip):
    mounted_scan(message(), turned(**{axis: flip + math.radians(9.99)}))
    for degrees in (10.01, 45.0, 90.0):
        with pytest.raises(Tilted) as caught:
            mounted_scan(message(), turned(**{axis: flip + math.radians(degrees)}))
        assert caught.value.slug == "tilted"
        assert f"tilted by {degrees:.0f} degrees" in str(caught.value)


def test_a_scan_says_what_the_message_says():
    sent = message([0.0, math.inf, math.nan, -1.0, 5.0, 99.0], time_increment=0.01)
    scan = mounted_scan(sent, IDENTITY, seq=7, run="r")
    assert (scan.stamp, scan.seq, scan.run, scan.mount, scan.pose) == (STAMP, 7, "r", Pose(0, 0, 0), None)
    assert (scan.angle_min, scan.angle_increment) == (-1.0, 0.5)
    assert (scan.range_min, scan.range_max) == (0.1, 30.0)
    # What zeros and infs mean is for the sensors' settings to say.
    assert scan.ranges is sent.ranges
    again = decode_scan(encode_scan(scan))
    assert again.ranges.tobytes() == sent.ranges.tobytes()
    assert (again.mount, again.time_increment, again.pose) == (Pose(0, 0, 0), 0.0, None)


def test_the_number_of_beams_may_vary_and_ranges_tell_it():
    for count in (1, 456, 451, 2):
        # angle_max (the second number) says 3 beams; intensities may be of any number.
        numbers = (-1.0, 0.0, 0.5, 0.0, 0.1, 0.1, 30.0)
        payload = naive_cdr.laser_scan(STAMP, "laser", numbers, [2.0] * count, [1.0] * 5)
        scan = mounted_scan(decode_laser_scan(payload), IDENTITY)
        assert scan.ranges.tolist() == [2.0] * count
        assert bearings(scan)[-1] == pytest.approx(-1.0 + 0.5 * (count - 1))


def test_a_full_turn_may_come_with_its_first_beam_again():
    scan = mounted_scan(message([1.0] * 361, angle_min=0.0, angle_increment=math.tau / 360), IDENTITY)
    assert scan.ranges.size == 361
    assert bearings(scan)[-1] == pytest.approx(math.tau)


@pytest.mark.parametrize(
    ("deskew", "stamp", "time_increment"),
    [("off", STAMP, 0.0), ("auto", STAMP, 0.05), ("reversed", STAMP + 10**8, -0.05)],
)
def test_beams_are_taken_at_the_stamp_or_one_after_the_other_or_the_last_first(deskew, stamp, time_increment):
    sent = message(time_increment=0.05)
    scan = mounted_scan(sent, IDENTITY, deskew=deskew)
    assert (scan.stamp, scan.time_increment) == (stamp, time_increment)
    assert first_beam(sent, deskew=deskew) == stamp
    assert min(scan.stamp, scan.end_stamp) == STAMP
    later = mounted_scan(sent, IDENTITY, deskew=deskew, delay=-0.1)
    assert later.stamp == first_beam(sent, deskew=deskew, delay=-0.1) == stamp - 10**8
    assert mounted_scan(sent, IDENTITY).time_increment == 0.0  # unless asked


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"ranges": np.empty(0, np.float32)}, "ranges"),
        ({"angle_increment": 0.0}, "angle_increment"),
        ({"angle_increment": math.nan}, "angle_increment"),
        ({"angle_min": math.inf}, "angle_min"),
        ({"range_max": 0.05}, "range_min"),
        ({"range_max": math.inf}, "range_max"),
        ({"range_min": -1.0}, "range_min"),
        ({"time_increment": math.nan}, "time_increment"),
        ({"time_increment": math.inf}, "time_increment"),
        ({"stamp": -1}, "stamp"),
    ],
)
def test_what_no_mapper_would_take_is_refused_by_name(given, field):
    with pytest.raises(BadMessage, match=f"^{field}: "):
        mounted_scan(message(**given), IDENTITY, deskew="reversed")


def test_a_time_increment_that_is_not_used_may_be_anything():
    assert mounted_scan(message(time_increment=math.nan), IDENTITY).time_increment == 0.0


def test_more_beams_than_are_taken_are_refused():
    with pytest.raises(BadMessage, match="1 to 2 beams are needed, got 3"):
        mounted_scan(message(), IDENTITY, max_beams=2)
