import math

import numpy as np
import pytest

from ogm_core.errors import BadSetting
from ogm_core.simulation import lidar as module
from ogm_core.simulation.catalogue import office
from ogm_core.simulation.lidar import Lidar, measure, true_ranges
from ogm_core.simulation.trajectories import CirclePath
from ogm_core.simulation.worlds import World, lab
from ogm_core.types import Pose

ORIGIN = Pose(0.0, 0.0, 0.0)
LONG = 100.0


def world_of(circles=(), segments=()):
    return World(
        "test",
        np.array(circles, dtype=np.float64).reshape(-1, 3),
        np.array(segments, dtype=np.float64).reshape(-1, 4),
        CirclePath(0.0, 0.0, 1.0, 1),
    )


def box(xmin, ymin, xmax, ymax):
    return [
        (xmin, ymin, xmax, ymin),
        (xmax, ymin, xmax, ymax),
        (xmax, ymax, xmin, ymax),
        (xmin, ymax, xmin, ymin),
    ]


def ahead(world, pose=ORIGIN, range_max=LONG):
    """Range of a single beam along the pose's heading, exactly."""
    sensor = Lidar(beams=1, fov=1.0, range_max=range_max, noise=0.0)
    assert sensor.bearings.tolist() == [0.0]
    (found,) = true_ranges(world, pose, sensor)
    return float(found)


def naive_ranges(world, pose, sensor):
    """The slow obvious twin: every beam against every obstacle, each equation solved on its own."""
    found = []
    for k in range(sensor.beams):
        angle = pose.theta + sensor.angle_min + k * sensor.angle_increment
        dx, dy = math.cos(angle), math.sin(angle)
        met = [sensor.range_max]
        for cx, cy, r in world.circles.tolist():
            # |pose + t d - c|^2 = r^2, a quadratic equation in t.
            ox, oy = pose.x - cx, pose.y - cy
            b, c = ox * dx + oy * dy, ox * ox + oy * oy - r * r
            if b * b - c >= 0:
                met += [-b - math.sqrt(b * b - c), -b + math.sqrt(b * b - c)]
        for x1, y1, x2, y2 in world.segments.tolist():
            # pose + t d = start + u (end - start), two linear equations in t and u.
            ex, ey = x2 - x1, y2 - y1
            det = ey * dx - ex * dy
            if det != 0:
                wx, wy = x1 - pose.x, y1 - pose.y
                if 0 <= (wx * dy - wy * dx) / det <= 1:
                    met.append((wx * ey - wy * ex) / det)
        found.append(min(t for t in met if t > 0))
    return np.array(found)


# The sensor.


def test_lab_sensor():
    sensor = Lidar.lab()
    assert (sensor.beams, sensor.angle_min, sensor.angle_increment) == (360, -math.pi, 2 * math.pi / 360)
    assert (sensor.range_min, sensor.range_max, sensor.noise) == (0.0, 8.0, 0.02)
    assert sensor == Lidar()


def test_less_than_a_full_circle_has_a_beam_on_either_edge():
    sensor = Lidar(beams=1081, fov=math.radians(270))
    assert sensor.angle_min == -math.radians(135)
    assert sensor.angle_increment == pytest.approx(math.radians(0.25))
    assert sensor.bearings[[0, 540, 1080]] == pytest.approx([-math.radians(135), 0.0, math.radians(135)])


def test_single_beams():
    narrow, full = Lidar(beams=1, fov=0.5), Lidar(beams=1)
    assert (narrow.angle_min, narrow.angle_increment) == (0.0, 0.5)
    assert (full.angle_min, full.angle_increment) == (-math.pi, 2 * math.pi)


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        *(("beams", value) for value in (0, -1, 200_001)),
        *(("fov", value) for value in (0.0, -1.0, math.nextafter(2 * math.pi, 7), math.nan, math.inf)),
        *(("range_max", value) for value in (0.0, -8.0, 1000.1, math.nan, math.inf)),
        *(("noise", value) for value in (-0.01, math.nan, math.inf)),
        *(("range_min", value) for value in (-0.1, 8.0, math.nan)),
    ],
)
def test_refused_settings(setting, value):
    with pytest.raises(BadSetting, match=f"^{setting}: .* got "):
        Lidar(**{setting: value})


