"""Scans that take their time: a pose for every beam, and what that does to a map."""

import math

import numpy as np
import pytest

import naive
from ogm_core.cells.classes import FREE, trinary
from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import NoPose, OutsideBounds
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.placing.pose_history import PoseHistory
from ogm_core.quality.figures import Consistency
from ogm_core.quality.held_out import predicted_walls
from ogm_core.sensor_models.beams import HIT
from ogm_core.sensor_models.projection import project
from ogm_core.simulation.lidar import Lidar, measure, true_ranges
from ogm_core.simulation.trajectories import CirclePath
from ogm_core.simulation.worlds import load_world
from ogm_core.types import IDENTITY, PlacedScan, Pose, Scan, Sweep

MS = 1_000_000
T0 = 1_700_000_000_000_000_000
TURN = 2 * math.pi


def scan_of(ranges, **changes):
    values = {"stamp": T0, "angle_min": -math.pi, "angle_increment": 0.1, "range_min": 0.0, "range_max": 8.0}
    return Scan(**{**values, "ranges": np.asarray(ranges, np.float32), **changes})


def history(*poses, period=20 * MS):
    found = PoseHistory()
    for n, pose in enumerate(poses):
        found.append(T0 + n * period, Pose(*pose))
    return found


def random_history(rng, count=100):
    """Poses of all headings, at uneven times from T0 on."""
    found = PoseHistory()
    for stamp in np.cumsum(rng.integers(1, 90 * MS, count)).tolist():
        found.append(T0 + stamp, Pose(*rng.uniform(-5, 5, 2), rng.uniform(-20, 20)))
    return found


@pytest.mark.parametrize("time_increment", [1e-4, 3.3e-3, -1e-4, 0.02, 1e-9])
@pytest.mark.parametrize("mount", [IDENTITY, Pose(0.2, -0.1, 1.0)])
def test_every_beam_has_the_pose_of_its_time(time_increment, mount):
    rng = np.random.default_rng(1)
    for _ in range(10):
        poses = random_history(rng)
        scan = scan_of(
            rng.uniform(1, 7, 60), stamp=T0 + 1500 * MS, time_increment=time_increment, mount=mount
        )
        sweep = poses.along(scan)
        for k in range(60):
            base = poses.at(scan.stamp + round(k * time_increment * 1e9))
            assert sweep.beams[k] == pytest.approx(list(base.compose(mount)), rel=1e-15, abs=1e-15)
        halfway = scan.stamp + (scan.end_stamp - scan.stamp) // 2
        assert sweep.middle == poses.at(halfway).compose(mount)


def test_a_beam_at_the_time_of_a_pose_has_it_bit_for_bit():
    poses = history((0.1, 0.2, 0.3), (0.7, -1.1, 3.0), (1 / 3, 2 / 3, -3.0), (9.9, 9.8, 9.7))
    sweep = poses.along(scan_of([1.0] * 7, time_increment=0.01))
    assert [tuple(sweep.beams[k]) for k in (0, 2, 4, 6)] == [
        (0.1, 0.2, 0.3),
        (0.7, -1.1, 3.0),
        (1 / 3, 2 / 3, -3.0),
        (9.9, 9.8, 9.7),
    ]


def test_headings_take_the_shorter_arc():
    sweep = history((0, 0, 3.0), (0, 0, -3.0)).along(scan_of([1.0] * 3, time_increment=0.01))
    assert sweep.beams[:, 2] == pytest.approx([3.0, math.pi, -3.0])


def told(poses, scan):
    """Whether the poses of a scan's beams can be told."""
    try:
        poses.along(scan)
    except NoPose:
        return False
    return True


@pytest.mark.parametrize(
    "scan",
    [
        scan_of([1.0] * 3, stamp=T0 - 1, time_increment=0.001),
        scan_of([1.0] * 3, stamp=T0 + 59 * MS, time_increment=0.001),
        scan_of([1.0] * 3, stamp=T0 + 1 * MS, time_increment=-0.001),
        scan_of([1.0] * 3, time_increment=1e3),
        scan_of([1.0] * 3, time_increment=1e290),
    ],
)
def test_nothing_is_extrapolated(scan):
    assert not told(history((0, 0, 0), (0, 0, 0), (0, 0, 0), (0, 0, 0)), scan)


