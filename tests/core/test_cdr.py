"""ROS 2's messages: those that other programs wrote are read right, and whatever else comes is refused."""

import json
import math
import subprocess
import sys
import tracemalloc
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import naive_cdr
from mutations import SEEDS, mutated
from ogm_core.errors import BadCdr, MissingExtra
from ogm_core.ros2 import cdr, typestore
from ogm_core.ros2.cdr import OccupancyGrid, OccupancyGridUpdate, PointField
from ogm_core.ros2.transform import Transform

DATA = Path(__file__).parent.parent / "data" / "ros2"
RCLPY = json.loads((DATA / "rclpy_cdr_samples.json").read_text())
NODE = json.loads((DATA / "real_ros2_kilted_fastdds_samples.json").read_text())
STAMP = 1_700_000_000_123_456_789
NUMBERS = (1.5, -2.5, 0.25, 0.0, 0.0, 0.6, 0.8)
SEVEN = (-math.pi, math.pi, 0.01, 1e-4, 0.1, 0.1, 30.0)
CLOUD_FIELDS = (("x", 0, 7), ("intensity", 12, 7), ("y", 4, 7), ("z", 8, 7))
CLOUD = (STAMP, "lidar", (2, 3), CLOUD_FIELDS, (16, 50), bytes(range(100)))


def written(order="<"):
    """A message of every type that is read, and what reads it."""
    return {
        cdr.LASER_SCAN: (
            naive_cdr.laser_scan(STAMP, "/laser", SEVEN, [1, 2, math.inf], [7.0], order),
            cdr.decode_laser_scan,
        ),
        cdr.TF_MESSAGE: (
            naive_cdr.tf_message([(STAMP, "/odom", "base", NUMBERS), (5, "base", "a", NUMBERS)], order),
            cdr.decode_tf_message,
        ),
        cdr.POSE_STAMPED: (naive_cdr.pose_stamped(STAMP, "map", NUMBERS, order), cdr.decode_pose_stamped),
        cdr.POSE_WITH_COVARIANCE_STAMPED: (
            naive_cdr.pose_with_covariance_stamped(STAMP, "map", NUMBERS, order),
            cdr.decode_pose_with_covariance_stamped,
        ),
        cdr.ODOMETRY: (
            naive_cdr.odometry(STAMP, "/odom", "/base", NUMBERS, order),
            cdr.decode_odometry,
        ),
        cdr.POINT_CLOUD2: (naive_cdr.point_cloud2(*CLOUD, order=order), cdr.decode_point_cloud2),
    }


TYPES = list(written())


def refused(payload, decode):
    with pytest.raises(BadCdr) as caught:
        decode(payload)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("payload", [RCLPY["kilted"]["LaserScan"], RCLPY["jazzy"]["LaserScan"]])
def test_laser_scans_of_rclpy_are_read(payload):
    scan = cdr.decode_laser_scan(bytes.fromhex(payload))
    assert (scan.stamp, scan.frame) == (STAMP, "laser")
    assert (scan.angle_min, scan.angle_increment) == (np.float32(-math.pi), np.float32(0.01))
    assert (scan.time_increment, scan.range_min, scan.range_max) == (0.0, np.float32(0.1), 30.0)
    np.testing.assert_array_equal(scan.ranges, np.array([1, 2, np.inf, np.nan], np.float32))
    assert scan.ranges.dtype == np.float32
    assert not scan.ranges.flags.writeable


def test_the_same_scan_by_another_program_says_the_same():
    (first, *_) = json.loads((DATA / "pyzeros_laserscan.json").read_text())["samples"]
    one, other = (
        cdr.decode_laser_scan(bytes.fromhex(text))
        for text in (first["payload_hex"], RCLPY["jazzy"]["LaserScan"])
    )
    np.testing.assert_array_equal(one.ranges, other.ranges)
    assert all(
        getattr(one, name) == getattr(other, name) for name in cdr.LaserScan.__slots__ if name != "ranges"
    )


def test_messages_taken_off_dds_are_read():
    scan = cdr.decode_laser_scan(bytes.fromhex(NODE["LaserScan_first"]))
    assert (scan.stamp, scan.frame, scan.ranges.size) == (1663967375543606542, "rplidar_link", 720)
    assert scan.angle_min == pytest.approx(-3.12414, abs=1e-5)
    moving = cdr.decode_tf_message(bytes.fromhex(NODE["TFMessage_first"]))
    assert [(each.parent, each.child) for each in moving] == [
        ("odom", "base_link"),
        ("odom", "base_footprint"),
    ]
    still = cdr.decode_tf_message(bytes.fromhex(NODE["TFMessage_static"]))
    assert len(still) == 23
    assert all(math.hypot(*each.transform[3:]) == pytest.approx(1.0, abs=1e-6) for each in still)


