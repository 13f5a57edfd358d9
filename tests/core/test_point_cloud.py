"""Point clouds as scans: the nearest point at the robot's height in each direction, whatever the layout."""

import math
import struct

import numpy as np
import pytest

import naive_cdr
import naive_tf
from ogm_core.errors import BadMessage, BadSetting
from ogm_core.ros2.cdr import PointCloud2, PointField, decode_point_cloud2
from ogm_core.ros2.point_cloud import Flattening, flattened_scan
from ogm_core.ros2.transform import IDENTITY, Transform, unit
from ogm_core.types import Pose

RULES = Flattening(0.2, 1.0, bins=36, range_min=0.5, range_max=20.0)
TILTED = unit(Transform(0.3, -0.2, 0.6, 0.1, -0.3, 0.5, math.sqrt(1 - 0.35)))
XYZ = (PointField("x", 0, 7, 1), PointField("y", 4, 7, 1), PointField("z", 8, 7, 1))


def cloud_of(points, *, shape=None, fields=XYZ, step=12, row_step=None, data=None, big_endian=False):
    packed = b"".join(struct.pack("<fff", *point) for point in points)
    height, width = shape or (1, len(points))
    data = packed if data is None else data
    return PointCloud2(
        7, "lidar", height, width, fields, big_endian, step,
        width * step if row_step is None else row_step, np.frombuffer(data, np.uint8),
    )  # fmt: skip


def naive_ranges(points, mount, rules):
    """The nearest range of each bin, by one point after the other."""
    nearest = [math.nan] * rules.bins
    for point in points:
        if not all(map(math.isfinite, point)):
            continue
        x, y, z, _ = naive_tf.matrix(mount) @ [*point, 1.0]
        ahead, left = x - mount.x, y - mount.y
        away = math.hypot(ahead, left)
        if rules.z_min <= z <= rules.z_max and rules.range_min <= away <= rules.range_max:
            n = round((math.atan2(left, ahead) + math.pi) / math.tau * rules.bins) % rules.bins
            nearest[n] = away if math.isnan(nearest[n]) else min(away, nearest[n])
    return nearest


def random_points(mount, count, seed=1):
    """Points around a sensor, in its frame, none near the edge of a bin, of the band or of the distances."""
    rng = np.random.default_rng(seed)
    bearings = (rng.integers(0, 36, count) + rng.uniform(-0.45, 0.45, count)) * math.tau / 36 - math.pi
    away = rng.choice([0.2, 0.4, 0.6, 3.0, 7.0, 19.0, 21.0], count) * rng.uniform(0.98, 1.02, count)
    z = rng.choice([-0.5, 0.1, 0.3, 0.6, 0.9, 1.1], count)
    base = np.stack((mount.x + away * np.cos(bearings), mount.y + away * np.sin(bearings), z, np.ones(count)))
    return (np.linalg.inv(naive_tf.matrix(mount)) @ base)[:3].T.astype(np.float32)


@pytest.mark.parametrize("mount", [IDENTITY, TILTED])
def test_a_cloud_is_flattened_as_point_by_point(mount):
    points = random_points(mount, 150)
    scan = flattened_scan(cloud_of(points, shape=(10, 15)), mount, RULES, delay=-2e-9, seq=4, run="r")
    expected = naive_ranges(points.tolist(), mount, RULES)
    assert 5 < np.isfinite(expected).sum() < 36
    np.testing.assert_allclose(scan.ranges, expected, rtol=1e-5)
    assert scan.ranges.dtype == np.float32
    assert not scan.ranges.flags.writeable
    assert (scan.stamp, scan.seq, scan.run) == (5, 4, "r")
    assert scan.mount == Pose(mount.x, mount.y, 0.0)
    assert (scan.angle_min, scan.angle_increment) == (-math.pi, math.tau / 36)
    assert (scan.range_min, scan.range_max, scan.time_increment) == (0.5, 20.0, 0.0)