def test_largest_settings():
    Lidar(beams=200_000, fov=2 * math.pi, range_max=1000.0, noise=0.0)


# Ranges against closed-form geometry.


@pytest.mark.parametrize("theta", [0.0, 0.3, -2.0, 7.5, 1000.0])
def test_middle_of_a_box(theta):
    """In the middle of a 6 x 4 m box: min(3 / |cos|, 2 / |sin|)."""
    sensor = Lidar(beams=360, range_max=LONG)
    ranges = true_ranges(world_of(segments=box(-3, -2, 3, 2)), Pose(0.0, 0.0, theta), sensor)
    angles = theta + sensor.bearings
    with np.errstate(divide="ignore"):
        expected = np.minimum(3 / np.abs(np.cos(angles)), 2 / np.abs(np.sin(angles)))
    np.testing.assert_allclose(ranges, expected, rtol=1e-12)


def test_facing_a_circle():
    """Circle of radius 1, 5 m ahead: seen up to asin(1/5) on either side, r = 5 cos - sqrt(1 - 25 sin^2)."""
    sensor = Lidar(beams=721, fov=math.pi, range_max=9.5)
    ranges = true_ranges(world_of(circles=[(5, 0, 1)]), ORIGIN, sensor)
    seen = np.abs(sensor.bearings) <= math.asin(0.2)
    s, c = np.sin(sensor.bearings[seen]), np.cos(sensor.bearings[seen])
    assert ranges[360] == 4.0
    np.testing.assert_allclose(ranges[seen], 5 * c - np.sqrt(1 - 25 * s * s), rtol=1e-12)
    assert np.all(ranges[~seen] == 9.5)


def test_inside_a_circle_ends_where_it_leaves_it():
    sensor = Lidar(beams=360, range_max=LONG)
    ranges = true_ranges(world_of(circles=[(0.5, 0, 2)]), ORIGIN, sensor)
    s, c = np.sin(sensor.bearings), np.cos(sensor.bearings)
    np.testing.assert_allclose(ranges, 0.5 * c + np.sqrt(4 - 0.25 * s * s), rtol=1e-12)


@pytest.mark.parametrize(
    ("circle", "expected"),
    [
        ((5, 1, 1), 5.0),  # a tangent counts
        ((5, -1, 1), 5.0),
        ((5, 1.0000001, 1), LONG),
        ((-5, 0, 1), LONG),  # behind
        ((1, 0, 1), 2.0),  # standing on the outline, looking in
        ((-1, 0, 1), LONG),  # standing on it, looking out
        ((0, 0, 1), 1.0),
    ],
)
def test_grazing_and_touching_circles(circle, expected):
    assert ahead(world_of(circles=[circle])) == expected


@pytest.mark.parametrize(
    ("wall", "expected"),
    [
        ((3, -1, 3, 1), 3.0),
        ((3, 1, 3, -1), 3.0),
        ((2, -2, 6, 2), 4.0),
        ((3, 0, 3, 1), 3.0),  # through its end
        ((3, -1, 3, 0), 3.0),
        ((3, 1e-9, 3, 1), LONG),  # just past its end
        ((-3, -1, -3, 1), LONG),  # behind
        ((-5, 1, 5, 1), LONG),  # parallel
        ((2, 0, 4, 0), 2.0),  # edge-on
        ((4, 0, 2, 0), 2.0),
        ((-4, 0, -2, 0), LONG),
        ((-1, 0, 2, 0), 2.0),  # standing on it, looking along it
        ((0, 0, 2, 0), 2.0),  # standing on its end
        ((-2, 0, 0, 0), LONG),
        ((0, -1, 0, 1), LONG),  # standing on it, looking across
        ((0, 0, 0, 1), LONG),
    ],
)
def test_segments_met_and_missed(wall, expected):
    assert ahead(world_of(segments=[wall])) == expected


@pytest.mark.parametrize("wall", [(5, 1e-16, -5, 1e-16), (-5, 1e-16, 5, 1e-16)])
def test_a_wall_so_near_that_its_ends_are_half_a_turn_apart(wall):
    """On which side it lies is below the rounding of its ends' directions."""
    assert ahead(world_of(segments=[wall]), Pose(0.0, 0.0, math.pi / 2)) == pytest.approx(1e-16, rel=0.5)
    assert ahead(world_of(segments=[wall]), Pose(0.0, 0.0, -math.pi / 2)) == LONG