@pytest.mark.parametrize("release", ["kilted", "jazzy"])
def test_transforms_and_poses_of_rclpy_are_read(release):
    transform = bytes.fromhex(RCLPY[release]["TransformStamped"])
    # A TFMessage begins with a count, here 1; two bytes of padding are left before the seven numbers.
    message = transform[:4] + b"\1\0\0\0" + transform[4:38] + b"\0\0" + transform[44:]
    (edge,) = cdr.decode_tf_message(message)
    assert (edge.stamp, edge.parent, edge.child) == (1_700_000_000 * 10**9, "odom", "base_link")
    expected = (1.5, -2.5, 0.0, 0.0, 0.0, math.sin(0.25), math.cos(0.25))
    assert edge.transform == pytest.approx(expected, abs=1e-15)
    odometry = cdr.decode_odometry(bytes.fromhex(RCLPY[release]["Odometry"]))
    assert (odometry.stamp, odometry.frame, odometry.child) == (0, "odom", "base_link")
    assert odometry.transform == (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    pose = cdr.decode_pose_with_covariance_stamped(bytes.fromhex(RCLPY[release]["PoseWithCovarianceStamped"]))
    assert (pose.stamp, pose.frame, pose.child) == (0, "map", "")
    assert pose.transform == (3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize("order", ["<", ">"])
def test_both_byte_orders_are_read(order):
    payloads = written(order)

    def read(name):
        payload, decode = payloads[name]
        return decode(payload)

    scan = read(cdr.LASER_SCAN)
    assert (scan.stamp, scan.frame, scan.angle_increment) == (STAMP, "laser", np.float32(0.01))
    assert (scan.time_increment, scan.range_max) == (np.float32(1e-4), 30.0)
    assert scan.ranges.tolist() == [1.0, 2.0, math.inf]
    assert scan.ranges.dtype == np.float32
    first, second = read(cdr.TF_MESSAGE)
    assert first == (STAMP, "odom", "base", Transform(*NUMBERS))
    assert second == (5, "base", "a", Transform(*NUMBERS))
    for name in cdr.POSES:
        pose = cdr.POSES[name](payloads[name][0])
        assert (pose.stamp, pose.transform) == (STAMP, Transform(*NUMBERS))
    assert (read(cdr.ODOMETRY).frame, read(cdr.ODOMETRY).child) == ("odom", "base")
    cloud = read(cdr.POINT_CLOUD2)
    assert (cloud.stamp, cloud.frame, cloud.height, cloud.width) == (STAMP, "lidar", 2, 3)
    assert cloud.fields == tuple(PointField(*field, 1) for field in CLOUD_FIELDS)
    assert (cloud.point_step, cloud.row_step, cloud.big_endian) == (16, 50, False)
    assert cloud.data.tobytes() == bytes(range(100))


@pytest.mark.parametrize("name", TYPES)
def test_up_to_three_bytes_of_padding_may_follow(name):
    payload, decode = written()[name]
    for more in range(1, 4):
        assert repr(decode(payload + b"\xee" * more)) == repr(decode(payload))
    refused(payload + b"\xee" * 4, decode)


@pytest.mark.parametrize("name", TYPES)
@pytest.mark.parametrize("order", ["<", ">"])
def test_a_cut_message_is_refused(name, order):
    payload, decode = written(order)[name]
    for length in range(len(payload)):
        assert name in refused(payload[:length], decode)


@pytest.mark.parametrize("name", TYPES)
def test_a_message_of_another_type_is_refused(name):
    _, decode = written()[name]
    for other, (payload, _) in written().items():
        if other != name:
            refused(payload, decode)


def test_another_encoding_is_refused():
    payload, decode = written()[cdr.LASER_SCAN]
    for first in (b"\x00\x02", b"\x00\x03", b"\x00\x07", b"\x01\x01"):
        assert "encapsulation" in refused(first + payload[2:], decode)


@pytest.mark.parametrize("count", [2**31 - 1, 2**31, 2**32 - 1])
def test_arrays_that_claim_billions_cost_nothing(count):
    claimed = count.to_bytes(4, "little")
    scan = naive_cdr.laser_scan(STAMP, "laser", SEVEN, [])
    cloud = naive_cdr.Cdr().header(STAMP, "lidar").put("II", 2**31, 2**31).bytes
    for payload, decode in (
        (scan[:-8] + claimed + b"\0" * 64, cdr.decode_laser_scan),
        (b"\x00\x01\x00\x00" + claimed + b"\0" * 64, cdr.decode_tf_message),
        (cloud + claimed + b"\0" * 64, cdr.decode_point_cloud2),
        (scan[:12] + claimed + b"\0" * 64, cdr.decode_laser_scan),  # the frame's name
    ):
        refused(payload, decode)
        tracemalloc.start()
        try:
            refused(payload, decode)
            assert tracemalloc.get_traced_memory()[1] < 200_000
        finally:
            tracemalloc.stop()


SAMPLES = [
    *((payload, decode) for order in "<>" for payload, decode in written(order).values()),
    (bytes.fromhex(NODE["LaserScan_first"]), cdr.decode_laser_scan),
    (bytes.fromhex(NODE["TFMessage_static"]), cdr.decode_tf_message),
]


@given(SEEDS, st.sampled_from(SAMPLES))
def test_damaged_messages_are_read_or_refused(rng, sample):
    payload, decode = sample
    with suppress(BadCdr):
        decode(mutated(rng, payload))


@given(st.binary(max_size=200), st.sampled_from([decode for _, decode in SAMPLES]))
def test_any_bytes_are_read_or_refused(payload, decode):
    with suppress(BadCdr):
        decode(payload)


def test_an_occupancy_grid_is_that_of_rclpy():
    data = np.array([[0, 100, -1], [0, 100, -1]], np.int8)
    grid = OccupancyGrid(1_700_000_000 * 10**9, "map", 0.05, (-1.0, -2.0), data)
    ours, theirs = cdr.encode_occupancy_grid(grid), bytes.fromhex(RCLPY["kilted"]["OccupancyGrid"])
    # map_load_time, which rclpy's has not, and padding before the origin, which is undefined.
    assert len(ours) == len(theirs)
    assert [n for n in range(len(ours)) if ours[n] != theirs[n] and not (20 <= n < 28 or 40 <= n < 44)] == []


def test_a_grid_is_written_value_by_value():
    data = np.arange(-1, 11, dtype=np.int8).reshape(3, 4)
    grid = OccupancyGrid(STAMP, "carte", 0.1, (-1.5, 2.25), data)
    expected = naive_cdr.occupancy_grid(STAMP, "carte", 0.1, (4, 3), (-1.5, 2.25), data.reshape(-1).tolist())
    assert cdr.encode_occupancy_grid(grid) == _zeroed(expected)
    turned = OccupancyGrid(STAMP, "carte", 0.1, (-1.5, 2.25), np.asfortranarray(data))
    assert cdr.encode_occupancy_grid(turned) == cdr.encode_occupancy_grid(grid)


def test_an_update_is_written_value_by_value():
    data = np.arange(12, dtype=np.int8).reshape(3, 4)
    update = OccupancyGridUpdate(STAMP, "map", 7, 9, data[1:, 1:3])
    expected = naive_cdr.occupancy_grid_update(STAMP, "map", (7, 9), (2, 2), [5, 6, 9, 10])
    assert cdr.encode_occupancy_grid_update(update) == _zeroed(expected)


def _zeroed(payload):
    """With zeros for padding; no value of these tests has such a byte."""
    return payload.replace(b"\xee", b"\0")


@pytest.mark.parametrize("stamp", [2**31 * 10**9, 2**63 - 1])
def test_a_stamp_past_the_last_of_ros_is_the_last(stamp):
    grid = OccupancyGrid(stamp, "map", 0.1, (0.0, 0.0), np.zeros((1, 1), np.int8))
    last = OccupancyGrid(cdr.LAST_STAMP, "map", 0.1, (0.0, 0.0), np.zeros((1, 1), np.int8))
    assert cdr.encode_occupancy_grid(grid) == cdr.encode_occupancy_grid(last)
    assert cdr.encode_occupancy_grid(last)[4:12] == b"\xff\xff\xff\x7f\0\0\0\0"


def test_without_the_extra_one_line_says_what_to_install(monkeypatch):
    typestore.rosbags_types.cache_clear()
    monkeypatch.setitem(sys.modules, "rosbags.serde", None)
    try:
        with pytest.raises(
            MissingExtra, match=r"^ROS 2 messages need rosbags: pip install 'zenoh-ogm\[ros2\]'$"
        ):
            cdr.decode_laser_scan(b"")
    finally:
        typestore.rosbags_types.cache_clear()


def test_nobody_needs_the_extra_to_import_the_room():
    code = (
        "import pkgutil, sys, ogm_core.ros2 as room\n"
        "names = [each.name for each in pkgutil.walk_packages(room.__path__, 'ogm_core.ros2.')]\n"
        "for name in names: __import__(name)\n"
        "print('ogm_core.ros2.cdr' in names, [name for name in sys.modules if 'rosbags' in name])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "True []\n"
