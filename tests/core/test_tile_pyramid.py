"""The tile pyramid against shrunk snapshots, of maps that grow, are erased and begin with cells."""

import itertools
import math

import numpy as np
import pytest

import naive
from counts_model import Counts
from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.rate import Rate
from ogm_core.cells.value_bytes import value_byte
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Lattice, Region
from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.polygon import Polygon
from ogm_core.tiles.pyramid import PIXELS, Square, TilePyramid, revision_of, revisions_of
from ogm_core.tiles.view import TileView
from ogm_core.types import Pose, Scan

MODELS = [LogOdds(), LogOdds("float64"), LogOdds(p_prior=0.1, p_free=0.05), Counts()]
model_of_every_kind = pytest.mark.parametrize(
    "model", MODELS, ids=["int16", "float64", "low prior", "counts"]
)
LEVELS = range(7)


def grid_of(model, bounds=None, half_life=None):
    return OccupancyGrid(GridSettings(0.1, model, bounds=bounds, half_life=half_life), "e", "r")


def scan(rng, k):
    ranges = rng.uniform(0.3, 9.0, 40).astype(np.float32)
    return Scan(k * 10**9, 0.0, math.tau / 40, 0.0, 8.0, ranges)


def drive(grid, rng, k, reach):
    at = rng.uniform(-reach, reach, 2).tolist()
    grid.integrate(scan(rng, k), Pose(*at, float(rng.uniform(0, 6))))


