"""Erasing: cells whose centre lies in a polygon become unknown, and all that is told of the map is right."""

import io
from functools import cache

import numpy as np
import pytest
from PIL import Image

from counts_model import Counts, scans
from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.model import row_bands
from ogm_core.errors import BadParameter, MapEmpty
from ogm_core.files.map_files import PALETTES
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Lattice, Region
from ogm_core.pictures.map_picture import MapPicture
from ogm_core.pictures.png import write_png
from ogm_core.tiles.polygon import MAX_POINTS, Polygon
from stored_maps import MODELS

RESOLUTION = 0.25
LATTICE = Lattice(RESOLUTION)
FRAME = CellRect(-48, -48, 160, 160)
"""It holds every cell of the maps below."""
BOUNDS = Region(-3.0, -2.0, 22.25, 17.0)
WHERE = pytest.mark.parametrize("bounds", [None, BOUNDS], ids=["unbounded", "bounded"])
EVERYTHING = Region(-100.0, -100.0, 100.0, 100.0)
BOW = ((0.0, 0.0), (8.0, 6.0), (8.0, 0.0), (0.0, 6.0))
STAR = ((10.0, 1.0), (15.0, 14.0), (3.0, 6.0), (17.0, 6.0), (5.0, 14.0))
AREAS = {
    "bow tie": BOW,
    "star": STAR,
    "a sliver": ((-2.0, -2.0), (19.0, 17.25), (16.0, 17.0)),
    "three times around": (*BOW, *BOW, *BOW),
    "partly outside": ((-50.0, -40.0), (5.0, -40.0), (7.0, 3.0), (-20.0, 60.0)),
    "all of it": ((-100.0, -100.0), (100.0, -100.0), (100.0, 100.0), (-100.0, 100.0)),
}


def in_polygon(points, x, y):
    """Even-odd rule for one point, by a ray to the left; exact for numbers of few binary digits."""
    inside = False
    for (x0, y0), (x1, y1) in zip(points, [*points[1:], points[0]], strict=True):
        if (y0 <= y) != (y1 <= y):
            right = (x - x0) * (y1 - y0) - (y - y0) * (x1 - x0)
            inside ^= right >= 0 if y1 > y0 else right <= 0
    return inside


@cache
def cells_in(points, rect, lattice=LATTICE):
    """Mask of the cells whose centre is inside, cell by cell."""
    (x, y), size = lattice.anchor, lattice.resolution
    columns, rows = range(rect.ix, rect.ix + rect.width), range(rect.iy, rect.iy + rect.height)
    centres = [[(x + (i + 0.5) * size, y + (j + 0.5) * size) for i in columns] for j in rows]
    return np.array([[in_polygon(points, *centre) for centre in row] for row in centres])


def grid_of(model=None, bounds=None, count=8):
    settings = GridSettings(resolution=RESOLUTION, cell_model=model or LogOdds(), bounds=bounds)
    grid = OccupancyGrid(settings, "e", "r")
    for scan, pose in list(scans())[:count]:
        grid.integrate(scan, pose)
    return grid


def area(grid, points):
    return Polygon(points, grid.lattice)


def everything(grid):
    """Every number of the map on one large rectangle, bit for bit, in cells that are blocks of numbers."""
    snapshot = grid.snapshot()
    assert FRAME.contains(snapshot.rect)
    found = {}
    for plane in grid.model.planes:
        whole = np.zeros((FRAME.height * plane.side, FRAME.width * plane.side), f"i{plane.dtype.itemsize}")
        x, y = ((a - b) * plane.side for a, b in zip(snapshot.offset, FRAME[:2], strict=True))
        cells = snapshot.stored.planes()[plane.name]
        whole[y : y + cells.shape[0], x : x + cells.shape[1]] = cells.view(whole.dtype)
        found[plane.name] = whole.reshape(FRAME.height, plane.side, FRAME.width, plane.side)
    return found


def written(planes):
    return np.any([(cells != 0).any(axis=(1, 3)) for cells in planes.values()], axis=0)


def smallest(mask):
    """The smallest rectangle around what is true, cell by cell."""
    places = [(FRAME.ix + i, FRAME.iy + j) for j, i in np.argwhere(mask).tolist()]
    if not places:
        return CellRect(0, 0, 0, 0)
    xs, ys = zip(*places, strict=True)
    return CellRect(min(xs), min(ys), max(xs) - min(xs) + 1, max(ys) - min(ys) + 1)


