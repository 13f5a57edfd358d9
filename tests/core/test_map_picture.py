"""Pictures that are made anew only where the map has changed, read by Pillow."""

import io
import math
import zlib

import numpy as np
import pytest
from PIL import Image

import naive
from ogm_core.cells.log_odds import PLANE, LogOdds
from ogm_core.cells.model import Plane
from ogm_core.files.map_files import PALETTES, encode_png
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Region
from ogm_core.pictures import map_picture as tile_picture
from ogm_core.pictures.map_picture import MapPicture
from ogm_core.tiles.copies import copy_tiles
from ogm_core.tiles.store import TILE, TileStore
from ogm_core.types import Pose, Scan

MODELS = [LogOdds(), LogOdds(p_prior=0.1, p_free=0.05), LogOdds(p_prior=0.7, p_occ=0.8), LogOdds("float64")]


def pixels(data):
    """A picture as Pillow reads it; every chunk's CRC and zlib's Adler-32 are looked at."""
    with Image.open(io.BytesIO(data)) as picture:
        picture.verify()
    with Image.open(io.BytesIO(data)) as picture:
        assert picture.mode == "L"
        grey = np.asarray(picture)
    start = data.index(b"IDAT")
    rows = zlib.decompress(data[start + 4 : start + 4 + int.from_bytes(data[start - 4 : start])])
    assert rows == np.pad(grey, ((0, 0), (1, 0))).tobytes()
    return grey


def drawn(model, cells, palette):
    """What is to be seen, cell by cell."""
    return PALETTES[palette](model.probability(cells), model.known(cells))[::-1]


def random_scan(rng, k):
    beams = int(rng.integers(5, 60))
    ranges = rng.uniform(0.3, 9.0, beams).astype(np.float32)
    return Scan(k, 0.0, 2 * math.pi / beams, 0.0, 8.0, ranges)


@pytest.mark.parametrize("bounds", [None, Region(-7.0, -9.0, 12.9, 6.3)], ids=["unbounded", "bounded"])
@pytest.mark.parametrize("model", MODELS, ids=lambda m: f"{m.cells}, prior {m.p_prior}")
def test_pictures_of_a_map_that_grows_in_all_directions(model, bounds):
    rng = np.random.default_rng(11)
    grid = OccupancyGrid(GridSettings(0.1, model, bounds=bounds), "e")
    old = []
    for k in range(60):
        at = rng.uniform(-1.0, 1.0, 2) * (1 + k if bounds is None else 8.0)
        grid.integrate(random_scan(rng, k), Pose(*at.tolist(), float(rng.uniform(0, 6))))
        if k == 40:
            grid.reset("f")
            continue
        if k % 4 == 3:
            continue
        snap, cells = grid.snapshot(), naive.stored(grid._store, grid.rect)
        assert (snap.revision, snap.epoch) == (grid.revision, grid.epoch)
        assert snap.known_cells == np.count_nonzero(model.known(cells))
        if model.cells == "int16":
            counts = np.bincount(cells[cells != 0].view(np.uint16), minlength=2**16)
            assert np.array_equal(snap.stored.value_counts(PLANE), counts)
        for palette in list(PALETTES)[: 1 + k % 2]:
            assert np.array_equal(pixels(encode_png(snap, palette)), drawn(model, cells, palette))
        if k % 10 == 0:
            old.append((snap, cells, encode_png(snap)))
    for snap, cells, data in old:
        assert np.array_equal(snap.cells, cells)
        assert np.array_equal(pixels(encode_png(snap)), pixels(data))
        small, x, y = snap.shrink(50), *snap.origin
        part = snap.crop(Region(x + 1.05, y + 0.55, x + 3.0, y + 2.0))
        for cut, same in ((small, cells), (part, cells[5:20, 10:30])):
            if cut is part:
                assert np.array_equal(cut.cells, same)
            assert np.array_equal(pixels(encode_png(cut)), drawn(model, cut.cells, "ros"))