def squares_of(rect, level):
    """All that meet a rectangle of cells."""
    side = PIXELS << level
    for i in range(rect.ix // side, (rect.ix + rect.width - 1) // side + 1):
        for j in range(rect.iy // side, (rect.iy + rect.height - 1) // side + 1):
            yield Square(16 - level, i, -1 - j)


def by_shrinking(snap, square):
    """A square's pixels as the picture of a snapshot has them: the cells under it, cut out and shrunk."""
    rect = square.rect
    view = TileView(snap.stored.tiles, rect, snap.model.planes)
    cut = MapSnapshot(view, snap.model, snap.lattice, (rect.ix, rect.iy), "e", 1, 1)
    return cut.shrink(PIXELS).encode(value_byte)


def pixels(pyramid, snap, square):
    return pyramid.pixels(snap.stored, snap.model, square)


def check(pyramid, snap, levels=LEVELS):
    """Every square that meets the map, at every level."""
    for level in levels:
        for square in squares_of(snap.rect, level):
            found = pixels(pyramid, snap, square)
            assert (found.shape, found.dtype) == ((PIXELS, PIXELS), np.uint8)
            if level <= 2:
                assert np.array_equal(found, by_shrinking(snap, square)), square
            else:  # four squares are one: as shrinking composes, whatever lies that high need not be laid out
                z, x, y = square
                four = [
                    [pixels(pyramid, snap, Square(z + 1, 2 * x + dx, 2 * y + dy)) for dx in (0, 1)]
                    for dy in (1, 0)
                ]
                assert np.array_equal(found, quick_halved(np.block(four))), square


def quick_halved(cells):
    height, width = cells.shape
    blocks = cells.reshape(height // 2, 2, width // 2, 2)
    highest = blocks.max(axis=(1, 3))
    lowest = np.where(blocks == 0, 256, blocks.astype(int)).min(axis=(1, 3)) % 256
    return np.where(highest >= 167, highest, lowest)


def test_the_quick_twin_is_the_naive_one():
    cells = np.random.default_rng(2).choice(np.array([0, 0, 5, 60, 166, 167, 201], np.uint8), (64, 64))
    assert np.array_equal(quick_halved(cells), naive.halved(cells))


@pytest.mark.parametrize("bounds", [None, Region(-7.0, -9.0, 42.9, 36.3)], ids=["unbounded", "bounded"])
@model_of_every_kind
def test_every_square_is_the_map_shrunk(model, bounds):
    rng = np.random.default_rng(1)
    for _ in range(2):
        grid = grid_of(model, bounds)
        for k in range(6):
            drive(grid, rng, k, 5.0 + 8 * k if bounds is None else 30.0)
        check(TilePyramid(), grid.snapshot())


@model_of_every_kind
def test_squares_of_a_map_that_grows_in_all_directions(model):
    """One pyramid all the time: what has changed is made anew, and what has not is still right."""
    rng = np.random.default_rng(4)
    grid, pyramid, old = grid_of(model), TilePyramid(), []
    for k in range(11):
        drive(grid, rng, k, 1.0 + 5 * k)
        if k == 6:
            grid.erase(Polygon.of_region(Region(-20.0, -20.0, 20.0, 5.0), grid.lattice))
        if k % 3 == 1:
            snap = grid.snapshot()
            check(pyramid, snap, levels=(1, 4, 6))
            old.append((snap, {level: list(squares_of(snap.rect, level)) for level in (1, 6)}))
    for snap, squares in old:  # readers of older maps
        for square in itertools.chain(*squares.values()):
            assert np.array_equal(pixels(pyramid, snap, square), pixels(TilePyramid(), snap, square))
    check(pyramid, snap, levels=(2,))


def test_an_overview_is_made_anew_when_a_cell_beyond_its_tile_has_changed():
    """By a model whose probability looks one cell around: the edge of tiles lies between cells 63 and 64."""
    grid, pyramid, square = grid_of(Counts()), TilePyramid(), Square(15, 0, -1)
    seen = []
    for x, theta, length in ((6.25, 0.0, 0.2), (6.85, math.pi, 0.4)):  # to cell 64, from either side
        one = Scan(0, 0.0, 1.0, 0.0, 8.0, np.array([length], np.float32))
        grid.integrate(one, Pose(x, 3.25, theta))
        snap = grid.snapshot()
        seen.append(pixels(pyramid, snap, square))
        assert np.array_equal(seen[-1], by_shrinking(snap, square))
    assert seen[0][16, 31] not in (0, seen[1][16, 31])


def test_a_reader_of_a_map_from_before_it_was_laid_out_anew():
    rng, grid, pyramid = np.random.default_rng(5), grid_of(LogOdds()), TilePyramid()
    drive(grid, rng, 0, 1.0)
    old = grid.snapshot()
    grid.integrate(scan(rng, 1), Pose(-700.0, 3.0, 0.0))  # beyond the room around the first scan
    new = grid.snapshot()
    assert old.stored.tiles.rect != new.stored.tiles.rect
    far, near = Square(13, -4, -1), Square(13, 0, -1)
    for snap in (old, new, old, new):
        for square in (far, near):
            found = pixels(pyramid, snap, square)
            assert np.array_equal(found, pixels(TilePyramid(), snap, square))
            assert found.any() == (square is near or snap is new)


def test_another_map_with_the_same_revision_is_another_map():
    rng, pyramid = np.random.default_rng(6), TilePyramid()
    for cells in ("int16", "float64"):
        for _ in range(3):
            grid = grid_of(LogOdds(cells))
            drive(grid, rng, 0, 9.0)
            check(pyramid, grid.snapshot(), levels=(1, 3))
    grid.reset("f")
    drive(grid, rng, 0, 9.0)
    check(pyramid, grid.snapshot(), levels=(1, 3))


def test_only_what_has_changed_is_made_anew(monkeypatch):
    made = []
    inner = TileView.side_by_side
    monkeypatch.setattr(
        TileView, "side_by_side", lambda view, numbers: (made.append(len(numbers)), inner(view, numbers))[1]
    )
    grid, pyramid = grid_of(LogOdds()), TilePyramid()
    ring = Scan(0, 0.0, math.tau / 200, 0.0, 8.0, np.full(200, 3.0, np.float32))

    def look(*poses):
        for x, y in poses:
            grid.integrate(ring, Pose(x, y, 0.0))
        made.clear()
        snap = grid.snapshot()
        for z in (15, 12, 10):
            for x, y in itertools.product((-1, 0), repeat=2):
                pixels(pyramid, snap, Square(z, x, y))
        return sum(made)

    # Tiles are 6.4 m wide: a circle of 3 m around the middle of one touches that one alone.
    assert look((3.2, 3.2), (9.6, 3.2), (3.2, -3.2), (-9.6, -9.6)) == 4
    assert look() == 0
    assert look((9.6, 3.2)) == 1
    assert look((9.6, 3.2), (9.6, 3.2), (-3.2, 3.2)) == 2
    size = pyramid.nbytes
    pyramid.let_go()
    assert pyramid.nbytes < size
    assert look() == 5


class TestRevisions:
    """The tag of a square: where it is the same the pixels are, and it changes only where something did."""

    @pytest.mark.parametrize(
        ("model", "half_life"),
        [*((model, None) for model in MODELS), (LogOdds(), 12.0), (Rate(), None), (Rate(), 3.0)],
    )
    def test_equal_revisions_are_equal_pixels(self, model, half_life):
        """Of a map that forgets a tick, every three scans here, is another revision of all tiles."""
        rng = np.random.default_rng(8)
        grid, seen, pyramid = grid_of(model, half_life=half_life), {}, TilePyramid()
        for k in range(30):
            drive(grid, rng, k, 4.0 + k)
            if k in (11, 22):
                x, y = rng.uniform(-20, 15, 2).tolist()
                grid.erase(Polygon.of_region(Region(x, y, x + 6.0, y + 9.0), grid.lattice))
            if k % 2:
                continue
            snap = grid.snapshot()
            for square in squares_of(CellRect(-256, -256, 512, 512), 0):
                revision = revision_of(snap.stored.tiles, snap.model, square)
                found = pixels(TilePyramid(), snap, square).tobytes()
                assert seen.setdefault((square, revision), found) == found
                assert revision is not None or not any(found)
            square = Square(15, 0, -1)
            assert np.array_equal(pixels(pyramid, snap, square), by_shrinking(snap, square))
        assert len(seen) > 30

    def test_it_is_that_of_the_scan_that_wrote_last_into_the_square(self):
        grid = grid_of(LogOdds())
        ring = Scan(0, 0.0, math.tau / 200, 0.0, 8.0, np.full(200, 3.0, np.float32))
        middles = [(3.2, 3.2), (28.8, 3.2), (3.2, -3.2), (-60.0, 3.2), (3.2, 3.2)]
        for x, y in middles:
            grid.integrate(ring, Pose(x, y, 0.0))
        tiles = grid.snapshot().stored.tiles

        def revision(z, x, y):
            return revision_of(tiles, grid.model, Square(z, x, y))

        assert [revision(16, x, y) for x, y in ((0, -1), (1, -1), (0, 0), (-3, -1), (1, 0), (-2, -1))] == [
            *(5, 2, 3, 4),
            *(None, None),
        ]
        assert [revision(15, x, y) for x, y in ((0, -1), (-2, -1), (0, 0), (-1, -1))] == [5, 4, 3, None]
        assert [revision(10, x, y) for x, y in ((0, -1), (-1, -1), (0, 0), (-1, 0))] == [5, 4, 3, None]
        for far in (2**26 - 1, 1 - 2**26):
            assert revision(10, far, far) is revision(16, far, far) is None

    def test_a_margin_brings_the_tiles_around(self):
        grid = grid_of(Counts())
        east = Scan(0, 0.0, 1.0, 0.0, 8.0, np.array([1.0], np.float32))
        grid.integrate(east, Pose(24.45, 3.25, 0.0))  # ends in cell 254, two beside the edge of square 0
        grid.integrate(east, Pose(24.55, 30.05, 0.0))  # in cell 255
        tiles = grid.snapshot().stored.tiles
        # By whole tiles of 64 cells: what was written may be anywhere in one.
        assert [revision_of(tiles, grid.model, Square(16, x, y)) for x, y in ((0, -1), (1, -1))] == [2, 2]
        assert [revision_of(tiles, LogOdds(), Square(16, x, y)) for x, y in ((0, -1), (1, -1))] == [1, None]

    @model_of_every_kind
    def test_those_of_many_squares_are_those_of_each(self, model):
        rng, grid = np.random.default_rng(11), grid_of(model)
        for k in range(12):
            drive(grid, rng, k, 60.0)
        tiles = grid.snapshot().stored.tiles
        for z, x, y, across, down in (
            (16, -4, -4, 8, 9),
            (16, 1, -2, 1, 1),
            (14, -1, -2, 3, 3),
            (10, -8, 0, 16, 16),
        ):
            found = revisions_of(tiles, model, Square(z, x, y), Square(z, x + across - 1, y + down - 1))
            assert found.shape == (across, down)
            for i, j in itertools.product(range(across), range(down)):
                alone = revision_of(tiles, model, Square(z, x + i, y + j))
                assert found[i, j] == (-1 if alone is None else alone), (z, i, j)
            assert z == 16 or len(np.unique(found)) > 1
        far = Square(16, 2**26 - 1, 1 - 2**26)
        assert revisions_of(tiles, model, far, far).tolist() == [[-1]]
        empty = OccupancyGrid(GridSettings(0.1, model), "e", "r").snapshot().stored.tiles
        assert revisions_of(empty, model, Square(10, -1, -1), Square(10, 0, 0)).tolist() == [[-1, -1]] * 2

    def test_cells_that_a_map_begins_with_are_of_revision_0_until_the_first_scan(self):
        """Both say 1 in the store: two contents would be under one tag."""
        rng, grid = np.random.default_rng(9), grid_of(LogOdds())
        cells = rng.integers(1, 9000, (100, 300)).astype(np.int16)
        grid.begin_with({"log_odds": cells}, (-20, 0))
        square, before = Square(16, 0, -1), grid.snapshot()
        assert revision_of(before.stored.tiles, grid.model, square) == 0
        assert revision_of(grid.snapshot().stored.tiles, grid.model, square) == 0
        pyramid = TilePyramid()
        check(pyramid, before, levels=(0, 1, 6))
        drive(grid, rng, 1, 1.0)
        after = grid.snapshot()
        assert revision_of(after.stored.tiles, grid.model, square) == 1
        assert not np.array_equal(pixels(pyramid, before, square), pixels(pyramid, after, square))
        check(pyramid, after, levels=(0, 1, 6))

    def test_a_square_without_a_known_cell_left_is_not_one_that_was_never_written(self):
        rng, grid = np.random.default_rng(10), grid_of(LogOdds())
        drive(grid, rng, 1, 1.0)
        grid.erase(Polygon.of_region(Region(-30.0, -30.0, 30.0, 30.0), grid.lattice))
        snap = grid.snapshot()
        assert revision_of(snap.stored.tiles, grid.model, Square(16, 0, 0)) == 2
        assert not pixels(TilePyramid(), snap, Square(15, 0, 0)).any()


def test_squares_lie_where_they_are_said_to():
    assert Square(16, 0, -1).rect == CellRect(0, 0, 256, 256)
    assert Square(16, -1, 0).rect == CellRect(-256, -256, 256, 256)
    assert Square(14, 2, -3).rect == CellRect(2048, 2048, 1024, 1024)
    lattice = Lattice(0.05, (3.0, -1.0))
    ix, iy = lattice.cell_of(-10.0, 44.0)
    x, y = ix // 256, -1 - iy // 256
    for k in LEVELS:
        assert (x, y) == (ix // (256 << k), -1 - iy // (256 << k))
        assert Square(16 - k, x, y).rect.contains(CellRect(ix, iy, 1, 1))
        x, y = x // 2, y // 2
