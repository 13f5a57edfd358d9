"""Maps as worlds: outlines of what is occupied, and what a simulated robot makes of them."""

import math
from itertools import pairwise

import numpy as np
import pytest

from ogm_core.cells.classes import trinary
from ogm_core.errors import BadMapFile, BadWorld
from ogm_core.files.ros_map_reader import RosMap, read_ros_map
from ogm_core.files.ros_map_writer import write_pgm, write_yaml
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Lattice
from ogm_core.simulation import ros_map_world as map_world
from ogm_core.simulation.catalogue import world_named
from ogm_core.simulation.lidar import Lidar, measure, true_ranges
from ogm_core.simulation.ros_map_world import outlines, world_of_map
from ogm_core.simulation.worlds import dump_world, load_world
from ogm_core.types import Pose, Scan

LATTICE = Lattice(0.1, (-1.3, 2.7))
OCCUPIED, FREE, UNKNOWN = 0, 254, 205


def write_map(folder, greys, resolution=0.05, origin=(0.0, 0.0), yaw=0.0):
    """map.yaml and map.pgm of greys, row 0 south; returns the path."""
    (folder / "map.pgm").write_bytes(write_pgm(np.asarray(greys, np.uint8)[::-1]))
    path = folder / "map.yaml"
    path.write_text(write_yaml("map.pgm", resolution, origin).replace(", 0.0]", f", {yaw!r}]"))
    return path


def hall():
    """Greys of a hall of 6 x 4 m: walls 0.1 m thick, a pillar, all of it inside the unknown."""
    greys = np.full((100, 140), UNKNOWN)
    greys[8:92, 8:132] = OCCUPIED
    greys[10:90, 10:130] = FREE
    greys[40:48, 60:72] = OCCUPIED
    return greys


def naive_borders(occupied, lattice):
    """Every side of an occupied cell whose neighbour is not occupied, one by one: sets of two corners."""
    padded = np.pad(occupied, 1)
    borders = set()
    for iy, ix in np.argwhere(occupied).tolist():
        for dx, dy, first, second in (
            (-1, 0, (0, 0), (0, 1)),
            (1, 0, (1, 0), (1, 1)),
            (0, -1, (0, 0), (1, 0)),
            (0, 1, (0, 1), (1, 1)),
        ):
            if not padded[iy + 1 + dy, ix + 1 + dx]:
                corners = (lattice.corner_of(ix + cx, iy + cy) for cx, cy in (first, second))
                borders.add(frozenset(corners))
    return borders