def test_a_gap_anywhere_under_the_sweep_leaves_no_pose():
    poses = history((0, 0, 0), (1, 0, 0), (2, 0, 0))
    poses.append(T0 + 600 * MS, Pose(3, 0, 0))
    poses.append(T0 + 620 * MS, Pose(4, 0, 0))
    assert told(poses, scan_of([1.0] * 5, time_increment=0.01))
    assert not told(poses, scan_of([1.0] * 6, time_increment=0.01))
    assert told(poses, scan_of([1.0] * 2, stamp=T0 + 600 * MS, time_increment=0.02))
    assert not told(poses, scan_of([1.0] * 2, stamp=T0 + 20 * MS, time_increment=0.1))
    assert not told(PoseHistory(), scan_of([1.0], time_increment=0.1))


def random_sweep(rng, beams):
    """Poses of a sensor that moves and turns while it sweeps."""
    start, end = rng.uniform((-5, -5, -9), (6, 6, 9)), rng.uniform(-0.6, 0.6, 3)
    poses = start + np.linspace(0, 1, beams)[:, None] * end
    return Pose(*poses[0]), Sweep(Pose(*poses[beams // 2]), poses)


@pytest.mark.parametrize("cells", ["int16", "float64"])
@pytest.mark.parametrize("traversal", ["bresenham", "dda"])
@pytest.mark.parametrize(
    "area",
    [{}, {"bounds": Region(-3, -2, 4, 5)}, {"bounds": Region(-3, -2, 4, 5), "outside": "drop"}],
    ids=["unbounded", "clip", "drop"],
)
def test_maps_equal_the_twin_beam_by_beam(area, traversal, cells):
    rng = np.random.default_rng(3)
    model = LogOdds(cells, p_prior=0.4, l_min=-2, l_max=3.5)
    settings = GridSettings(0.1, model, traversal=traversal, alpha=0.2, reach=7.0, clear_range=5.0, **area)
    grid, twin = OccupancyGrid(settings), naive.Map(settings)
    for n in range(16):
        ranges = rng.uniform(0.0, 9.0, 60)
        ranges[rng.integers(0, 60, 6)] = [math.nan, math.inf, -math.inf, 8.0, 7.95, 0.0]
        scan = scan_of(ranges, angle_increment=rng.choice([0.1, -0.1]), range_min=0.2)
        pose, sweep = random_sweep(rng, 60)
        if n % 4 == 3:  # a scan that was taken at once
            sweep = None
        expected = twin.integrate(scan, pose if sweep is None else sweep.beams)
        try:
            assert grid.integrate(scan, pose, sweep) == expected
        except OutsideBounds:
            assert expected == 0
    snapshot = grid.snapshot()
    found = np.where(grid.model.known(snapshot.cells), grid.model.log_odds(snapshot.cells), math.nan)
    assert np.array_equal(
        found, twin.log_odds(snapshot.offset, snapshot.width, snapshot.height), equal_nan=True
    )
    assert len(twin.cells) > 1000


def test_a_sweep_that_stands_still_is_the_scan_at_its_pose():
    rng = np.random.default_rng(4)
    scan, pose = scan_of(rng.uniform(1, 9, 63)), Pose(0.31, -0.27, 0.5)
    still = Sweep(pose, np.tile(np.array(pose), (63, 1)))
    for traversal in ("bresenham", "dda"):
        maps = [OccupancyGrid(GridSettings(traversal=traversal)) for _ in range(2)]
        maps[0].integrate(scan, pose)
        maps[1].integrate(scan, pose, still)
        assert np.array_equal(maps[0].snapshot().cells, maps[1].snapshot().cells)


ROOM = load_world({"boxes": [[-4.0, -2.5, 4.0, 2.5]], "path": {"circle": [0, 0, 1], "poses": 8}})
SWEEPS, PERIOD, TURNING, BEAMS = 30, 0.1, 2.0, 360
LIDAR = Lidar(beams=BEAMS, fov=TURN, range_max=12.0, noise=0.01)


def turning(seconds):
    """A robot that turns at 2 rad/s on the spot."""
    return Pose(0.4, -0.3, 0.1 + TURNING * seconds)


def swept_scans():
    """A 10 Hz LiDAR on it: every beam measured from the pose of its own time."""
    rng = np.random.default_rng(5)
    for n in range(SWEEPS):
        ranges = np.empty(BEAMS)
        for k in range(BEAMS):
            beam = Lidar(beams=1, fov=0.1, range_max=12.0, noise=0.0)  # straight ahead
            pose = turning((n + k / BEAMS) * PERIOD)
            bearing = LIDAR.angle_min + k * LIDAR.angle_increment
            ranges[k] = true_ranges(ROOM, Pose(pose.x, pose.y, pose.theta + bearing), beam)[0]
        yield scan_of(
            ranges + rng.normal(0, LIDAR.noise, BEAMS),
            stamp=T0 + round(n * PERIOD * 1e9),
            angle_min=LIDAR.angle_min,
            angle_increment=LIDAR.angle_increment,
            range_max=LIDAR.range_max,
            time_increment=PERIOD / BEAMS,
        )


def wall_thickness(grid):
    """Mean distance across the upper wall from the first to the last known cell that is not free, m."""
    part = grid.snapshot().crop(Region(-3.0, 1.2, 3.0, 3.8))
    wall = part.model.known(part.cells) & (part.model.encode(part.cells, trinary) != FREE)
    rows = np.arange(part.height)[:, None]
    top = np.where(wall, rows, -1).max(axis=0)
    bottom = np.where(wall, rows, part.height).min(axis=0)
    assert (top >= 0).all()
    return float((top - bottom + 1).mean()) * part.resolution


def end_spread(grid, placed):
    """Root mean square distance of the hits' end points from the wall that they saw, m."""
    fine = GridSettings(0.001)
    cells = np.concatenate([project(each, fine.lattice, fine).ends for each in placed], axis=1)
    x, y = (cells[:2, cells[2] == HIT] + 0.5) * 0.001
    return float(np.sqrt(np.mean(np.minimum(abs(abs(x) - 4.0), abs(abs(y) - 2.5)) ** 2)))


def test_correcting_the_motion_makes_walls_thin_again():
    poses = PoseHistory()
    for n in range(round(SWEEPS * PERIOD * 50) + 2):
        poses.append(T0 + n * 20 * MS, turning(n * 0.02))
    settings = GridSettings(0.02, alpha=0.05)
    smeared, corrected, instantaneous = (OccupancyGrid(settings) for _ in range(3))
    rng = np.random.default_rng(6)
    placed = {"smeared": [], "corrected": []}
    for n, scan in enumerate(swept_scans()):
        pose, sweep = poses.at(scan.stamp), poses.along(scan)
        smeared.integrate(scan, pose)
        corrected.integrate(scan, pose, sweep)
        placed["smeared"].append(PlacedScan(scan, pose))
        placed["corrected"].append(PlacedScan(scan, pose, sweep))
        at_once = measure(ROOM, turning(n * PERIOD), LIDAR, rng)
        instantaneous.integrate(
            scan_of(
                at_once, angle_min=LIDAR.angle_min, angle_increment=LIDAR.angle_increment, range_max=12.0
            ),
            turning(n * PERIOD),
        )
    without, with_it, ideal = map(wall_thickness, (smeared, corrected, instantaneous))
    assert with_it <= 0.5 * without
    assert abs(with_it - ideal) <= 0.2 * ideal
    assert end_spread(smeared, placed["smeared"]) > 0.1
    assert end_spread(corrected, placed["corrected"]) < 0.012  # the noise
    # The judges see every beam from where it was, too.
    for name, grid in (("smeared", smeared), ("corrected", corrected)):
        consistency = Consistency(grid.snapshot(), settings)
        for each in placed[name]:
            consistency.add(each)
        assert (consistency.figures()["hits"] > 0.7) == (name == "corrected")
    good = predicted_walls(corrected.snapshot(), settings, placed["corrected"])
    bad = predicted_walls(corrected.snapshot(), settings, placed["smeared"])
    assert good["within_0_1_m"] > 0.8 > 0.5 > bad["within_0_1_m"]


def test_the_room_is_a_room():
    assert true_ranges(ROOM, Pose(0.4, -0.3, 0.0), Lidar(beams=4, noise=0.0)) == pytest.approx(
        [4.4, 2.2, 3.6, 2.8]
    )
    assert isinstance(ROOM.path, CirclePath)
