"""Rays through a map: closed forms, the compiled kernel, and the slow obvious twin."""

import math

import numpy as np
import pytest

import naive
from ogm_client import MapGrid, Ray
from ogm_client.raycast import WORDS
from ogm_core.errors import BadParameter, MapEmpty
from ogm_core.lattice import CellRect, Lattice
from ogm_core.queries.ray_kernel import cast_rays
from ogm_core.queries.rays import FOUND_NOTHING, directions_of, start_of, window_of

EMPTY, WALL, UNDECIDED, UNKNOWN = -2.0, 2.0, 0.0, math.nan
QUARTER = math.pi / 2


def grid_of(log_odds, **where):
    fields = {"resolution": 0.5, "anchor": (10.0, -20.0), "offset": (-2, 4)} | where
    return MapGrid(np.asarray(log_odds), **fields, epoch="e", revision=3, stamp=None)


def random_grid(rng, **where):
    """40 rows of 60 cells, nearly all free, up to the edges, so that many rays leave."""
    states = rng.choice([EMPTY, WALL, UNDECIDED, UNKNOWN], (40, 60), p=[0.95, 0.03, 0.01, 0.01])
    return grid_of(states.astype(rng.choice([np.float32, np.float64])), **where)


ROOM = grid_of(
    [
        [EMPTY, EMPTY, EMPTY, EMPTY, EMPTY],
        [EMPTY, EMPTY, EMPTY, WALL, EMPTY],
        [EMPTY, UNKNOWN, EMPTY, UNDECIDED, EMPTY],
        [WALL, EMPTY, EMPTY, EMPTY, EMPTY],
    ]
)
"""2.5 x 2 m from (9, -18)."""


def centre(column, row):
    return 9.25 + column * 0.5, -17.75 + row * 0.5


@pytest.mark.parametrize(
    ("cell", "theta", "length", "found"),
    [
        ((0, 1), 0.0, 1.25, "occupied"),
        ((0, 2), 0.0, 0.25, "unknown"),
        ((2, 2), 0.0, 0.25, "unknown"),  # undecided
        ((0, 0), 0.0, 2.25, "unknown"),  # out of the grid
        ((4, 1), math.pi, 0.25, "occupied"),
        ((0, 1), QUARTER, 0.75, "occupied"),
        ((0, 1), -QUARTER, 0.75, "unknown"),
        ((2, 1), 5 * QUARTER, 1.25, "unknown"),
        ((2, 0), math.atan2(3, 5), 0.25 * math.sqrt(34) / 3, "occupied"),
        ((3, 1), 0.0, 0.75, "unknown"),  # the wall that it starts in does not stop it
        ((1, 2), -QUARTER, 1.25, "unknown"),  # nor does the unknown
    ],
)
def test_a_ray_ends_where_it_enters_what_is_not_free(cell, theta, length, found):
    ray = ROOM.raycast(*centre(*cell), theta)
    assert ray == Ray(pytest.approx(length, rel=1e-12), found)
    assert type(ray.range) is float


def test_a_ray_ends_at_its_longest():
    x, y = centre(0, 1)
    assert ROOM.raycast(x, y, 0.0, max_range=1.2) == Ray(1.2, "nothing")
    assert ROOM.raycast(x, y, 0.0, max_range=1.25) == Ray(1.25, "occupied")
    assert ROOM.raycast(x, y, 0.0, max_range=np.float32(0.125)) == Ray(0.125, "nothing")
    assert ROOM.raycast(x, y, -QUARTER, max_range=0.7) == Ray(0.7, "nothing")


def test_a_point_on_a_line_lies_in_the_cell_east_and_north_of_it():
    assert ROOM.raycast(10.0, -17.5, 0.0) == Ray(0.5, "occupied")
    west = ROOM.raycast(10.0, -17.0, math.pi)  # on the edge of the unknown cell
    assert west == Ray(0.0, "unknown")
    assert math.copysign(1.0, west.range) == 1.0
    assert ROOM.raycast(9.0, -18.0, math.pi) == Ray(0.0, "unknown")
    assert ROOM.raycast(9.0, -18.0, 1e-310).found == "unknown"
    assert ROOM.raycast(9.0, -18.0, 1e-310).range == 2.5


def test_many_rays_are_as_each_alone():
    x, y = centre(2, 1)
    thetas = np.linspace(-4.0, 4.0, 24).reshape(4, 6)
    rays = ROOM.raycast(x, y, thetas, max_range=1.1)
    assert rays.range.shape == rays.found.shape == thetas.shape
    assert rays.range.dtype == np.float64
    each = [Ray(*pair) for pair in zip(rays.range.flat, rays.found.flat, strict=True)]
    assert each == [ROOM.raycast(x, y, theta, max_range=1.1) for theta in thetas.flat]
    assert set(rays.found.flat) == {"occupied", "unknown", "nothing"}
    assert ROOM.raycast(x, y, [0.0]).range.tolist() == [0.25]
    assert ROOM.raycast(x, y, []).range.shape == ROOM.raycast(x, y, []).found.shape == (0,)


