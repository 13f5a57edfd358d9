"""Pictures that are made anew only where the map has changed, read by Pillow."""

import io
import math
import zlib

import numpy as np
import pytest
from PIL import Image

import naive
from ogm_core.cells import rate_kernel
from ogm_core.cells.compiled import compiled
from ogm_core.cells.log_odds import PLANE, LogOdds
from ogm_core.cells.model import Plane
from ogm_core.cells.rate import Rate
from ogm_core.files.map_files import PALETTES, encode_png
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Lattice, Region
from ogm_core.pictures.map_picture import MapPicture, combined
from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.copies import copy_tiles
from ogm_core.tiles.store import TILE, TileStore
from ogm_core.tiles.view import TileView
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


def picture_png(snap, palette="ros", picture=None):
    """The picture as a mapper keeps it up to date, which must be that of the snapshot by itself."""
    data = (picture or MapPicture(PALETTES[palette])).png(snap)
    assert np.array_equal(pixels(data), pixels(encode_png(snap, palette)))
    return data


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
    pictures = {palette: MapPicture(encoder) for palette, encoder in PALETTES.items()}
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
            data = picture_png(snap, palette, pictures[palette])
            assert np.array_equal(pixels(data), drawn(model, cells, palette))
        if k % 10 == 0:
            old.append((snap, cells, encode_png(snap)))
    for snap, cells, data in old:
        assert np.array_equal(snap.cells, cells)
        assert picture_png(snap, picture=pictures["ros"]) == picture_png(snap)
        assert np.array_equal(pixels(encode_png(snap)), pixels(data))
        small, x, y = snap.shrink(50), *snap.origin
        part = snap.crop(Region(x + 1.05, y + 0.55, x + 3.0, y + 2.0))
        for cut, same in ((small, cells), (part, cells[5:20, 10:30])):
            if cut is part:
                assert np.array_equal(cut.cells, same)
            assert np.array_equal(
                pixels(picture_png(cut, picture=pictures["ros"])), drawn(model, cut.cells, "ros")
            )


class Desk:
    """A store of arbitrary cells and its picture in a palette."""

    def __init__(self, tiles=(5, 4), palette="probability", seed=0):
        self.rng = np.random.default_rng(seed)
        self.store = TileStore(
            CellRect(-64, 128, TILE * tiles[0], TILE * tiles[1]), (Plane(PLANE, np.dtype(np.int16)),)
        )
        self.palette, self.revision, self.copies = palette, 0, None
        self.picture = MapPicture(PALETTES[palette])

    def fill(self, tx, ty, cells):
        self.revision += 1
        self.store.planes[PLANE].cells.reshape(*self.store.touched.shape, TILE, TILE)[tx, ty] = cells
        self.store.touched[tx, ty] = self.revision

    def check(self, rect=None):
        rect = rect or self.store.rect
        self.copies = copy_tiles(self.store, self.revision, self.copies)
        planes = (Plane(PLANE, np.dtype(np.int16)),)
        view = TileView(self.copies, rect, planes)
        self.snap = MapSnapshot(view, LogOdds(), Lattice(0.1), (rect.ix, rect.iy), "e", self.revision, None)
        grey = pixels(self.picture.png(self.snap))
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