@pytest.mark.parametrize("points", AREAS.values(), ids=AREAS)
@WHERE
@MODELS
def test_cells_whose_centre_lies_inside_are_unknown_and_no_others(model, bounds, points):
    grid = grid_of(model, bounds)
    before = grid.stamp, grid.cell_updates, grid.epoch, grid.run, grid.nbytes
    cells = everything(grid)
    known = written(cells)
    gone = known & cells_in(points, FRAME, grid.lattice)
    assert grid.erase(area(grid, points)) == np.count_nonzero(gone)
    assert np.count_nonzero(gone) > 40
    assert (grid.stamp, grid.cell_updates, grid.epoch, grid.run, grid.nbytes) == before
    assert (grid.revision, grid.erasures, grid.snapshot().scans) == (9, 1, 8)
    after = everything(grid)
    for name, numbers in cells.items():
        expected = np.where(gone[:, None, :, None], 0, numbers)
        assert np.array_equal(after[name], expected)
    snapshot = grid.snapshot()
    left = smallest(known & ~gone)
    assert grid.rect == (grid.bounds or (left.widened(model.spread) if left.cells else left))
    if not model.spread:
        assert snapshot.known_cells == np.count_nonzero(known & ~gone)
    assert sum(
        np.count_nonzero(snapshot.published(rows)[1]) for rows in row_bands(snapshot.stored.shape)
    ) == (snapshot.known_cells)


def test_polygons_beside_each_other_share_no_cell_and_leave_none_out():
    """Corners and edges in centres of cells: each centre on the common edges is of one of them."""
    rng = np.random.default_rng(5)
    for _ in range(200):
        corners = rng.integers(-8, 9, (4, 2)) * RESOLUTION / 2 + np.array(
            [[-6, -6], [6, -6], [6, 6], [-6, 6]]
        )
        centre = tuple((rng.integers(-8, 9, 2) * RESOLUTION / 2).tolist())
        ring = [tuple(corner) for corner in corners.tolist()]
        parts = [[ring[k - 1], ring[k], centre] for k in range(4)]
        rect = CellRect(-40, -40, 80, 80)
        lattice = Lattice(RESOLUTION)
        masks = [Polygon(part, lattice).inside(rect) for part in parts]
        assert np.array_equal(np.sum(masks, axis=0), Polygon(ring, lattice).inside(rect).astype(int))


def test_polygons_of_any_shape_are_those_of_exact_numbers():
    rng = np.random.default_rng(6)
    lattice = Lattice(0.5, (0.25, -3.0))
    for corners in [3, 4, 5, 7, 12, MAX_POINTS] * 8:
        points = tuple(map(tuple, (rng.integers(-30, 31, (corners, 2)) / 8).tolist()))
        polygon = Polygon(points, lattice)
        rect = CellRect(-12, -8, 24, 23)
        expected = cells_in(points, rect, lattice)
        assert np.array_equal(polygon.inside(rect), expected)
        # Nothing inside lies out of the rectangle that is told, however it is cut.
        assert np.count_nonzero(polygon.inside(polygon.rect)) == np.count_nonzero(expected)
        for k in range(rect.height):
            row = CellRect(rect.ix, rect.iy + k, rect.width, 1)
            assert np.array_equal(polygon.inside(row)[0], expected[k])


def test_a_region_is_the_cells_whose_centre_it_holds():
    """As `cover` would have it where edges are edges of cells, whatever the rounding of decimals."""
    lattice = Lattice(0.05)
    rect = CellRect(-40, -40, 80, 80)
    for k in range(-30, 30):
        region = Region(k * 0.05, 0.1 + 0.2, (k + 3) * 0.05, 0.7)
        polygon = Polygon.of_region(region, lattice)
        assert polygon.rect == lattice.cover(region) == CellRect(k, 6, 3, 8)
        assert np.count_nonzero(polygon.inside(rect)) == 24
    # From centre to centre: the left and lower one is inside, the right and upper one is not.
    centres = Polygon.of_region(Region(0.075, 0.125, 0.175, 0.225), lattice)
    assert centres.rect == CellRect(1, 2, 2, 2)
    for k in range(-300, 300):
        west, east = (k + 0.5) * 0.05, (k + 2.5) * 0.05
        assert Polygon.of_region(Region(west, west, east, east), lattice).rect == CellRect(k, k, 2, 2)
    assert not Polygon.of_region(Region(0.03, 0.03, 0.07, 0.07), lattice).rect.cells