class Desk:
    """A store of arbitrary cells and its picture in a palette."""

    def __init__(self, tiles=(5, 4), palette="probability", seed=0):
        self.rng = np.random.default_rng(seed)
        self.store = TileStore(
            CellRect(-64, 128, TILE * tiles[0], TILE * tiles[1]), (Plane(PLANE, np.dtype(np.int16)),)
        )
        self.palette, self.revision, self.copies = palette, 0, None
        self.picture = MapPicture(LogOdds().table(PALETTES[palette]))

    def fill(self, tx, ty, cells):
        self.revision += 1
        self.store.planes[PLANE].cells.reshape(*self.store.touched.shape, TILE, TILE)[tx, ty] = cells
        self.store.touched[tx, ty] = self.revision

    def check(self, rect=None):
        rect = rect or self.store.rect
        self.copies = copy_tiles(self.store, self.revision, self.copies)
        grey = pixels(self.picture.png(self.copies, rect))
        assert np.array_equal(grey, drawn(LogOdds(), naive.stored(self.store, rect), self.palette))


def noise(rng):
    return rng.integers(-(2**15), 2**15, (TILE, TILE)) | 1


def stripes(rng):
    """Runs of every length, some over whole rows and on into the next tiles."""
    return np.repeat(rng.integers(-(2**15), 2**15, 2000) | 1, rng.integers(1, 130, 2000))[: TILE**2].reshape(
        TILE, TILE
    )


def flat(rng):
    return np.full((TILE, TILE), int(rng.integers(-(2**14), 2**14)) * 2 + 1)


def three(rng):
    return rng.choice([0, -9001, 9001, 1], (TILE, TILE))


@pytest.mark.parametrize("palette", PALETTES)
@pytest.mark.parametrize("kinds", [[noise], [stripes], [flat], [three], [noise, stripes, flat, three]])
def test_tiles_of_any_cells(palette, kinds):
    desk = Desk(palette=palette)
    desk.check()  # no cell is known
    for _ in range(30):
        tx, ty = desk.rng.integers(0, (5, 4)).tolist()
        desk.fill(tx, ty, kinds[desk.rng.integers(len(kinds))](desk.rng))
        desk.check()


def test_any_part_whose_surroundings_are_unknown():
    desk = Desk(seed=4)
    frame = desk.store.rect
    for _ in range(40):
        west, east = sorted(desk.rng.choice(frame.width + 1, 2, replace=False).tolist())
        south, north = sorted(desk.rng.choice(frame.height + 1, 2, replace=False).tolist())
        rect = CellRect(frame.ix + west, frame.iy + south, east - west, north - south)
        dense = np.zeros((frame.height, frame.width), np.int16)
        dense[south:north, west:east] = desk.rng.choice([0, 0, 9001, -777], (north - south, east - west))
        desk.revision += 1
        desk.store.planes[PLANE].cells.reshape(5, 4 * TILE, TILE)[:] = dense.reshape(
            4 * TILE, 5, TILE
        ).transpose(1, 0, 2)
        desk.store.touched[:] = desk.revision
        desk.check(rect)


@pytest.mark.parametrize("width", [1, 63, 64, 65, 130])
@pytest.mark.parametrize("height", [1, 64, 65])
def test_small_pictures(width, height):
    desk = Desk()
    rect = CellRect(-64 + 10, 128 + 7, width, height)
    for (iy, ix), value in np.ndenumerate(desk.rng.integers(-9000, 9000, (height, width))):
        desk.store.planes[PLANE].cells[desk.store.planes[PLANE].column[10 + ix] + TILE * (7 + iy)] = value
    desk.revision += 1
    desk.store.touched[:] = desk.revision
    desk.check(rect)


def test_only_rows_of_tiles_that_have_changed_are_put_together_again():
    desk = Desk()
    for tx, ty in np.ndindex(5, 4):
        desk.fill(tx, ty, stripes(desk.rng))
    desk.check()
    before = dict(desk.picture._strips)
    desk.fill(3, 2, noise(desk.rng))
    desk.check()
    after = desk.picture._strips
    assert [after[ty] is before[ty] for ty in range(2, 6)] == [True, True, False, True]


def test_only_tiles_that_have_changed_are_drawn(monkeypatch):
    drawn_slots = []
    code_tiles = tile_picture.code_tiles

    def counted(tiles, rows, slots, *more):
        drawn_slots.append(len(slots))
        return code_tiles(tiles, rows, slots, *more)

    monkeypatch.setattr(tile_picture, "code_tiles", counted)
    desk = Desk()
    for tx, ty in np.ndindex(5, 3):
        desk.fill(tx, ty, stripes(desk.rng))
    desk.check()
    assert drawn_slots == [15]
    desk.fill(0, 3, flat(desk.rng))
    desk.fill(1, 1, flat(desk.rng))
    desk.check()
    desk.check()
    assert drawn_slots == [15, 2]