def test_a_picture_is_whole_after_memory_gave_out(monkeypatch):
    desk = Desk()
    desk.fill(1, 1, noise(desk.rng))
    desk.check()
    for tx, ty in np.ndindex(4, 4):
        desk.fill(tx, ty, stripes(desk.rng))
    encode, calls = MapSnapshot.encode, []

    def out_of_memory(*arguments):
        calls.append(arguments)
        if len(calls) == 3:
            raise MemoryError
        return encode(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(MapSnapshot, "encode", out_of_memory)
        with pytest.raises(MemoryError):
            desk.check()
    desk.check()


@pytest.mark.parametrize("seed", range(5))
def test_check_sums_are_put_together(seed):
    rng = np.random.default_rng(seed)
    parts = [rng.integers(0, 256, size, np.uint8).tobytes() for size in rng.integers(0, 70_000, 6)]
    check = combined([(zlib.adler32(part), len(part)) for part in parts])
    assert check == zlib.adler32(b"".join(parts))


def test_a_store_begun_anew_is_another_picture_though_its_tiles_have_the_same_numbers():
    grid, picture = OccupancyGrid(GridSettings(0.1), "e"), MapPicture(PALETTES["ros"])
    shots = []
    scan = random_scan(np.random.default_rng(1), 0)
    for times in (1, 2):
        grid.reset("e")
        for _ in range(times):
            grid.integrate(scan, Pose(0.0, 0.0, 0.0))
        shots.append(grid.snapshot())
    assert np.array_equal(*(shot.stored.tiles.numbers for shot in shots))
    for shot in (*shots, *shots):
        picture_png(shot, picture=picture)


def test_a_map_that_is_reset_and_then_outgrows_what_it_was():
    grid, rng = OccupancyGrid(GridSettings(0.1), "e"), np.random.default_rng(6)
    picture = MapPicture(PALETTES["ros"])
    for k in range(8):
        if k == 3:
            grid.reset("f")
        grid.integrate(random_scan(rng, k), Pose(-9.0 * k, 5.0 * k, 0.0))
        snap = grid.snapshot()
        data = picture_png(snap, picture=picture)
        assert np.array_equal(pixels(data), drawn(snap.model, snap.cells, "ros"))


def test_an_older_snapshot_is_drawn_after_a_newer_one():
    grid = OccupancyGrid(GridSettings(0.1), "e")
    rng = np.random.default_rng(5)
    grid.integrate(random_scan(rng, 0), Pose(0.0, 0.0, 0.0))
    first = grid.snapshot()
    grid.integrate(random_scan(rng, 1), Pose(3.0, -8.0, 0.0))
    second = grid.snapshot()
    picture = MapPicture(PALETTES["ros"])
    for snap in (second, first, second):
        data = picture_png(snap, picture=picture)
        assert np.array_equal(pixels(data), drawn(snap.model, snap.cells, "ros"))


@pytest.mark.parametrize("finest", [False, True], ids=["cells", "halves"])
@pytest.mark.parametrize("bounds", [None, Region(-7.0, -9.0, 12.9, 6.3)], ids=["unbounded", "bounded"])
def test_pictures_of_counts_that_grow_in_all_directions(bounds, finest):
    rng = np.random.default_rng(12)
    grid = OccupancyGrid(GridSettings(0.1, compiled(Rate()), bounds=bounds), "e")
    picture = MapPicture(PALETTES["ros"])
    for k in range(30):
        at = rng.uniform(-1.0, 1.0, 2) * (1 + k // 2 if bounds is None else 8.0)
        grid.integrate(random_scan(rng, k), Pose(*at.tolist(), float(rng.uniform(0, 6))))
        if k == 20:
            grid.reset("f")
            continue
        snap = grid.snapshot().finest() if finest else grid.snapshot()
        picture_png(snap, picture=picture)


@pytest.mark.parametrize("finest", [False, True], ids=["cells", "halves"])
def test_of_counts_only_what_may_have_changed_is_published_again(finest, monkeypatch):
    """A scan in one tile of a long hall, with hits along its edges: cells beside it change, too."""
    published, compiled_publish = [], rate_kernel.publish

    def publish(passing, hits, unanswered, rule):
        edge = 2 * rule.margin
        published.append((passing.shape[0] - edge) * (passing.shape[1] - edge))
        return compiled_publish(passing, hits, unanswered, rule)

    monkeypatch.setattr(rate_kernel, "publish", publish)
    grid = OccupancyGrid(GridSettings(0.1, Rate()), "e")
    picture = MapPicture(PALETTES["probability"])
    rng = np.random.default_rng(1)

    def shown():
        published.clear()
        snap = grid.snapshot().finest() if finest else grid.snapshot()
        data = picture.png(snap)
        count = sum(published)
        assert np.array_equal(pixels(data), pixels(encode_png(snap, "probability")))
        return count, snap.width * snap.height

    for k in range(12):
        grid.integrate(random_scan(rng, k), Pose(10.0 * k, 0.0, 0.0))
    count, cells = shown()
    assert count == cells
    for k in range(20):
        near = Scan(13 + k, 0.0, math.pi / 2, 0.0, 8.0, np.full(4, 3.1625, np.float32))
        grid.integrate(near, Pose(3.2, 3.2, 0.0))  # in the middle of the tile (0, 0) of 6.4 m
    count, _ = shown()
    side, margin = (2 * TILE, 3) if finest else (TILE, 1)
    assert side * (side + 2 * margin) <= count <= (side + 2 * TILE) * (side + 2 * margin) < cells / 4