@pytest.mark.parametrize(
    ("points", "said"),
    [
        ([(0, 0), (1, 1)], "3 to 64 points"),
        ([(0, 0)] * (MAX_POINTS + 1), "got 65"),
        ([(0, 0), (1, 1), (float("nan"), 0)], "finite numbers"),
        ([(0, 0), (1, 1), (0, float("inf"))], "finite numbers"),
        ([(0, 0), (1, 1), (0, 1e300)], "places that have cells"),
        ([(0, 0), (1, 1), (0, -1.7e308)], "places that have cells"),  # more cells than a float counts
    ],
)
def test_what_is_no_polygon_is_refused(points, said):
    with pytest.raises(BadParameter, match=said):
        Polygon(points, Lattice(RESOLUTION))


@WHERE
def test_nothing_of_the_map_is_nothing_to_erase(bounds):
    grid = grid_of(bounds=bounds)
    before = everything(grid)
    for region, said in (
        (Region(50, 50, 60, 60), "x 50 to 60, y 50 to 60 m, lies wholly outside the map, x -"),
        (Region(0.26, 0.26, 0.3, 0.3), "too small"),
    ):
        with pytest.raises(BadParameter, match=said):
            grid.erase(Polygon.of_region(region, grid.lattice))
    assert (grid.revision, grid.erasures) == (8, 0)
    assert all(np.array_equal(cells, before[name]) for name, cells in everything(grid).items())


def test_a_map_without_a_cell_has_nothing_to_erase_and_bounds_are_cells():
    grid = grid_of(count=0)
    with pytest.raises(MapEmpty):
        grid.erase(Polygon.of_region(EVERYTHING, grid.lattice))
    assert grid.revision == 0
    bounded = grid_of(count=0, bounds=BOUNDS)
    assert bounded.erase(Polygon.of_region(EVERYTHING, bounded.lattice)) == 0
    assert (bounded.revision, bounded.snapshot().stamp) == (1, None)


def test_twice_around_is_outside_by_the_even_odd_rule():
    assert not cells_in((*BOW, *BOW), FRAME).any()
    assert grid_of().erase(Polygon((*BOW, *BOW), LATTICE)) == 0


def test_nothing_known_is_erased_and_is_a_revision():
    grid = grid_of()
    assert grid.erase(area(grid, [(-2, 15), (-2, 16), (-1, 16), (-1, 15)])) == 0
    assert (grid.revision, grid.erasures) == (9, 1)
    assert list(grid.checkpoint().tiles_since(8)) == []


def test_a_known_zero_is_known_and_is_erased():
    """float64 cells store it as -0.0."""
    grid = grid_of(LogOdds("float64"), count=0)
    grid.begin_with({"log_odds": np.array([[0.0, -0.0, 1.0, -0.0, 0.0]])})
    assert grid.rect == CellRect(1, 0, 3, 1)
    assert grid.erase(Polygon.of_region(Region(0.5, 0.0, 0.75, 0.25), grid.lattice)) == 1
    assert grid.rect == CellRect(1, 0, 3, 1)
    assert grid.erase(Polygon.of_region(Region(0.0, 0.0, 0.75, 0.25), grid.lattice)) == 1
    assert grid.rect == CellRect(3, 0, 1, 1)


@MODELS
@WHERE
def test_scans_after_it_go_into_what_is_left(model, bounds):
    """As into a map that has these cells from the beginning."""
    grid = grid_of(model, bounds)
    grid.erase(area(grid, STAR))
    again = OccupancyGrid(grid.settings, "e", "r")
    again.begin_with(grid.snapshot().stored.planes(), (grid.rect.ix, grid.rect.iy))
    for scan, pose in list(scans())[5:]:
        assert grid.integrate(scan, pose) == again.integrate(scan, pose)
        one, other = everything(grid), everything(again)
        assert all(np.array_equal(cells, other[name]) for name, cells in one.items())
        assert grid.rect == again.rect


