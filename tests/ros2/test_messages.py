"""Messages that rclpy of two distributions wrote are read field by field; types have the hashes it states."""

import numpy as np
import pytest

from ogm_core.ros2 import cdr
from ogm_core.ros2.topics import TYPE_HASHES
from witness import wanted

SECONDS, NANOSECONDS = 1_700_000_000, 123_456_789
STAMP = SECONDS * 10**9 + NANOSECONDS
HEADER = {"stamp": {"sec": SECONDS, "nanosec": NANOSECONDS}, "frame_id": "/laser"}
RNG = np.random.default_rng(14)
READ = ("angle_min", "angle_increment", "time_increment", "range_min", "range_max")
NUMBERS = (*READ, "angle_max", "scan_time")


def written(rclpy, kind, values):
    return bytes.fromhex(rclpy.ask(type=kind, values=values)["cdr"])


def singles(shape=None):
    """Numbers that float32 holds."""
    return RNG.normal(size=shape).astype(np.float32).astype(float)


def seven():
    """A position and a rotation, and the numbers in the order of `Transform`."""
    numbers = RNG.normal(size=7).tolist()
    return (
        dict(zip("xyz", numbers, strict=False)),
        dict(zip("xyzw", numbers[3:], strict=True)),
        tuple(numbers),
    )


@pytest.mark.parametrize("beams", [0, 1, 360, 1081])
def test_laser_scans(rclpy, beams):
    numbers = dict(zip(NUMBERS, singles(7).tolist(), strict=True))
    ranges = singles(beams)
    ranges[1::7], ranges[2::7], ranges[3::7] = np.inf, np.nan, 0.0
    values = {"header": HEADER, **numbers, "ranges": ranges.tolist(), "intensities": singles(beams).tolist()}
    scan = cdr.decode_laser_scan(written(rclpy, cdr.LASER_SCAN, values))
    assert (scan.stamp, scan.frame) == (STAMP, "laser")
    for name in READ:
        assert getattr(scan, name) == numbers[name]
    assert scan.ranges.dtype == np.float32
    np.testing.assert_array_equal(scan.ranges, ranges)


def test_poses(rclpy):
    position, orientation, numbers = seven()
    pose = {"position": position, "orientation": orientation}
    values = {"header": HEADER, "pose": pose}
    read = cdr.decode_pose_stamped(written(rclpy, cdr.POSE_STAMPED, values))
    assert read == cdr.StampedPose(STAMP, "laser", "", numbers)

    values["pose"] = {"pose": pose, "covariance": RNG.normal(size=36).tolist()}
    read = cdr.decode_pose_with_covariance_stamped(written(rclpy, cdr.POSE_WITH_COVARIANCE_STAMPED, values))
    assert read == cdr.StampedPose(STAMP, "laser", "", numbers)

    twist = {"linear": seven()[0], "angular": seven()[0]}
    values["twist"] = {"twist": twist, "covariance": RNG.normal(size=36).tolist()}
    values["child_frame_id"] = "base_link"
    read = cdr.decode_odometry(written(rclpy, cdr.ODOMETRY, values))
    assert read == cdr.StampedPose(STAMP, "laser", "base_link", numbers)


@pytest.mark.parametrize("count", [0, 1, 30])
def test_transforms(rclpy, count):
    wanted(f"{rclpy.environment}-messages")
    values, expected = [], []
    for number in range(count):
        translation, rotation, numbers = seven()
        stamp = {"sec": number, "nanosec": 10**9 - 1 - number}
        parent, child = "p" * number, "c" * (count - number)  # of every length: what follows is aligned
        header = {"stamp": stamp, "frame_id": parent}
        moved = {"translation": translation, "rotation": rotation}
        values.append({"header": header, "child_frame_id": child, "transform": moved})
        expected.append((number * 10**9 + 10**9 - 1 - number, parent, child, numbers))
    read = cdr.decode_tf_message(written(rclpy, cdr.TF_MESSAGE, {"transforms": values}))
    assert list(read) == expected


@pytest.mark.parametrize("points", [0, 1, 500])
def test_point_clouds(rclpy, points):
    layout = [("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), ("ring", 12, 4, 1), ("time", 14, 8, 1)]
    fields = [dict(zip(("name", "offset", "datatype", "count"), field, strict=True)) for field in layout]
    data = RNG.integers(0, 256, points * 22).tolist()
    shape = {"height": 1, "width": points, "point_step": 22, "row_step": 22 * points}
    values = {
        "header": HEADER,
        "fields": fields,
        "is_bigendian": True,
        "is_dense": False,
        "data": data,
        **shape,
    }
    cloud = cdr.decode_point_cloud2(written(rclpy, cdr.POINT_CLOUD2, values))
    assert (cloud.stamp, cloud.frame, cloud.big_endian) == (STAMP, "laser", True)
    assert {name: getattr(cloud, name) for name in shape} == shape
    assert [(each.name, each.offset, each.datatype, each.count) for each in cloud.fields] == layout
    assert cloud.data.tolist() == data


@pytest.mark.parametrize("kind", sorted(TYPE_HASHES))
def test_type_hashes_are_those_that_the_distribution_states(rclpy, kind):
    if kind in (cdr.TF_MESSAGE, cdr.OCCUPANCY_GRID_UPDATE):
        wanted(f"{rclpy.environment}-messages")
    assert TYPE_HASHES[kind] == rclpy.ask(type=kind)["hash"]