@pytest.mark.parametrize("side", [1, -1])
def test_the_ends_of_walls_after_many_turns(side):
    """Walls that reach 1e-11 m across the beam, with headings that are only good to 1e-10 rad."""
    for theta in np.linspace(9e5, 1e6, 300):
        dx, dy = math.cos(theta), math.sin(theta)
        (x1, y1), (x2, y2) = [(3 * dx - side * w * dy, 3 * dy + side * w * dx) for w in (-1e-11, 2.0)]
        assert ahead(world_of(segments=[(x1, y1, x2, y2)]), Pose(0.0, 0.0, theta)) == pytest.approx(3.0)


def test_nearest_wins():
    world = world_of(circles=[(9, 0, 1), (5, 0, 0.5)], segments=[(7, -1, 7, 1), (6, -1, 6, 1)])
    assert ahead(world) == 4.5


@pytest.mark.parametrize(("range_max", "expected"), [(4.0, 4.0), (5.0, 5.0), (5.5, 5.0)])
def test_nothing_within_range_max_reads_range_max(range_max, expected):
    assert ahead(world_of(segments=[(5, -1, 5, 1)]), range_max=range_max) == expected


def test_no_beam_slips_out_at_a_corner():
    """Beams aimed straight at the corners of rooms, from anywhere, with corners that are no round numbers."""
    rng = np.random.default_rng(5)
    for _ in range(300):
        xmin, ymin, xmax, ymax = (
            rng.uniform(-9, -1),
            rng.uniform(-9, -1),
            rng.uniform(1, 9),
            rng.uniform(1, 9),
        )
        room = world_of(segments=box(xmin, ymin, xmax, ymax))
        x, y = rng.uniform(xmin, xmax), rng.uniform(ymin, ymax)
        for corner in [(xmin, ymin), (xmax, ymin), (xmax, ymax), (xmin, ymax)]:
            theta = math.atan2(corner[1] - y, corner[0] - x)
            assert ahead(room, Pose(x, y, theta)) == pytest.approx(math.dist((x, y), corner), rel=1e-9)


# Against the naive twin.

SENSORS = [
    Lidar(beams=97, range_max=12.0),
    Lidar(beams=60, fov=math.radians(270), range_max=12.0),
    Lidar(beams=33, fov=0.2, range_max=12.0),
    Lidar(beams=1, range_max=12.0),
    Lidar(beams=2, fov=6.2, range_max=12.0),
]


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("pairs", [module._PAIRS, 50, 1])
def test_agrees_with_the_naive_twin(sensor, pairs, monkeypatch):
    """Random worlds and poses, headings many turns off, and beams looked at in parts of any size."""
    monkeypatch.setattr(module, "_PAIRS", pairs)
    rng = np.random.default_rng(3)
    for _ in range(40):
        circles = np.column_stack([rng.uniform(-8, 8, (6, 2)), rng.uniform(0.05, 4, 6)])
        world = world_of(circles[: rng.integers(0, 6)], rng.uniform(-8, 8, (rng.integers(0, 9), 4)))
        pose = Pose(*rng.uniform(-6, 6, 2), rng.uniform(-40, 40))
        expected = naive_ranges(world, pose, sensor)
        np.testing.assert_allclose(true_ranges(world, pose, sensor), expected, rtol=1e-9)