@MODELS
def test_a_map_goes_on_after_all_of_it_was_erased(model):
    grid, fresh = grid_of(model), grid_of(model, count=0)
    grid.erase(Polygon.of_region(EVERYTHING, grid.lattice))
    assert grid.rect == CellRect(0, 0, 0, 0)
    assert grid.snapshot().empty
    for scan, pose in list(scans())[3:6]:
        grid.integrate(scan, pose)
        fresh.integrate(scan, pose)
    assert grid.rect == fresh.rect
    one, other = everything(grid), everything(fresh)
    assert all(np.array_equal(cells, other[name]) for name, cells in one.items())


@MODELS
@WHERE
def test_copies_and_pictures_of_before_stay_and_those_after_are_right(model, bounds):
    """The picture is kept up to date from one to the next, also around the edges of what was erased."""
    grid = grid_of(model, bounds)
    picture = MapPicture(PALETTES["probability"])
    for points in (STAR, BOW, AREAS["a sliver"]):
        before = grid.snapshot()
        kept = picture.png(before)
        copied = {name: cells.copy() for name, cells in before.stored.planes().items()}
        part = before.stored.part(slice(3, 50), slice(5, 60)).planes()
        grid.erase(area(grid, points))
        assert part.keys() == copied.keys()
        after = grid.snapshot()
        assert after.revision == before.revision + 1
        for name, cells in before.stored.planes().items():
            assert np.array_equal(cells, copied[name])
        assert pixels(picture.png(after)) == pixels(write_png(after.encode(PALETTES["probability"])[::-1]))
        assert pixels(picture.png(after)) != pixels(kept)
        assert pixels(picture.png(before)) == pixels(kept)


@MODELS
@WHERE
def test_a_checkpoint_after_it_is_the_map_and_holds_only_tiles_that_changed(model, bounds):
    grid = grid_of(model, bounds)
    before = grid.checkpoint()
    stored = {(tile.tx, tile.ty): tile for tile in before.tiles_since(0)}
    cells = everything(grid)
    gone = written(cells) & cells_in(BOW, FRAME, grid.lattice)
    grid.erase(area(grid, BOW))
    checkpoint = grid.checkpoint()
    changed = {(tile.tx, tile.ty): tile for tile in checkpoint.tiles_since(before.state.revision)}
    met = {((FRAME.ix + i) // 64, (FRAME.iy + j) // 64) for j, i in np.argwhere(gone).tolist()}
    assert set(changed) == met
    assert len(met) < len(stored)
    again = OccupancyGrid(grid.settings, "x", "r")
    again.restore(checkpoint.state, (stored | changed).values())
    assert (again.epoch, again.revision, again.erasures, again.rect) == ("e", 9, 1, grid.rect)
    one, other = everything(grid), everything(again)
    assert all(np.array_equal(numbers, other[name]) for name, numbers in one.items())


def test_a_copy_that_is_made_ahead_of_it_is_not_taken_for_one_after_it():
    grid = grid_of()
    ahead = grid.copy_ahead()
    made = ahead.made()
    grid.erase(area(grid, STAR))
    grid.take_ahead(ahead, made)
    twin = grid_of()
    twin.erase(area(twin, STAR))
    one, other = everything(grid), everything(twin)
    assert all(np.array_equal(numbers, other[name]) for name, numbers in one.items())


def test_a_map_that_began_with_cells_is_erased_before_its_first_scan():
    began = grid_of()
    for cells in began.snapshot().stored.planes().values():
        grid = grid_of(count=0)
        grid.begin_with({"log_odds": cells}, began.rect[:2])
    first = grid.checkpoint()
    erased = grid.erase(area(grid, STAR))
    assert erased > 40
    assert (grid.revision, grid.snapshot().scans) == (1, 0)
    again = OccupancyGrid(grid.settings, "x", "r")
    kept = {(tile.tx, tile.ty): tile for tile in first.tiles_since(0)}
    kept |= {(tile.tx, tile.ty): tile for tile in grid.checkpoint().tiles_since(0)}
    again.restore(grid.checkpoint().state, kept.values())
    one, other = everything(grid), everything(again)
    assert all(np.array_equal(numbers, other[name]) for name, numbers in one.items())


def test_models_of_the_test_have_a_margin_and_a_finer_plane():
    """Or the tests above would not be about these."""
    assert Counts().margin == 1
    assert {plane.side for plane in Counts().planes} == {1, 2}


def pixels(png):
    """They may be packed in two ways."""
    return np.asarray(Image.open(io.BytesIO(png))).tolist()
