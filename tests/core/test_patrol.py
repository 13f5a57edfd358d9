"""Tours through free space, judged by a slow walk along them in small steps."""

import math
import time
from itertools import pairwise

import numpy as np
import pytest

from ogm_core.errors import BadWorld
from ogm_core.files.ros_map_reader import RosMap, read_ros_map
from ogm_core.lattice import Lattice
from ogm_core.simulation import patrol as module
from ogm_core.simulation.patrol import patrol
from ogm_core.simulation.ros_map_world import world_of_map
from ogm_core.simulation.trajectories import MAX_POSES


def drawn(*rows):
    """Free cells where a picture, north up, has a dot."""
    return np.array([[letter == "." for letter in row] for row in rows[::-1]])


def room(width, height, wall=1):
    """A free rectangle of cells with a wall around it."""
    return np.pad(np.ones((height, width), np.bool_), wall)


def gap(free, lattice, x, y):
    """Distance from a point to the nearest cell that is not free, m: every such cell is asked."""
    iy, ix = np.nonzero(~np.pad(free, 1))
    (x0, y0), size = lattice.corner_of(-1, -1), lattice.resolution
    dx = np.maximum(0.0, np.abs(x - (x0 + (ix + 0.5) * size)) - size / 2)
    dy = np.maximum(0.0, np.abs(y - (y0 + (iy + 0.5) * size)) - size / 2)
    return float(np.hypot(dx, dy).min())


def walk(path, step):
    """Points along a closed path, `step` m apart or less."""
    for (x0, y0), (x1, y1) in pairwise((*path.points, path.points[0])):
        for t in np.linspace(0.0, 1.0, 1 + math.ceil(math.dist((x0, y0), (x1, y1)) / step)):
            yield x0 + t * (x1 - x0), y0 + t * (y1 - y0)


def visited(path, lattice):
    """Cells that a walk in steps of a fifth of a cell meets, as (ix, iy)."""
    return {lattice.cell_of(x, y) for x, y in walk(path, lattice.resolution / 5)}


def test_a_room_is_seen_from_all_its_sides_at_a_distance_from_its_walls():
    lattice = Lattice(0.05, (-3.0, 7.0))
    free = room(200, 100)
    path = patrol(free, lattice)
    points = np.array(path.points)
    corner, far = lattice.corner_of(1, 1), lattice.corner_of(201, 101)
    assert (points >= np.add(corner, 0.3)).all()
    assert (points <= np.subtract(far, 0.3)).all()
    # 10 x 5 m: it gets within 1.5 m of every wall.
    assert (points.min(axis=0) < np.add(corner, 1.5)).all()
    assert (points.max(axis=0) > np.subtract(far, 1.5)).all()
    assert min(gap(free, lattice, x, y) for x, y in walk(path, 0.05)) >= 0.3 - 1e-9
    assert path.spacing == 0.1


def test_no_free_place_is_far_from_the_tour():
    rng = np.random.default_rng(4)
    free = room(400, 300)
    for iy, ix in zip(rng.integers(0, 280, 60), rng.integers(0, 380, 60), strict=True):
        free[iy : iy + 12, ix : ix + 18] = False
    lattice = Lattice(0.05)
    path = patrol(free, lattice)
    way = np.array(list(walk(path, 0.2)))
    assert min(gap(free, lattice, x, y) for x, y in way[::5]) >= 0.3 - 1e-9
    places = np.argwhere(free)[::97, ::-1] * 0.05
    distances = [np.hypot(*(way - place).T).min() for place in places]
    assert max(distances) < module.VIEW_EVERY + 1.0
    assert np.mean(distances) < 2.0


def test_a_tour_is_the_same_every_time():
    free = room(120, 80)
    free[30:50, 40:45] = False
    first, again = patrol(free, Lattice(0.05)), patrol(free.copy(), Lattice(0.05))
    assert first == again
    assert first.count == again.count


def test_only_the_largest_room_is_driven_through():
    free = room(60, 60)
    free = np.hstack((free, room(40, 60), room(60, 40).T[:62]))
    lattice = Lattice(0.1)
    cells = visited(patrol(free, lattice), lattice)
    assert all(1 <= ix <= 60 for ix, _ in cells)


def two_rooms():
    """A small free room in the west, a large one in the east, walls around both, cells of 0.1 m."""
    return np.hstack((room(20, 40), room(60, 40)))


def columns(path, lattice):
    """The first and the last column of cells that a tour meets."""
    found = [ix for ix, _ in visited(path, lattice)]
    return min(found), max(found)


