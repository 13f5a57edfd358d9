"""The traversal `dda` against exact rational arithmetic; how it is clipped, and which tiles it meets."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest

import naive
from ogm_core.cells.log_odds import CellConstants
from ogm_core.lattice import CellRect
from ogm_core.sensor_models import dda
from ogm_core.sensor_models.beams import HIT, NO_RETURN, SKIPPED

SIDE = 192
COUNTING = CellConstants(free=-1.0, occupied=1000.0, lower=-1e6, upper=1e6, prior=0.0)
"""A cell that was observed free n times holds -n."""
SLACK = Fraction(1, 10**6)


def beams_of(rays, kinds=None):
    """Beams (u0, v0, u1, v1), in cells, as the kernels take them."""
    u0, v0, u1, v1 = np.array(rays, float).T
    kinds = np.full(u0.size, NO_RETURN) if kinds is None else np.array(kinds)
    starts, ends = np.floor((u0, v0)), np.floor((u1, v1))
    cells = np.stack((*ends, kinds, *starts)).astype(np.int64)
    gaps = [
        np.where(b > a, start + 1 - a, a - start)
        for a, b, start in ((u0, u1, starts[0]), (v0, v1, starts[1]))
    ]
    return cells, np.stack((*gaps, u1 - u0, v1 - v0))


class Sheet:
    """Cells that count how often they were observed, with corner (ix, iy)."""

    def __init__(self, ix=-64, iy=-64, side=SIDE):
        self.window = CellRect(ix, iy, side, side)
        columns = np.arange(side)
        self.column = (columns // 64) * 64 * side + columns % 64
        self.cells = np.zeros(side * side)

    def visit(self, beams, window=None):
        """{(i, j): value} of the cells that the kernel updates; the sheet is blank afterwards.

        `touched` has the tiles that it marked.
        """
        side = self.window.width
        window, self.touched = window or self.window, np.zeros((side // 64, side // 64), np.int64)
        updates, fresh = dda.update_cells(*beams, window, self.touched, 5, self.cells, self.column, COUNTING)
        assert fresh == np.count_nonzero(self.touched)
        places = np.flatnonzero(self.cells != 0.0)
        strip, rest = np.divmod(places, 64 * self.window.height)
        i, j = self.window.ix + strip * 64 + rest % 64, self.window.iy + rest // 64
        found = dict(zip(zip(i.tolist(), j.tolist(), strict=True), self.cells[places].tolist(), strict=True))
        self.cells[places] = 0.0
        return updates, found


def assert_exact(sheet, ray):
    """A ray visits every cell that it crosses by more than 1e-6, none farther away, each once, in steps."""
    start, end = (math.floor(ray[0]), math.floor(ray[1])), (math.floor(ray[2]), math.floor(ray[3]))
    updates, found = sheet.visit(beams_of([ray]))
    assert set(found.values()) <= {-1.0}
    assert updates == len(found) == abs(end[0] - start[0]) + abs(end[1] - start[1])
    if start == end:
        return
    crossed = naive.crossed(*ray)
    for cell, length_squared in crossed.items():
        assert cell in found or cell == start or length_squared <= SLACK**2, (ray, cell)
    assert end in found
    assert start not in found
    for cell in found.keys() - crossed.keys() - {end}:
        assert naive.near(cell, *ray, SLACK), (ray, cell)
    path = sorted({start, *found}, key=lambda cell: abs(cell[0] - start[0]) + abs(cell[1] - start[1]))
    assert all(abs(a[0] - b[0]) + abs(a[1] - b[1]) == 1 for a, b in itertools.pairwise(path)), ray


def test_exact_arithmetic_knows_a_simple_ray():
    assert naive.crossed(0.5, 0.5, 2.5, 0.5) == {(0, 0): 0.25, (1, 0): 1, (2, 0): 0.25}
    assert naive.crossed(0, 0, 2, 2) == naive.crossed(2, 2, 0, 0) == {(0, 0): 2, (1, 1): 2}
    assert naive.crossed(0.5, -0.25, 1.25, 0.75) == {
        (0, -1): Fraction(25, 256), (0, 0): Fraction(625, 2304), (1, 0): Fraction(25, 144)
    }  # fmt: skip
    assert naive.near((1, 0), 0, 0, 2, 2, SLACK)
    assert not naive.near((2, 0), 0, 0, 2, 2, SLACK)
    assert naive.near((2, 0), 0, 0, 2, 2, 0.5)


def test_random_rays():
    rng = np.random.default_rng(1)
    sheet = Sheet()
    lengths = np.exp(rng.uniform(math.log(0.05), math.log(50), 20_000))
    bearings = rng.uniform(-math.pi, math.pi, lengths.size)
    starts = rng.uniform(0, 10, (lengths.size, 2))
    for (u, v), length, bearing in zip(starts.tolist(), lengths.tolist(), bearings.tolist(), strict=True):
        assert_exact(sheet, (u, v, u + length * math.cos(bearing), v + length * math.sin(bearing)))


def degenerate_rays(rng, count):
    """Rays from, to and through corners and grid lines, or a rounding error beside them."""
    places = (0.0, 0.25, 0.5, 1.0 - 2**-53, 2**-60, 1e-9, 3e-7, -1e-20)
    nudges = (0.0, 0.0, 2**-52, -(2**-50), 1e-12, -1e-9, 4e-7, -3e-6)
    steps = (0.0, 1.0, 2.0, 3.0, 7.0, 0.5, 30.0, 12.25)
    for _ in range(count):
        u, v = (rng.choice((0, 0, 1, 2, 5)) + rng.choice(places) for _ in range(2))
        du, dv = (rng.choice((-1, 1)) * rng.choice(steps) for _ in range(2))
        match rng.integers(4):
            case 0:  # a diagonal
                dv = math.copysign(du, dv)
            case 1:  # to a corner
                du, dv = round(u + du) - u, round(v + dv) - v
            case 2:  # almost along a grid line
                dv = rng.choice((0.0, 1e-16, 1e-12, 1e-8, 1e-4)) * rng.choice((-1, 1))
                if rng.integers(2):
                    du, dv = dv, du
        yield tuple(map(float, (u, v, u + du + rng.choice(nudges), v + dv + rng.choice(nudges))))


def test_degenerate_rays():
    rng = np.random.default_rng(2)
    sheet = Sheet()
    for ray in degenerate_rays(rng, 5000):
        assert_exact(sheet, ray)


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("rise", [1e-9, 1e-3, 0.7, 1.5, 2.3, 70.0, 7000.0, 999_000.0])
def test_the_longest_beams_change_rows_in_the_right_column(rise, turn):
    """A beam of a million cells, against the places where it enters its rows, each computed by itself."""
    ray = np.array([0.37, 0.811, 1_000_003.0, rise])
    fu, fv, du, dv = ray if turn % 2 == 0 else ray[[1, 0, 3, 2]]
    if turn > 1:
        fu, fv, du, dv = 1 - fu, 1 - fv, -du, -dv
    di, dj = math.floor(fu + du), math.floor(fv + dv)
    gap_u, gap_v = (1 - fu if du > 0 else fu), (1 - fv if dv > 0 else fv)
    stairs = dda.staircase(di, dj, gap_u, gap_v, du, dv)
    assert (stairs.along_i, stairs.si, stairs.sj) == (turn % 2 == 0, *((1, 1) if turn < 2 else (-1, -1)))
    columns, rows = (abs(di), abs(dj)) if stairs.along_i else (abs(dj), abs(di))
    assert (stairs.columns, stairs.rows) == (columns, rows)
    gap, rest = Fraction(1 - 0.37), Fraction(1 - 0.811)
    for row in np.unique(np.linspace(1, rows, 400).astype(int)).tolist() if rows else []:
        # The beam enters the row this far behind the first edge of its columns: after so many of their edges.
        ahead = (rest + row - 1) * Fraction(1_000_003) / Fraction(rise) - gap
        fewest, most = math.ceil(ahead - SLACK), math.ceil(ahead + SLACK)
        assert dda.row_at(stairs, max(fewest, 0) + row - 1) < row
        assert dda.row_at(stairs, min(most, columns) + row) >= row
    assert dda.row_at(stairs, 0) == 0
    assert dda.row_at(stairs, columns + rows) == rows
    for column in (0, 1, columns // 3, columns - 1):
        t = dda.last_in_column(stairs, column)
        assert t - dda.row_at(stairs, t) <= column < t + 1 - dda.row_at(stairs, t + 1)


def random_rays(rng, count, low, high):
    return rng.uniform(low, high, (count, 4)).tolist()


def test_a_window_gets_exactly_its_share():
    rng = np.random.default_rng(4)
    everywhere, sheet = Sheet(-64, -64, 192), Sheet(0, 0, 64)
    met = 0
    for ray in itertools.chain(
        random_rays(rng, 2500, -60, 120), [(10.0, 10.0, -5.0, 10.0), (0, 0, 100, 100)]
    ):
        width, height = rng.integers(1, 65, 2).tolist()
        kind = rng.choice((HIT, NO_RETURN))
        _, whole = everywhere.visit(beams_of([ray], [kind]))
        inside = {(i, j): value for (i, j), value in whole.items() if 0 <= i < width and 0 <= j < height}
        updates, found = sheet.visit(beams_of([ray], [kind]), CellRect(0, 0, width, height))
        assert found == inside, (ray, width, height)
        assert updates == len(inside)
        met += bool(inside)
    assert met > 500


def test_the_end_cell_of_a_hit_is_occupied_and_skipped_beams_are_nothing():
    ray = (0.5, 0.5, 3.5, 1.4)
    _, found = Sheet().visit(beams_of([ray], [HIT]))
    assert found == {(1, 0): -1.0, (2, 0): -1.0, (2, 1): -1.0, (3, 1): 1000.0}
    assert Sheet().visit(beams_of([ray], [SKIPPED])) == (0, {})
    assert Sheet().visit(beams_of([(0.1, 0.2, 0.9, 0.8)], [HIT])) == (0, {})


def box(cells):
    i, j = [c[0] for c in cells], [c[1] for c in cells]
    return (min(i), min(j), max(i) - min(i) + 1, max(j) - min(j) + 1) if cells else (0, 0, 0, 0)


def test_extent_is_the_box_around_what_is_updated():
    rng = np.random.default_rng(5)
    sheet = Sheet()
    for ray in itertools.chain(random_rays(rng, 1500, 0, 6), degenerate_rays(rng, 1500)):
        assert dda.extent(*beams_of([ray])) == box(list(sheet.visit(beams_of([ray]))[1])), ray
    for _ in range(100):
        rays, kinds = random_rays(rng, 5, -20, 20), rng.integers(0, 3, 5)
        rays = [(*rays[0][:2], *ray[2:]) for ray in rays]
        found = sheet.visit(beams_of(rays, kinds))[1]
        assert dda.extent(*beams_of(rays, kinds)) == box(list(found))


@pytest.mark.parametrize("low", [-150.0, 0.0])
def test_touched_tiles_are_those_of_the_updated_cells(low):
    rng = np.random.default_rng(6)
    sheet = Sheet(0, 0, 448)
    rays = itertools.chain(random_rays(rng, 1500, low, 440), degenerate_rays(rng, 500))
    for n, ray in enumerate(rays):
        if n % 3 == 0:  # along the edges of tiles
            ray = [64.0 * round(x / 64) + rng.choice((-0.5, 0.0, 0.5, 1.5)) for x in ray]
        beams = beams_of([ray], [HIT if n % 2 else NO_RETURN])
        _, found = sheet.visit(beams)
        tiles = {(i // 64, j // 64) for i, j in found}
        touched = np.zeros((7, 7), np.int64)
        assert dda.touch_tiles(*beams, sheet.window, touched, 5) == len(tiles), ray
        assert set(zip(*map(np.ndarray.tolist, np.nonzero(touched)), strict=True)) == tiles, ray
        assert np.array_equal(sheet.touched, touched)
        assert dda.touch_tiles(*beams, sheet.window, touched, 6) == 0