def split(segments, lattice):
    """The same segments cut into pieces of one cell, as sets of two corners of the lattice."""
    for x1, y1, x2, y2 in segments.tolist():
        (i1, j1), (i2, j2) = (
            [
                round((value - anchor) / lattice.resolution)
                for value, anchor in zip(end, lattice.anchor, strict=True)
            ]
            for end in ((x1, y1), (x2, y2))
        )
        assert (i1 == i2) != (j1 == j2), "along one axis"
        n = max(i2 - i1, j2 - j1)
        assert n > 0
        corners = [lattice.corner_of(i1 + (i2 - i1) * k // n, j1 + (j2 - j1) * k // n) for k in range(n + 1)]
        assert (corners[0], corners[-1]) == ((x1, y1), (x2, y2)), "corners bit for bit"
        yield from map(frozenset, pairwise(corners))


@pytest.mark.parametrize("share", [0.02, 0.3, 0.5, 0.8, 1.0])
def test_outlines_are_the_borders_of_occupied_cells_and_nothing_else(share):
    occupied = np.random.default_rng(6).random((23, 31)) < share
    segments = outlines(occupied, LATTICE)
    pieces = list(split(segments, LATTICE))
    assert len(pieces) == len(set(pieces)), "none twice"
    assert set(pieces) == naive_borders(occupied, LATTICE)


def test_borders_in_a_row_are_one_segment():
    occupied = np.zeros((10, 12), np.bool_)
    occupied[2:7, 3:9] = True
    segments = outlines(occupied, LATTICE)
    x1, y1 = LATTICE.corner_of(3, 2)
    x2, y2 = LATTICE.corner_of(9, 7)
    assert {tuple(row) for row in segments.tolist()} == {
        (x1, y1, x2, y1),
        (x1, y2, x2, y2),
        (x1, y1, x1, y2),
        (x2, y1, x2, y2),
    }
    occupied[6, 8] = False  # a corner less: two sides more
    assert len(outlines(occupied, LATTICE)) == 6
    with pytest.raises(ValueError, match="read-only"):
        segments[0, 0] = 1.0


def test_no_two_segments_could_be_one():
    segments = outlines(np.random.default_rng(1).random((40, 40)) < 0.6, LATTICE)
    horizontal = segments[:, 1] == segments[:, 3]
    ends = [tuple(row) for row in segments[horizontal][:, 2:].tolist()]
    starts = [tuple(row) for row in segments[horizontal][:, :2].tolist()]
    assert not set(ends) & set(starts)
    ends = [tuple(row) for row in segments[~horizontal][:, 2:].tolist()]
    starts = [tuple(row) for row in segments[~horizontal][:, :2].tolist()]
    assert not set(ends) & set(starts)


def test_a_map_file_is_a_world(tmp_path):
    path = write_map(tmp_path, hall(), origin=(-3.5, -2.5))
    world = world_named(str(path))
    assert world.name == "map"
    assert world.circles.shape == (0, 3)
    # Outside and inside of the walls, and the pillar.
    assert len(world.segments) == 12
    assert world.bounds == pytest.approx((-3.1, -2.1, 3.1, 2.1))
    sensor = Lidar(beams=4, range_max=20.0)  # west, south, east, north
    found = true_ranges(world, Pose(1.0, 1.0, 0.0), sensor)
    assert found == pytest.approx([4.0, 3.0, 2.0, 1.0])
    pillar = true_ranges(world, Pose(-1.0, -0.3, 0.0), sensor)
    assert pillar == pytest.approx([2.0, 1.7, 0.5, 2.3])


@pytest.mark.parametrize("yaw", [0.3, math.pi / 2, -2.0, 3.14])
def test_a_map_that_is_turned_is_a_world_that_is_turned(tmp_path, yaw):
    """About its lower-left corner, counter-clockwise: what is seen there is what is seen before."""
    straight = world_named(str(write_map(tmp_path, hall(), origin=(-3.5, -2.5))))
    turned = world_named(str(write_map(tmp_path, hall(), origin=(-3.5, -2.5), yaw=yaw)))
    sensor = Lidar(beams=64, range_max=20.0)

    def there(pose):
        dx, dy = pose.x + 3.5, pose.y + 2.5
        x = -3.5 + dx * math.cos(yaw) - dy * math.sin(yaw)
        return Pose(x, -2.5 + dx * math.sin(yaw) + dy * math.cos(yaw), pose.theta + yaw)

    for pose in (Pose(1.0, 1.0, 0.0), Pose(-1.0, -0.3, 0.0), Pose(-2.0, 1.2, 1.0)):
        assert true_ranges(turned, there(pose), sensor) == pytest.approx(true_ranges(straight, pose, sensor))
    assert turned.path.count == straight.path.count
    for i in range(0, turned.path.count, 7):
        assert turned.path.pose(i)[:2] == pytest.approx(there(straight.path.pose(i))[:2])
    assert not turned.segments.flags.writeable
    path = str(write_map(tmp_path, hall(), origin=(-3.5, -2.5), yaw=yaw))
    begun = world_named(path, there(Pose(-2.0, 1.2, 0.0))[:2])
    path = str(write_map(tmp_path, hall(), origin=(-3.5, -2.5)))
    begun_straight = world_named(path, (-2.0, 1.2))
    assert begun.path.pose(0)[:2] == pytest.approx(there(begun_straight.path.pose(0))[:2])


def test_a_turned_map_of_the_field_is_a_world(datasets):
    path = datasets / "maps" / "stata_basement.yaml"
    ros_map, world = read_ros_map(path), world_named(str(path))
    assert ros_map.yaw == 3.14
    iy, ix = np.argwhere(ros_map.occupied)[1234].tolist()
    u, v = ix * ros_map.resolution, iy * ros_map.resolution
    corner = (
        25.9 + u * math.cos(3.14) - v * math.sin(3.14),
        48.5 + u * math.sin(3.14) + v * math.cos(3.14),
    )
    starts, ends = world.segments[:, :2], world.segments[:, 2:]
    along, to = ends - starts, np.array(corner) - starts
    share = np.clip((along * to).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
    assert np.hypot(*(to - along * share[:, None]).T).min() < 1.5 * ros_map.resolution


def test_where_the_picture_was_found_is_told(tmp_path):
    path = write_map(tmp_path, hall())
    path.write_text(path.read_text().replace('"map.pgm"', "/home/someone/map.pgm"))
    told = []
    world_named(str(path), tell=told.append)
    assert told == [
        f"{path}: image: there is no file '/home/someone/map.pgm', so {tmp_path / 'map.pgm'} is taken"
    ]


def test_its_robot_stays_in_the_hall(tmp_path):
    path = write_map(tmp_path, hall(), origin=(-3.5, -2.5))
    free = read_ros_map(path).free
    world = world_named(str(path))
    for i in range(world.path.count):
        x, y, _ = world.path.pose(i)
        assert abs(x) <= 2.7
        assert abs(y) <= 1.7
        ix, iy = Lattice(0.05, (-3.5, -2.5)).cell_of(x, y)
        assert free[iy, ix]


def test_its_robot_begins_where_it_is_told_to(tmp_path):
    path = str(write_map(tmp_path, hall(), origin=(-3.5, -2.5)))
    for start in ((2.5, 1.5), (-2.5, -1.5)):
        x, y, _ = world_named(path, start=start).path.pose(0)
        assert np.hypot(x - start[0], y - start[1]) < 0.75
    with pytest.raises(BadWorld, match=r"world '.*map.yaml': start: \(9, 0\) m is not on the map"):
        world_named(path, start=(9.0, 0.0))


def test_start_and_origin_of_a_turned_map_are_the_worlds():
    """Two rooms of 4 x 4 m, one north of the other; turned by a quarter the northern one lies in the west."""
    free = np.pad(np.ones((40, 40), np.bool_), 1)
    occupancy = np.where(np.vstack((free, free)), 0, 100).astype(np.int8)
    rooms = {5.0: (-3.4, 0.8), 2.0: (-2.2, 2.0)}  # by the x from which the map reaches west: that with (0, 0)
    for corner, (west, east) in rooms.items():
        turned = RosMap(occupancy, 0.1, (corner, -2.0), np.pi / 2)
        path = world_of_map(turned, "map").path
        assert all(west < path.pose(i).x < east for i in range(path.count))
        for start in ((corner - 2.0, 0.0), (corner - 6.0, 1.0)):
            pose = world_of_map(turned, "map", start).path.pose(0)
            assert np.hypot(pose.x - start[0], pose.y - start[1]) < 0.75
        with pytest.raises(BadWorld, match=r"is not on the map, which is x .* to .*, y -2 to 2\.2"):
            world_of_map(turned, "map", (corner + 1.0, 0.0))


def test_worlds_with_a_path_of_their_own_take_no_start(tmp_path):
    path = tmp_path / "hall.yaml"
    path.write_text(dump_world(world_named("lab")).replace("name: lab", "name: hall"))
    for name, called in (("office", "office"), (str(path), "hall")):
        said = rf"start: it is for ROS maps; the world {called} has a path of its own"
        with pytest.raises(BadWorld, match=said):
            world_named(name, start=(0.0, 0.0))


def test_the_world_of_a_map_survives_as_a_world_file(tmp_path):
    world = world_named(str(write_map(tmp_path, hall())))
    again = load_world(dump_world(world))
    assert np.array_equal(again.segments, world.segments)
    assert again.path == world.path


@pytest.mark.parametrize(
    ("greys", "origin", "says"),
    [
        (
            np.full((30, 30), FREE),
            (0.0, 0.0),
            "the map has no occupied cell: there is nothing for a LiDAR to see",
        ),
        (
            np.full((30, 30), OCCUPIED),
            (0.0, 0.0),
            "there is no free space to drive in: the map has no free cell",
        ),
        (np.eye(30) * UNKNOWN, (0.0, 0.0), "the map has no free cell"),
        (hall(), (1e6, 0.0), r"the map reaches farther than 1e\+06 m from"),
    ],
)
def test_maps_that_are_no_worlds_are_refused(tmp_path, greys, origin, says):
    path = write_map(tmp_path, greys, origin=origin)
    with pytest.raises(BadWorld, match=rf"^world '.*map\.yaml': .*{says}"):
        world_named(str(path))


def test_a_map_that_is_too_large_to_simulate_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(map_world, "MAX_CELLS", 13999)
    with pytest.raises(BadWorld, match="140 x 100 cells are more than the 13999 that can be simulated"):
        world_named(str(write_map(tmp_path, hall())))


def test_a_map_of_coarse_cells_has_too_many_blocks_sooner(tmp_path, monkeypatch):
    monkeypatch.setattr(map_world, "MAX_BLOCKS", 13999)
    assert world_named(str(write_map(tmp_path, hall()))).segments.size
    write_map(tmp_path, hall(), resolution=5.0)
    with pytest.raises(BadWorld, match="140 x 100 cells are more than the 13999 that"):
        world_named(str(tmp_path / "map.yaml"))


def test_a_map_file_that_is_wrong_is_named(tmp_path):
    path = write_map(tmp_path, hall())
    (tmp_path / "map.pgm").unlink()
    with pytest.raises(BadMapFile, match=r"map\.yaml: image: there is no file 'map\.pgm'"):
        world_named(str(path))


def built(world, lattice, sensor, poses):
    """Classes [iy, ix] of a map built of noiseless scans on the same lattice, and its lower-left cell."""
    grid = OccupancyGrid(GridSettings(resolution=lattice.resolution, anchor=lattice.anchor))
    rng = np.random.default_rng(0)
    for i in np.linspace(0, world.path.count, poses, endpoint=False).astype(int):
        pose = world.path.pose(int(i))
        ranges = measure(world, pose, sensor, rng)
        scan = Scan(0, sensor.angle_min, sensor.angle_increment, 0.0, sensor.range_max, ranges)
        grid.integrate(scan, pose)
    snapshot = grid.snapshot()
    return snapshot.model.encode(snapshot.cells, trinary), snapshot.offset


def near(mask, cells):
    """Which cells lie at most so many rows and columns from one in the mask."""
    found = np.zeros_like(mask)
    padded = np.pad(mask, cells)
    for iy in range(2 * cells + 1):
        for ix in range(2 * cells + 1):
            found |= padded[iy : iy + mask.shape[0], ix : ix + mask.shape[1]]
    return found


def check_agreement(ros_map, world, poses, *, seen):
    """A map built in the world of a map agrees with that map, wall for wall, to two cells."""
    sensor = Lidar(beams=720, range_max=12.0, noise=0.01)
    classes, (ix, iy) = built(world, ros_map.lattice, sensor, poses)
    walls, free = ros_map.occupied, ros_map.free
    height, width = walls.shape
    whole = np.full((height + 600, width + 600), -1, np.int8)  # robots may look out of the map
    whole[iy + 300 : iy + 300 + classes.shape[0], ix + 300 : ix + 300 + classes.shape[1]] = classes
    whole = whole[300 : 300 + height, 300 : 300 + width]
    occupied = whole == 100
    assert occupied.sum() > 100
    assert np.mean(near(walls, 1)[occupied]) > 0.999
    assert near(walls, 2)[occupied].all()
    assert np.mean(~walls[whole == 0]) > 0.999
    facing = walls & near(free, 1)
    assert np.mean(near(occupied, 2)[facing]) > seen
    assert np.mean(whole[free] == 0) > seen


def test_a_map_built_in_the_world_of_a_map_agrees_with_it(tmp_path):
    path = write_map(tmp_path, hall(), origin=(-3.53, 2.71))
    check_agreement(read_ros_map(path), world_named(str(path)), 60, seen=0.98)


@pytest.mark.parametrize(("name", "seen"), [("tb3_sandbox", 0.97), ("depot", 0.92)])
def test_maps_built_in_worlds_of_the_field_agree_with_them(ros_maps, name, seen):
    path = ros_maps / f"{name}.yaml"
    check_agreement(read_ros_map(path), world_named(str(path)), 300, seen=seen)