def driven(free, lattice, start=None):
    """The tour through a map of these free cells, where the others are walls."""
    occupancy = np.where(free, 0, 100).astype(np.int8)
    return world_of_map(RosMap(occupancy, lattice.resolution, lattice.anchor), "map", start).path


def test_the_room_that_holds_the_origin_is_driven_through_be_it_the_smaller_one():
    free = two_rooms()
    in_the_wall = -2.15
    for x, (west, east) in {-1.0: (1, 20), -5.0: (23, 82), in_the_wall: (23, 82)}.items():
        lattice = Lattice(0.1, (x, -2.0))
        first, last = columns(driven(free, lattice), lattice)
        assert west <= first < last <= east


def test_where_the_origin_is_not_free_the_largest_room_inside_is_driven_through_and_not_what_lies_around_it():
    """A race track's outside is white, too, and reaches the border of the picture."""
    free = np.ones((100, 200), np.bool_)
    free[20:80, 20:102] = np.hstack((room(20, 58), room(58, 58)))
    lattice = Lattice(0.1, (50.0, 50.0))
    first, last = columns(driven(free, lattice), lattice)
    assert 43 <= first < last <= 100
    lattice = Lattice(0.1, (-1.0, -1.0))  # the origin is outside
    first, last = columns(driven(free, lattice), lattice)
    assert first < 20
    assert last > 102


def test_where_every_room_reaches_the_border_the_largest_is_driven_through():
    free = np.ones((60, 100), np.bool_)
    free[:, 30] = False
    lattice = Lattice(0.1, (50.0, 50.0))
    first, _ = columns(driven(free, lattice), lattice)
    assert first > 30


def test_a_niche_is_not_driven_through_because_the_building_reaches_the_border():
    free = np.ones((150, 300), np.bool_)
    free[40:60, 40:60] = room(18, 18)
    far = Lattice(0.1, (50.0, 50.0))
    assert columns(driven(free, far), far)[0] > 40, "3.2 m2 are a room beside 450 m2"
    free = np.pad(free, 100, constant_values=True)
    assert columns(driven(free, far), far)[0] < 100, "and a niche beside 1750 m2"


def test_a_speck_that_holds_the_origin_is_passed_over():
    free = two_rooms()
    free[5, 21] = True  # in the wall between the rooms, which is two cells thick
    free[5, 20] = False
    lattice = Lattice(0.1, (-2.15, -0.55))
    assert lattice.cell_of(0.0, 0.0) == (21, 5)
    first, _ = columns(driven(free, lattice), lattice)
    assert first >= 23


def test_a_tour_begins_beside_its_start_and_goes_everywhere_in_its_room():
    free, lattice = two_rooms(), Lattice(0.1, (-5.0, -2.0))
    for start in ((-3.6, 1.5), (-4.0, -1.0), (0.05, 0.05), (3.0, 1.5), (3.15, -1.85)):
        path = driven(free, lattice, start)
        assert math.dist(path.points[0], start) <= module.BESIDE_START
        assert min(gap(free, lattice, x, y) for x, y in walk(path, 0.1)) >= 0.3 - 1e-9
        first, last = columns(path, lattice)
        west, east = (1, 20) if start[0] < -2.8 else (23, 82)
        assert west <= first <= west + 5
        assert east - 5 <= last <= east
        assert path.pose(0)[:2] == path.points[0]


def test_behind_too_narrow_a_door_a_tour_stays_where_it_begins():
    free = room(80, 40)
    free[:, 20] = False
    free[20:24, 20] = True  # 0.4 m are too few for 0.3 m on either side
    lattice = Lattice(0.1)
    assert columns(driven(free, lattice, (1.0, 2.0)), lattice)[1] < 20
    assert columns(driven(free, lattice, (5.0, 2.0)), lattice)[0] > 20


def test_from_a_narrow_place_a_tour_keeps_less_clear():
    free = np.zeros((60, 140), np.bool_)
    free[5:55, 5:55] = True
    free[28:31, 55:130] = True  # a corridor 0.3 m wide, 7.5 m long
    lattice = Lattice(0.1)
    assert columns(driven(free, lattice), lattice)[1] < 55
    path = driven(free, lattice, (12.0, 2.95))
    assert math.dist(path.points[0], (12.0, 2.95)) <= module.BESIDE_START
    assert columns(path, lattice)[0] < 15
    assert visited(path, lattice) <= {(ix, iy) for iy, ix in np.argwhere(free).tolist()}


