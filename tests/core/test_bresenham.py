"""The traversal kernels against the integer error form, and against its closed form where lines are long."""

import itertools

import numpy as np
import pytest

import naive
from ogm_core.cells.log_odds import LogOdds
from ogm_core.lattice import CellRect
from ogm_core.sensor_models import bresenham
from ogm_core.sensor_models.beams import HIT, NO_RETURN, SKIPPED

LONGEST = 1_482_910
"""The largest M below 2^20.5."""


def closed_form(major, minor, k):
    return (2 * k * minor + major - 1) // (2 * major)


def beams_of(start, cells, kinds=None):
    """Beams from one cell to others, as the kernels take them."""
    kinds = [HIT] * len(cells) if kinds is None else kinds
    rows = [(*end, kind, *start) for end, kind in zip(cells, kinds, strict=True)]
    return np.array(rows, np.int64).T.copy()


def random_cells(rng, low, high, count):
    return [tuple(map(int, cell)) for cell in rng.integers(low, high, (count, 2))]


def touch(beams, window, touched, revision):
    """How many tiles are fresh, to the kernel that updates the cells and to the one that only counts."""
    counted, columns = touched.copy(), np.arange(64 * touched.shape[0])
    column = (columns // 64) * touched.shape[1] * 4096 + columns % 64
    cells = np.zeros(touched.size * 4096, np.int16)
    _, fresh = bresenham.update_cells(beams, window, touched, revision, cells, column, LogOdds().constants)
    assert bresenham.touch_tiles(beams, window, counted, revision) == fresh
    assert np.array_equal(counted, touched)
    return fresh


def path(start, end):
    """Cells that a beam updates."""
    return naive.bresenham(*start, *end)[1:]


def inside(cell, width, height):
    return 0 <= cell[0] < width and 0 <= cell[1] < height


def box(cells):
    """Smallest rectangle that holds the cells."""
    if not cells:
        return 0, 0, 0, 0
    i, j = [c[0] for c in cells], [c[1] for c in cells]
    return min(i), min(j), max(i) - min(i) + 1, max(j) - min(j) + 1


@pytest.mark.parametrize("end", [(7, 3), (-7, 3), (3, -7), (-3, -7), (5, 5), (-6, 0), (0, 4), (1, -1)])
def test_the_twin_walks_unit_steps_near_the_line_and_ends_right(end):
    cells = naive.bresenham(0, 0, *end)
    assert (cells[0], cells[-1]) == ((0, 0), end)
    assert len(cells) == max(map(abs, end)) + 1
    for (i0, j0), (i1, j1) in itertools.pairwise(cells):
        assert max(abs(i1 - i0), abs(j1 - j0)) == 1
    assert all(abs(i * end[1] - j * end[0]) <= max(map(abs, end)) / 2 for i, j in cells)


def test_fixed_point_is_the_integer_error_form():
    for major in range(1, 131):
        k = np.arange(major + 1)
        for minor in range(major + 1):
            bias, step = bresenham.fixed_point(major, minor)
            aside = (bias + k * step) >> bresenham.FRACTION_BITS
            expected = [j for _, j in naive.bresenham(0, 0, major, minor)]
            assert aside.tolist() == expected, (major, minor)


@pytest.mark.parametrize("major", [LONGEST, LONGEST - 1, 2**20, 1_400_000, 1_399_999, 999_983, 65_537])
def test_fixed_point_is_exact_for_the_longest_beams(major):
    rng = np.random.default_rng(major)
    # The ceiling in the step errs most where minor * 2^42 leaves a remainder of 1.
    worst = pow(2**bresenham.FRACTION_BITS, -1, major) if major % 2 else 1
    minors = {
        0,
        1,
        worst,
        major // 2,
        major // 2 + 1,
        major - 1,
        major,
        *rng.integers(major, size=5).tolist(),
    }
    k = np.arange(major + 1)
    for minor in minors:
        bias, step = bresenham.fixed_point(major, minor)
        aside = (bias + k * step) >> bresenham.FRACTION_BITS
        assert np.array_equal(aside, closed_form(major, minor, k)), minor


def test_bias_and_step_are_the_exact_quotients():
    one = 1 << bresenham.FRACTION_BITS
    for major in range(1, LONGEST, 1482):
        barely_more = pow(one, -1, major)  # than a whole number: a remainder of 1
        for minor in (0, 1, barely_more, major // 3, major // 2, major - 1, major):
            bias, step = bresenham.fixed_point(major, minor)
            assert (bias, step) == ((major - 1) * one // 2 // major, -(-minor * one // major)), (major, minor)


def test_fixed_point_is_the_integer_error_form_on_random_longer_lines():
    rng = np.random.default_rng(2)
    for major in rng.integers(131, 30_000, 40).tolist():
        minor = int(rng.integers(major + 1))
        bias, step = bresenham.fixed_point(major, minor)
        aside = (bias + np.arange(major + 1) * step) >> bresenham.FRACTION_BITS
        assert aside.tolist() == [j for _, j in naive.bresenham(0, 0, major, minor)], (major, minor)


def assert_clip_is_exact(start, end, width, height):
    major = max(abs(end[0] - start[0]), abs(end[1] - start[1]))
    minor = min(abs(end[0] - start[0]), abs(end[1] - start[1]))
    first, last = bresenham.clip(*start, *end, *bresenham.fixed_point(major, minor), width, height)
    steps = [k for k, cell in enumerate(path(start, end), 1) if inside(cell, width, height)]
    assert list(range(first, last + 1)) == steps, (start, end, width, height)


def test_clip_is_exact_on_every_short_line_around_a_small_rectangle():
    width, height = 3, 2
    cells = list(itertools.product(range(-4, 8), range(-4, 7)))
    for start, end in itertools.permutations(cells, 2):
        assert_clip_is_exact(start, end, width, height)


def test_clip_is_exact_on_random_lines():
    rng = np.random.default_rng(3)
    for _ in range(3000):
        start, end = random_cells(rng, -60, 90, 2)
        if start != end:
            assert_clip_is_exact(start, end, *rng.integers(1, 40, 2).tolist())


def test_clip_is_exact_on_the_longest_lines():
    rng = np.random.default_rng(4)
    width, height = 300, 200
    met = 0
    for _ in range(300):
        start = rng.integers(-700_000, 700_000, 2)
        aim = rng.uniform((0, 0), (width, height))
        direction = aim - start
        end = start + np.round(direction * rng.uniform(0.5, 690_000 / np.abs(direction).max())).astype(int)
        (di, dj), sign = np.abs(end - start), np.sign(end - start)
        major, minor = int(max(di, dj)), int(min(di, dj))
        k = np.arange(1, major + 1)
        aside = closed_form(major, minor, k)
        i = start[0] + sign[0] * (k if di >= dj else aside)
        j = start[1] + sign[1] * (aside if di >= dj else k)
        steps = k[(i >= 0) & (i < width) & (j >= 0) & (j < height)]
        bias, step = bresenham.fixed_point(major, minor)
        first, last = bresenham.clip(*start.tolist(), *end.tolist(), bias, step, width, height)
        assert np.array_equal(np.arange(first, last + 1), steps), (start, end)
        met += steps.size > 0
    assert met > 100


def test_extent_of_one_beam():
    cells = list(itertools.product(range(-4, 5), repeat=2))
    for end in cells:
        start = (2, -1)
        assert bresenham.extent(beams_of(start, [end])) == box(path(start, end)), end


def test_extent_of_many_beams_leaves_out_what_is_skipped_and_what_ends_where_it_starts():
    rng = np.random.default_rng(5)
    for _ in range(300):
        start, *cells = random_cells(rng, -300, 300, 6)
        kinds = rng.integers(0, 3, 5).tolist()
        cells[0] = start
        used = [end for end, kind in zip(cells, kinds, strict=True) if kind != SKIPPED]
        expected = box([cell for end in used for cell in path(start, end)])
        assert bresenham.extent(beams_of(start, cells, kinds)) == expected


@pytest.mark.parametrize(("low", "high"), [(0, 640), (-500, 1100)])
def test_touched_tiles_are_those_of_the_cells(low, high):
    rng = np.random.default_rng(6)
    width, height = 640, 448
    for _ in range(150):
        start, *cells = random_cells(rng, low, high, 4)
        if low == 0:
            start, *cells = [(i, j % height) for i, j in (start, *cells)]
        kinds = rng.choice([SKIPPED, NO_RETURN, HIT], 3, p=[0.1, 0.4, 0.5]).tolist()
        used = [end for end, kind in zip(cells, kinds, strict=True) if kind != SKIPPED]
        tiles = {
            (i // 64, j // 64) for end in used for i, j in path(start, end) if inside((i, j), width, height)
        }
        touched = np.zeros((10, 7), np.int64)
        window = CellRect(0, 0, width, height)
        fresh = touch(beams_of(start, cells, kinds), window, touched, 9)
        assert set(zip(*map(np.ndarray.tolist, np.nonzero(touched)), strict=True)) == tiles
        assert fresh == len(tiles)


def test_touched_tiles_of_fans_are_those_of_the_cells():
    rng = np.random.default_rng(8)
    for size in (20, 90, 300):
        for _ in range(6):
            start = rng.integers(300, 700, 2).tolist()
            bearings = np.sort(rng.uniform(0, 2 * np.pi, 400))
            lengths = size + rng.choice([0, 1, 250], 400, p=[0.5, 0.4, 0.1])
            ends = start + np.rint(lengths[:, None] * np.stack((np.cos(bearings), np.sin(bearings)), 1))
            ends = [tuple(map(int, end)) for end in ends]
            tiles = {(i // 64, j // 64) for end in ends for i, j in path(start, end)}
            tiles = {(i, j) for i, j in tiles if 0 <= i < 14 and 0 <= j < 12}
            touched = np.zeros((14, 12), np.int64)
            fresh = touch(beams_of(start, ends), CellRect(0, 0, 896, 768), touched, 3)
            assert set(zip(*map(np.ndarray.tolist, np.nonzero(touched)), strict=True)) == tiles
            assert fresh == len(tiles)


def test_tiles_of_beams_side_by_side_are_not_missed():
    # Beams along a tile's edge, beside each other, in and out of a window that ends within tiles.
    rng = np.random.default_rng(9)
    width, height = 150, 100
    for n in range(4000):
        start = rng.integers(-30, 180, 2) if n % 2 else 64 * rng.integers(0, 3, 2) + rng.integers(-2, 3, 2)
        end = start + rng.integers(-160, 161, 2)
        if n % 4 > 1:  # to the edge of a tile
            end = 64 * np.round(end / 64).astype(int) + rng.integers(-1, 2, 2)
        start, *ends = (tuple(cell.tolist()) for cell in (start, end, end + rng.integers(-3, 4, 2)))
        tiles = {(i // 64, j // 64) for e in ends for i, j in path(start, e) if inside((i, j), width, height)}
        touched = np.zeros((3, 2), np.int64)
        touch(beams_of(start, ends), CellRect(0, 0, width, height), touched, 1)
        assert set(zip(*map(np.ndarray.tolist, np.nonzero(touched)), strict=True)) == tiles, (start, ends)


@pytest.mark.parametrize("end", list(itertools.product((40, 45, 50, 56), repeat=2)))
def test_a_beam_that_ends_where_it_starts_hides_no_tile_from_the_next_one(end):
    touched = np.zeros((1, 1), np.int64)
    beams = beams_of((50, 50), [(50, 50), end])
    assert touch(beams, CellRect(0, 0, 64, 64), touched, 1) == (end != (50, 50))


def test_a_tile_is_fresh_once():
    touched = np.zeros((3, 1), np.int64)
    window = CellRect(0, 0, 192, 64)
    beam = beams_of((10, 5), [(100, 5)])
    assert touch(beam, window, touched, 1) == 2
    assert touch(beam, window, touched, 2) == 0
    assert touched.ravel().tolist() == [2, 2, 0]
    assert touch(beams_of((100, 5), [(190, 5)]), window, touched, 3) == 1
    assert touched.ravel().tolist() == [2, 3, 3]