@pytest.mark.parametrize("unknown", ["stop", "pass"])
@pytest.mark.parametrize("grain", [1.0, 1 / 32], ids=["from corners of cells", "from anywhere"])
@pytest.mark.parametrize("max_range", [math.inf, 3.0])
@pytest.mark.parametrize(
    "where", [{}, {"resolution": 0.3, "anchor": (0.1, -0.7), "offset": (-17, 1_000_000)}]
)
def test_rays_are_those_of_the_kernel_to_the_last_bit(grain, max_range, unknown, where):
    rng = np.random.default_rng(7)
    found = []
    for _ in range(20):
        grid = random_grid(rng, **where)
        lattice, rect = Lattice(grid.resolution, grid.anchor), CellRect(*grid.offset, 60, 40)
        u, v = rng.integers(0, (60 / grain, 40 / grain)) * grain * grid.resolution
        x, y = grid.origin[0] + u, grid.origin[1] + v
        # Where a tie may be: along the axes, the diagonals, and 3-4-5 triangles.
        some = [math.atan2(a, b) for a, b in rng.integers(-5, 6, (20, 2))]
        thetas = [*some, *rng.uniform(-9, 9, 30)]
        rays = grid.raycast(x, y, thetas, max_range, unknown=unknown)
        _, start = start_of(lattice, rect, (x, y))
        directions, longest = directions_of(thetas), max_range / grid.resolution
        part = window_of(start, directions, longest, rect)
        rows, columns = (
            slice(n - m, n - m + k) for n, m, k in ((part[1], rect[1], part[3]), (part[0], rect[0], part[2]))
        )
        states = grid.occupancy[rows, columns]
        what, distances = cast_rays(start, directions, longest, unknown == "pass", part[:2], states)
        ranges = np.where(what == FOUND_NOTHING, max_range, distances * grid.resolution)
        assert [WORDS[code] for code in what] == rays.found.tolist()
        assert ranges.tolist() == rays.range.tolist()
        assert np.signbit(ranges).sum() == np.signbit(rays.range).sum() == 0
        found += rays.found.tolist()
    words = {"occupied", "unknown", "nothing"}
    words -= {"nothing"} if (max_range, unknown) == (math.inf, "stop") else set()
    words -= {"unknown"} if unknown == "pass" else set()
    assert {word for word in set(found) if found.count(word) > 100} == words


@pytest.mark.parametrize(
    "where", [{}, {"resolution": 0.3, "anchor": (0.1, -0.7), "offset": (-17, 1_000_000)}]
)
def test_rays_are_those_of_every_crossing_with_a_grid_line(where):
    rng = np.random.default_rng(8)
    grid = random_grid(rng, **where)
    ix, iy = grid.offset

    def belief(cell):
        column, row = cell[0] - ix, cell[1] - iy
        if not (0 <= column < grid.width and 0 <= row < grid.height):
            return "unknown"
        return {100: "wall", 0: "free", -1: "unknown"}[int(grid.occupancy[row, column])]

    for _ in range(300):
        x = grid.origin[0] + rng.uniform(0, 60) * grid.resolution
        y = grid.origin[1] + rng.uniform(0, 40) * grid.resolution
        theta, longest = rng.uniform(-9, 9), rng.uniform(1, 40)
        u, v = (x - grid.anchor[0]) / grid.resolution, (y - grid.anchor[1]) / grid.resolution
        for unknown, seen in (
            ("stop", belief),
            ("pass", lambda cell: {"wall": "wall"}.get(belief(cell), "free")),
        ):
            what, distance = naive.cast(u, v, theta, longest, seen)
            ray = grid.raycast(x, y, theta, longest * grid.resolution, unknown=unknown)
            assert ray.found == {"wall": "occupied"}.get(what, what)
            assert ray.range == pytest.approx(distance * grid.resolution, rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((math.nan, -17.0, 0.0), "no cell"),
        ((10.0, math.inf, 0.0), "no cell"),
        ((10.0, -17.0, math.nan), "theta"),
        ((10.0, -17.0, [0.0, math.inf]), "theta"),
        ((10.0, -17.0, 0.0, 0.0), "max_range: .* got 0"),
        ((10.0, -17.0, 0.0, math.nan), "max_range: .* got nan"),
        (
            (11.5, -17.0, 0.0),
            r"point \(11.5, -17\) lies outside the map, x 9 to 11.5, y -18 to -16 m",
        ),
        ((8.99, -17.0, 0.0), "outside"),
        ((10.0, -18.01, 0.0), "outside"),
        ((10.0, -16.0, [0.0, 1.0]), "outside"),
    ],
)
def test_what_cannot_be_cast_is_named(arguments, message):
    with pytest.raises(BadParameter, match=message):
        ROOM.raycast(*arguments)


def test_what_is_unknown_lets_through_who_asks_for_it():
    x, y = centre(0, 2)
    assert ROOM.raycast(x, y, 0.0) == Ray(0.25, "unknown")
    assert ROOM.raycast(x, y, 0.0, unknown="pass") == Ray(math.inf, "nothing")  # it leaves the grid, too
    assert ROOM.raycast(x, y, 0.0, 7.0, unknown="pass") == Ray(7.0, "nothing")
    assert ROOM.raycast(*centre(3, 3), -QUARTER, unknown="pass") == Ray(0.75, "occupied")
    with pytest.raises(BadParameter, match="unknown: 'stop' or 'pass' is needed, got 'go'"):
        ROOM.raycast(x, y, 0.0, unknown="go")


def test_an_empty_map_casts_no_ray():
    with pytest.raises(MapEmpty, match="no known cell"):
        grid_of(np.empty((0, 0)), offset=(0, 0)).raycast(0.0, 0.0, 0.0)