@pytest.mark.parametrize(
    ("start", "says"),
    [
        ((100.0, 0.0), r"start: \(100, 0\) m is not on the map, which is x -5 to 3.4, y -2 to 2.2"),
        ((0.0, -1e300), r"start: \(0, -1e\+300\) m is not on the map"),
        ((-2.85, 0.0), r"start: \(-2.85, 0\) m is not free in the map: give a place that is white"),
        ((3.4, 2.2), "is not on the map"),
    ],
)
def test_a_start_that_is_none_is_said_so(start, says):
    with pytest.raises(BadWorld, match=says):
        driven(two_rooms(), Lattice(0.1, (-5.0, -2.0)), start)


def test_a_start_in_a_speck_is_said_so():
    free = np.pad(two_rooms(), ((0, 4), (0, 0)))
    free[-2, 3] = True
    with pytest.raises(BadWorld, match=r"start: the free space there is too small to drive in: 0\.25 m"):
        driven(free, Lattice(0.1), (0.35, 4.45))


def test_rooms_that_touch_at_a_corner_are_not_joined():
    free = np.zeros((80, 80), np.bool_)
    free[:40, :40] = free[40:, 40:] = True
    free[40:42, 40:] = False
    free[39, 39] = free[40, 40] = True
    lattice = Lattice(0.1)
    cells = visited(patrol(free, lattice), lattice)
    assert all(ix < 40 and iy < 40 for ix, iy in cells)


def test_both_rooms_are_visited_through_a_door():
    free = room(81, 40)
    free[:, 40] = False
    free[18:28, 40] = True
    lattice = Lattice(0.1)
    path = patrol(free, lattice)
    cells = visited(path, lattice)
    assert {ix for ix, _ in cells} >= set(range(10, 70))
    assert min(gap(free, lattice, x, y) for x, y in walk(path, 0.05)) >= 0.3 - 1e-9


@pytest.mark.parametrize(("width", "least"), [(10, 0.2), (6, 0.1), (3, 0.0), (2, 0.0), (1, 0.0)])
def test_less_room_is_kept_where_there_is_less(width, least):
    """A corridor of 0.05 m cells, `width` of them across: too narrow for 0.3 m on either side."""
    free = room(100, width)
    lattice = Lattice(0.05)
    path = patrol(free, lattice)
    assert min(gap(free, lattice, x, y) for x, y in walk(path, 0.01)) >= least - 1e-9
    assert visited(path, lattice) <= {(ix, iy) for iy, ix in np.argwhere(free).tolist()}
    x = [x for x, _ in path.points]
    assert max(x) - min(x) > 4.0, "it drives along the corridor"


def test_a_crooked_passage_is_not_left():
    free = drawn(
        "###########",
        "#.........#",
        "#########.#",
        "#.........#",
        "#.#########",
        "#.........#",
        "#########.#",
        "#....#....#",
        "###########",
    )
    lattice = Lattice(0.5, (10.0, -5.0))
    path = patrol(free, lattice)
    cells = visited(path, lattice)
    assert cells <= {(ix, iy) for iy, ix in np.argwhere(free).tolist()}
    assert {(1, 7), (9, 1)} <= cells, "from one end to the other"


def test_a_tour_goes_on_to_what_is_near():
    """A corridor of 60 m has viewpoints all along it: there and back, not to and fro."""
    path = patrol(room(600, 10), Lattice(0.1))
    assert len(path.points) > 8
    length = sum(math.dist(a, b) for a, b in pairwise((*path.points, path.points[0])))
    assert 110.0 < length < 180.0


def test_of_rooms_behind_too_narrow_a_door_the_largest_is_visited():
    free = room(80, 40)
    free[:, 20] = False
    free[20:24, 20] = True  # 0.4 m are too few for 0.3 m on either side
    lattice = Lattice(0.1)
    cells = visited(patrol(free, lattice), lattice)
    assert all(20 < ix < 80 for ix, _ in cells)
    assert max(ix for ix, _ in cells) > 65


def test_the_edge_of_the_map_is_a_wall():
    lattice = Lattice(0.05)
    path = patrol(np.ones((100, 100), np.bool_), lattice)
    points = np.array(path.points)
    assert points.min() >= 0.3
    assert points.max() <= 4.7