def test_beams_point_at_the_points():
    rules = Flattening(-1.0, 1.0, bins=4)
    scan = flattened_scan(cloud_of([(2, 0, 0), (0, 3, 0), (-4, 0.1, 0), (-5, -0.1, 0)]), IDENTITY, rules)
    assert scan.angle_min + 2 * scan.angle_increment == pytest.approx(0.0)
    np.testing.assert_allclose(scan.ranges, [math.hypot(4, 0.1), math.nan, 2, 3])


@pytest.mark.parametrize("shape", [(1, 20_000), (20_000, 1), (3, 10_001), (160, 125)])
def test_every_point_of_a_large_cloud_counts(shape):
    count = shape[0] * shape[1]
    bearing = -math.pi + (np.arange(count) % 720) * math.tau / 720
    for lone in (0, 8191, 8192, count // 2, count - 1):
        away = np.where(np.arange(count) == lone, 1.0, 9.0)
        points = np.stack((away * np.cos(bearing), away * np.sin(bearing), np.zeros(count)), axis=1)
        data = points.astype("<f4").tobytes()
        cloud = cloud_of([], shape=shape, row_step=12 * shape[1], data=data)
        ranges = flattened_scan(cloud, IDENTITY, Flattening(-1.0, 1.0)).ranges
        assert np.flatnonzero(ranges < 5.0).tolist() == [lone % 720]
        assert np.isfinite(ranges).all()


@pytest.mark.parametrize("bins", [1, 2, 3, 36, 720, 36_000])
def test_every_bearing_has_its_bin(bins):
    rng = np.random.default_rng(bins)
    k = np.concatenate((rng.integers(0, bins, 2000), np.arange(min(bins, 720))))
    inside = np.concatenate((rng.uniform(-0.49, 0.49, 2000), np.zeros(min(bins, 720))))
    bearing = -math.pi + (k + inside) * math.tau / bins
    away = rng.permutation(len(k)) + 1.0
    points = np.stack((away * np.cos(bearing), away * np.sin(bearing), np.zeros(len(k))), axis=1)
    rules = Flattening(-1.0, 1.0, bins=bins, range_min=0.0, range_max=1000.0)
    expected = np.full(bins, np.inf)
    counted = away <= 999.5
    np.minimum.at(expected, k[counted], away[counted])
    points = np.append(points[counted], [[0.0, 0.0, 0.0]], axis=0)  # the sensor itself is no reading
    ranges = flattened_scan(cloud_of(points), IDENTITY, rules).ranges
    np.testing.assert_allclose(np.nan_to_num(ranges, nan=np.inf), expected, rtol=1e-6)


def test_points_that_are_no_points_say_nothing():
    bad = [(math.nan,) * 3, (math.inf, 0, 0), (1, -math.inf, 0.5), (3e38, 3e38, 0.5), (1, 1, math.nan)]
    for mount in (IDENTITY, TILTED, Transform(0, 0, 0, 0, 0, math.sin(0.4), math.cos(0.4))):
        assert np.isnan(flattened_scan(cloud_of(bad), mount, RULES).ranges).all()


def test_a_direction_without_a_point_says_nothing_or_that_nothing_is_there():
    points = [(2, 0, 0.5), (0, 2, 5.0)]
    scan = flattened_scan(cloud_of(points), IDENTITY, RULES)
    assert np.isnan(scan.ranges).sum() == 35
    clear = flattened_scan(cloud_of(points), IDENTITY, Flattening(0.2, 1.0, bins=36, clear=True))
    assert np.isinf(clear.ranges).sum() == 35
    assert np.nanmin(scan.ranges) == np.min(clear.ranges) == 2.0


@pytest.mark.parametrize("shape", [(0, 5), (5, 0), (0, 0)])
def test_a_cloud_without_points_is_a_scan_that_says_nothing(shape):
    assert np.isnan(flattened_scan(cloud_of([], shape=shape), IDENTITY, RULES).ranges).all()


@pytest.mark.parametrize(("order", "big_endian"), [("<", False), (">", True)])
@pytest.mark.parametrize(("letter", "datatype"), [("f", 7), ("d", 8)])
def test_any_layout_and_byte_order_is_read(order, big_endian, letter, datatype):
    points = random_points(IDENTITY, 60)
    size = struct.calcsize(letter)
    # z first, then a ring, then y and x at odd offsets; 5 bytes between rows.
    step, row_step = 3 * size + 4, 6 * (3 * size + 4) + 5
    fields = (("z", 0, datatype), ("ring", size, 4), ("y", size + 3, datatype), ("x", 2 * size + 3, datatype))
    rows = b""
    for n, (x, y, z) in enumerate(points.tolist()):
        rows += struct.pack(f"{order}{letter}HB{2 * letter}B", z, 9, 8, y, x, 7)
        rows += b"\xff" * 5 if n % 6 == 5 else b""
    for cdr_order in "<>":
        payload = naive_cdr.point_cloud2(
            *(7, "lidar", (10, 6), fields, (step, row_step), rows), big_endian=big_endian, order=cdr_order
        )
        scan = flattened_scan(decode_point_cloud2(payload), IDENTITY, RULES)
        np.testing.assert_allclose(scan.ranges, naive_ranges(points.tolist(), IDENTITY, RULES), rtol=1e-5)


def test_whole_numbers_are_read_too():
    fields = tuple(PointField(name, n, 1, 1) for n, name in enumerate("xyz"))
    data = struct.pack("6b", 3, 4, 0, -6, 8, 0)
    cloud = cloud_of([], shape=(1, 2), fields=fields, step=3, data=data)
    scan = flattened_scan(cloud, IDENTITY, Flattening(-1.0, 1.0))
    assert sorted(scan.ranges[np.isfinite(scan.ranges)].tolist()) == [5.0, 10.0]


def test_of_a_single_row_no_row_step_is_needed():
    scan = flattened_scan(cloud_of([(2, 0, 0.5)] * 3, row_step=0), IDENTITY, RULES)
    assert np.nanmin(scan.ranges) == 2.0


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"shape": (1, 4)}, "1 rows of 4 points with point_step 12 and row_step 48 do not fit 36 bytes"),
        ({"shape": (2, 2), "row_step": 12}, "do not fit"),
        ({"shape": (3, 1), "row_step": 13}, "do not fit"),
        ({"shape": (2**32 - 1, 2**32 - 1), "row_step": 0}, "do not fit"),
        ({"shape": (1, 2**32 - 1), "step": 0}, "do not fit"),
        ({"step": 11}, "field z ends past its point, whose point_step is 11"),
        ({"fields": XYZ[:2]}, "it has no field z; its fields: x, y"),
        ({"fields": ()}, "it has no field x; its fields: none"),
        ({"fields": (PointField("x", 0, 9, 1), *XYZ[1:])}, "field x has the unknown datatype 9"),
        ({"fields": (PointField("x", 2**32 - 1, 7, 1), *XYZ[1:])}, "field x ends past its point"),
    ],
)
def test_a_layout_that_does_not_fit_is_refused_by_name(given, text):
    with pytest.raises(BadMessage) as caught:
        flattened_scan(cloud_of([(1, 2, 3)] * 3, **given), IDENTITY, RULES)
    assert text in str(caught.value)


@pytest.mark.parametrize(
    "given",
    [
        {"z_min": 1.0, "z_max": 1.0},
        {"z_min": math.nan, "z_max": 1.0},
        {"z_min": -math.inf, "z_max": 1.0},
        {"z_min": 0.0, "z_max": 1.0, "bins": 0},
        {"z_min": 0.0, "z_max": 1.0, "bins": 10**6},
        {"z_min": 0.0, "z_max": 1.0, "range_min": 5.0, "range_max": 5.0},
        {"z_min": 0.0, "z_max": 1.0, "range_max": math.inf},
    ],
)
def test_rules_that_make_no_sense_are_refused(given):
    with pytest.raises(BadSetting):
        Flattening(**given)