def test_a_full_pool_is_made_anew():
    desk = Desk(tiles=(4, 4))
    for tx, ty in np.ndindex(4, 4):
        desk.fill(tx, ty, flat(desk.rng))
    desk.check()
    room = len(desk.picture._pool)
    for _ in range(12):
        for tx, ty in np.ndindex(4, 4):
            desk.fill(tx, ty, noise(desk.rng))
        desk.check()
    assert len(desk.picture._pool) > room
    assert desk.picture._used <= len(desk.picture._pool)


def out_of_memory(*_):
    raise MemoryError


@pytest.mark.parametrize("broken", ["code_tiles", "_longer"])
def test_a_picture_is_whole_after_memory_gave_out(monkeypatch, broken):
    desk = Desk()
    desk.fill(1, 1, noise(desk.rng))
    desk.check()
    grown = desk.store.grown(CellRect(desk.store.rect.ix - 1, desk.store.rect.iy, 1, 1))
    grown.take(desk.store)
    desk.store = grown
    for tx, ty in np.ndindex(4, 4):
        desk.fill(tx, ty, stripes(desk.rng))
    with monkeypatch.context() as patch:
        patch.setattr(tile_picture, broken, out_of_memory)
        with pytest.raises(MemoryError):
            desk.check()
    desk.check()


def test_the_check_sum_of_a_map_of_250_km():
    """80,000 flat tiles in a row, whose sums would be too large for 64 bits."""
    picture, tiles = MapPicture(LogOdds().table(PALETTES["ros"])), 80_000
    picture._rect = CellRect(0, 0, tiles * TILE, TILE)
    picture._slots = np.ones((tiles, 1), np.uint64)
    picture._sums = np.zeros((2, 3), np.int64)  # greys of 0
    check = 1
    for _ in range(TILE):
        check = zlib.adler32(bytes(tiles * TILE + 1), check)
    assert picture._adler(picture._rect) == check


def test_a_map_that_is_reset_and_then_outgrows_what_it_was():
    grid, rng = OccupancyGrid(GridSettings(0.1), "e"), np.random.default_rng(6)
    for k in range(8):
        if k == 3:
            grid.reset("f")
        grid.integrate(random_scan(rng, k), Pose(-9.0 * k, 5.0 * k, 0.0))
        snap = grid.snapshot()
        assert np.array_equal(pixels(encode_png(snap)), drawn(snap.model, snap.cells, "ros"))


def test_greys_that_are_never_0():
    desk = Desk()
    desk.picture = MapPicture(np.maximum(LogOdds().table(PALETTES["probability"]), 9))
    desk.fill(1, 1, noise(desk.rng))
    copies = copy_tiles(desk.store, desk.revision)
    grey = pixels(desk.picture.png(copies, desk.store.rect))
    expected = drawn(LogOdds(), naive.stored(desk.store, desk.store.rect), "probability")
    assert np.array_equal(grey, np.maximum(expected, 9))


def test_there_is_room_for_the_bits_of_tiles_that_the_code_does_not_suit(monkeypatch):
    shares = []
    join_rows = tile_picture.join_rows

    def measured(*arguments):
        size = join_rows(*arguments)
        assert size + 4 <= arguments[-1].nbytes
        shares.append(size / arguments[-1].nbytes)
        return size

    monkeypatch.setattr(tile_picture, "join_rows", measured)
    desk = Desk()
    for tx, ty in np.ndindex(5, 4):
        desk.fill(tx, ty, np.full((TILE, TILE), 9001))
    desk.check()
    for tx in range(5):
        desk.fill(tx, 2, noise(desk.rng))
    desk.check()
    assert max(shares) > 0.5


def test_an_older_snapshot_is_drawn_after_a_newer_one():
    grid = OccupancyGrid(GridSettings(0.1), "e")
    rng = np.random.default_rng(5)
    grid.integrate(random_scan(rng, 0), Pose(0.0, 0.0, 0.0))
    first = grid.snapshot()
    grid.integrate(random_scan(rng, 1), Pose(3.0, -8.0, 0.0))
    second = grid.snapshot()
    for snap in (second, first, second):
        assert np.array_equal(pixels(encode_png(snap)), drawn(snap.model, snap.cells, "ros"))