@pytest.mark.parametrize("resolution", [0.001, 0.01, 0.3, 1.0, 50.0, 1e6])
def test_any_resolution(resolution):
    side = max(20, round(1.5 / resolution))
    lattice = Lattice(resolution)
    path = patrol(room(side, side), lattice)
    assert path.count <= MAX_POSES
    assert all(0.0 < value < (side + 2) * resolution for point in path.points for value in point)
    assert len({lattice.cell_of(*point) for point in path.points}) >= 2


@pytest.mark.parametrize(
    ("free", "says"),
    [
        (np.zeros((5, 5), np.bool_), "the map has no free cell"),
        (drawn("#.#", "###", "#.#"), "too small to drive in"),
        (room(4, 4), "too small to drive in: 0.25 m to and fro are needed"),
    ],
)
def test_no_room_is_said_so(free, says):
    with pytest.raises(BadWorld, match=says):
        patrol(free, Lattice(0.05 if free.shape != (3, 3) else 1.0))


def meets(a, b, cell):
    """Whether the line between centres of two cells meets a cell or its border; exact, in whole numbers."""
    (ay, ax), (by, bx), (cy, cx) = ((2 * int(iy), 2 * int(ix)) for iy, ix in (a, b, cell))
    if not (min(ay, by) <= cy + 1 and cy - 1 <= max(ay, by)):
        return False
    if not (min(ax, bx) <= cx + 1 and cx - 1 <= max(ax, bx)):
        return False
    sides = [(bx - ax) * (cy + dy - ay) - (by - ay) * (cx + dx - ax) for dy in (-1, 1) for dx in (-1, 1)]
    return min(sides) <= 0 <= max(sides)


def test_lines_are_clear_where_every_cell_that_they_meet_is():
    """Every cell is asked; a line through a corner meets the four cells around it."""
    rng = np.random.default_rng(2)
    mask = rng.random((30, 40)) < 0.95
    blocked = np.argwhere(~mask)
    start, end = (np.column_stack((rng.integers(0, 30, 600), rng.integers(0, 40, 600))) for _ in range(2))
    end[:300] = np.clip(start[:300] + rng.integers(-4, 5, (300, 2)), 0, (29, 39))
    start, end = (cells[(start != end).any(axis=1)] for cells in (start, end))
    expected = [not any(meets(a, b, cell) for cell in blocked) for a, b in zip(start, end, strict=True)]
    assert module._clear(mask, start, end).tolist() == expected
    assert 150 < sum(expected) < 450


def test_lines_are_looked_at_in_parts_of_any_size(monkeypatch):
    free = room(120, 80)
    free[30:50, 40:45] = False
    expected = patrol(free, Lattice(0.05))
    monkeypatch.setattr(module, "_CROSSINGS", 1)
    assert patrol(free, Lattice(0.05)) == expected


def test_the_viewpoints_and_poses_of_a_large_map_are_limited(monkeypatch):
    free = room(600, 400)
    monkeypatch.setattr(module, "MAX_VIEWPOINTS", 5)
    monkeypatch.setattr(module, "_MAX_STEPS", 100)
    path = patrol(free, Lattice(0.1))
    assert len(path.points) == 5
    length = sum(math.dist(a, b) for a, b in pairwise((*path.points, path.points[0])))
    assert length > 80.0
    assert path.spacing == pytest.approx(length / 100)


@pytest.mark.parametrize("name", ["depot", "depot_keepout", "depot_speed", "tb3_sandbox", "warehouse"])
def test_robots_never_leave_the_free_space_of_maps_of_the_field(ros_maps, name):
    ros_map = read_ros_map(ros_maps / f"{name}.yaml")
    lattice, free = ros_map.lattice, ros_map.free
    began = time.process_time()
    path = patrol(free, lattice)
    took = time.process_time() - began
    assert took < 10.0, "far from what a user waits for"
    for i in range(path.count):
        ix, iy = lattice.cell_of(*path.pose(i)[:2])
        assert free[iy, ix]
    for x, y in walk(path, lattice.resolution / 3):
        ix, iy = lattice.cell_of(x, y)
        assert free[iy, ix]
    gaps = [gap(free, lattice, *path.pose(i)[:2]) for i in range(0, path.count, max(1, path.count // 40))]
    assert min(gaps) >= 0.3 - lattice.resolution
    # The tour comes by everywhere: its box is nearly that of the free space.
    seen = np.argwhere(free)[:, ::-1] * lattice.resolution + ros_map.origin
    points = np.array(path.points)
    box = np.quantile(seen, [0.02, 0.98], axis=0)
    assert (points.min(axis=0) < box[0] + 1.5).all()
    assert (points.max(axis=0) > box[1] - 1.5).all()