@pytest.mark.parametrize("world", [lab(), office()], ids=["lab", "office"])
def test_agrees_with_the_naive_twin_in_the_built_in_worlds(world):
    sensor = Lidar(beams=90, range_max=8.0)
    for i in range(3, world.path.count, world.path.count // 12):
        pose = world.path.pose(i)
        pose = Pose(pose.x, pose.y, pose.theta + 1e-3)  # off the corners and the edge-on walls
        np.testing.assert_allclose(
            true_ranges(world, pose, sensor), naive_ranges(world, pose, sensor), rtol=1e-9
        )


def test_a_hundred_thousand_beams():
    sensor = Lidar(beams=100_000, range_max=8.0)
    pose = office().path.pose(0)
    ranges = true_ranges(office(), pose, sensor)
    coarse = Lidar(beams=1000, range_max=8.0)
    np.testing.assert_allclose(ranges[::100], true_ranges(office(), pose, coarse), rtol=1e-9)


# Measuring.


def test_noise_is_gaussian():
    """Inside a circle of 3 m, at its centre: mean 3, standard deviation 0.05, 68.3 % within one of them."""
    world, sensor = world_of(circles=[(0, 0, 3)]), Lidar(beams=40_000, noise=0.05)
    ranges = measure(world, ORIGIN, sensor, np.random.default_rng(1))
    assert ranges.dtype == np.float32
    assert ranges.shape == (40_000,)
    assert float(ranges.mean(dtype=np.float64)) == pytest.approx(3.0, abs=0.001)
    assert float(ranges.std(dtype=np.float64)) == pytest.approx(0.05, rel=0.02)
    assert float(np.mean(np.abs(ranges - 3.0) < 0.05)) == pytest.approx(0.683, abs=0.01)


def test_no_noise_reads_the_truth():
    sensor = Lidar(beams=360, noise=0.0)
    exact = true_ranges(lab(), lab().path.pose(0), sensor)
    assert np.any(exact < 8.0)
    np.testing.assert_array_equal(
        measure(lab(), lab().path.pose(0), sensor, np.random.default_rng(0)), exact.astype(np.float32)
    )


def test_same_seed_same_ranges():
    first, again, other = (
        measure(lab(), lab().path.pose(0), Lidar.lab(), np.random.default_rng(seed)) for seed in (7, 7, 8)
    )
    np.testing.assert_array_equal(first, again)
    assert np.any(first != other)


def test_noise_of_a_beam_does_not_depend_on_the_others():
    half = world_of(circles=[(0, 0, 3)]), world_of(segments=[(1, -2, 1, 2)], circles=[(0, 0, 3)])
    sensor = Lidar(beams=360, noise=0.1)
    a, b = (measure(world, ORIGIN, sensor, np.random.default_rng(4)) for world in half)
    behind = np.abs(sensor.bearings) > 2.0
    np.testing.assert_array_equal(a[behind], b[behind])
    assert np.all(
        a[~behind & (np.abs(sensor.bearings) < 1.0)] != b[~behind & (np.abs(sensor.bearings) < 1.0)]
    )


def test_nothing_met_has_no_noise():
    ranges = measure(world_of(circles=[(50, 0, 1)]), ORIGIN, Lidar(noise=1.0), np.random.default_rng(0))
    assert np.all(ranges == np.float32(8.0))


def test_clipped_to_zero_and_range_max():
    sensor = Lidar(beams=10_000, noise=1.0)
    close = measure(world_of(circles=[(0, 0, 0.1)]), ORIGIN, sensor, np.random.default_rng(0))
    assert close.min() == 0.0
    assert float(np.mean(close == 0.0)) == pytest.approx(0.46, abs=0.02)
    far = measure(world_of(circles=[(0, 0, 7.9)]), ORIGIN, sensor, np.random.default_rng(0))
    assert far.max() == 8.0
    assert float(np.mean(far == 8.0)) == pytest.approx(0.46, abs=0.02)


@pytest.mark.parametrize("range_max", [0.1, 3.3, 8.0, 8.1, 9.7, 29.99, 81.83, 1000.0, 1e-20])
def test_no_return_is_not_below_range_max_as_float32(range_max):
    """float32(9.7) < 9.7: read back and compared with range_max, it would be a hit."""
    sensor = Lidar(beams=200, range_max=range_max, noise=0.0)
    (nothing,) = set(
        measure(world_of(circles=[(5000, 0, 1)]), ORIGIN, sensor, np.random.default_rng(0)).tolist()
    )
    assert nothing >= range_max
    assert float(np.nextafter(np.float32(nothing), np.float32(0.0))) < range_max, "the smallest such float32"
    # A hit that noise has carried to range_max reads the same.
    noisy = Lidar(beams=200, range_max=range_max, noise=range_max)
    wall = world_of(circles=[(0, 0, range_max * 0.999)])
    clipped = measure(wall, ORIGIN, noisy, np.random.default_rng(0)).astype(np.float64)
    assert 60 < np.sum(clipped == nothing) < 140
    assert not np.any(clipped > nothing)


def test_some_range_max_is_above_its_float32():
    assert float(np.float32(9.7)) < 9.7, "or the test above shows nothing"
