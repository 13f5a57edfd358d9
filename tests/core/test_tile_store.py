"""Where cells lie in memory."""

import itertools
from pathlib import Path

import numpy as np
import pytest

import naive
from ogm_core.cells.log_odds import PLANE
from ogm_core.cells.model import Plane
from ogm_core.errors import LimitReached
from ogm_core.lattice import CellRect
from ogm_core.tiles.store import TILE, TileStore

INT16 = (Plane(PLANE, np.dtype(np.int16)),)
NOWHERE = CellRect(0, 0, 0, 0)


def write(store, ix, iy, value):
    """Store a cell as the kernels do, and mark its tile."""
    i, j = ix - store.rect.ix, iy - store.rect.iy
    store.planes[PLANE].cells[store.planes[PLANE].column[i] + TILE * j] = value
    tile = i // TILE, j // TILE
    store.tiles_used += store.touched[tile] == 0
    store.touched[tile] = 1


def filled(rect, count, seed=0, dtype=np.int16):
    """A store with some cells written, and the same cells in a dictionary."""
    rng = np.random.default_rng(seed)
    store, cells = TileStore(rect, (Plane(PLANE, np.dtype(dtype)),)), {}
    for value in range(1, count + 1):
        cell = rect.ix + int(rng.integers(rect.width)), rect.iy + int(rng.integers(rect.height))
        write(store, *cell, value)
        cells[cell] = value
    return store, cells


def assert_holds(store, cells):
    dense = np.zeros((store.rect.height, store.rect.width), store.planes[PLANE].cells.dtype)
    for (ix, iy), value in cells.items():
        dense[iy - store.rect.iy, ix - store.rect.ix] = value
    assert np.array_equal(naive.stored(store, store.rect), dense)


@pytest.mark.parametrize(
    ("rect", "tiles"),
    [
        (CellRect(0, 0, 1, 1), CellRect(0, 0, 64, 64)),
        (CellRect(0, 0, 64, 64), CellRect(0, 0, 64, 64)),
        (CellRect(63, 0, 2, 65), CellRect(0, 0, 128, 128)),
        (CellRect(-1, -65, 1, 1), CellRect(-64, -128, 64, 64)),
        (CellRect(-1, -64, 2, 64), CellRect(-64, -64, 128, 64)),
        (CellRect(1000, 64, 30, 64), CellRect(960, 64, 128, 64)),
        (CellRect(2**40, -(2**40), 1, 1), CellRect(2**40, -(2**40), 64, 64)),
        (NOWHERE, NOWHERE),
    ],
)
def test_a_store_is_a_rectangle_of_whole_tiles(rect, tiles):
    store = TileStore(rect, INT16)
    assert store.rect == tiles
    assert store.touched.shape == (tiles.width // 64, tiles.height // 64)
    assert naive.stored(store, store.rect).shape == (tiles.height, tiles.width)
    assert not store.planes[PLANE].cells.any()


def test_every_cell_has_an_address_of_its_own_and_every_tile_a_block():
    store = TileStore(CellRect(0, 0, 192, 128), INT16)
    addresses = store.planes[PLANE].column[:, None] + TILE * np.arange(128)
    assert np.array_equal(np.sort(addresses, axis=None), np.arange(192 * 128))
    for tx, ty in itertools.product(range(3), range(2)):
        tile = addresses[64 * tx : 64 * (tx + 1), 64 * ty : 64 * (ty + 1)]
        assert tile.max() - tile.min() == 64 * 64 - 1


@pytest.mark.parametrize("dtype", [np.dtype(np.int16), np.dtype(np.float64)])
def test_a_store_keeps_what_is_written(dtype):
    store, cells = filled(CellRect(-100, 30, 300, 200), 3000, dtype=dtype)
    assert_holds(store, cells)
    assert store.planes[PLANE].cells.dtype == dtype


@pytest.mark.parametrize(
    "beyond",
    [
        CellRect(500, 10, 20, 20),
        CellRect(-400, 10, 20, 20),
        CellRect(10, 700, 20, 20),
        CellRect(10, -900, 20, 20),
        CellRect(-500, -500, 1000, 1000),
        CellRect(100, 100, 200, 10),
    ],
)
def test_growth_moves_the_cells(beyond):
    old, cells = filled(CellRect(-30, 40, 150, 130), 2000)
    before = old.touched.copy()
    new = old.grown(beyond)
    new.take(old)
    assert new.rect.contains(old.rect)
    assert new.rect.contains(beyond)
    assert (new.rect.ix % 64, new.rect.iy % 64, new.rect.width % 64, new.rect.height % 64) == (0, 0, 0, 0)
    assert_holds(new, cells)
    assert new.tiles_used == old.tiles_used == np.count_nonzero(new.touched)
    assert np.array_equal(old.touched, before)
    write(new, beyond.ix, beyond.iy, 77)
    assert_holds(new, cells | {(beyond.ix, beyond.iy): 77})
    assert_holds(old, {})  # its memory is given back


def test_growth_leaves_room_only_where_it_grew():
    old = TileStore(CellRect(0, 0, 256, 128), INT16)
    assert old.grown(CellRect(250, 10, 10, 10)).rect == CellRect(0, 0, 448, 128)  # 260 + 256 / 2, in tiles
    assert old.grown(CellRect(-1, 10, 10, 10)).rect == CellRect(-192, 0, 448, 128)
    assert old.grown(CellRect(10, 128, 1, 1)).rect == CellRect(0, 0, 256, 256)
    assert old.grown(CellRect(10, -1, 1, 1)).rect == CellRect(0, -128, 256, 256)


def test_growth_step_by_step_copies_little():
    store, copied, growths = TileStore(CellRect(0, 0, 64, 64), INT16), 0, 0
    write(store, 0, 0, 1)
    for ix in range(0, 20_000, 16):
        cell = CellRect(ix, 0, 1, 1)
        if not store.rect.contains(cell):
            grown = store.grown(cell)
            copied, growths = copied + store.tiles_used, growths + 1
            grown.take(store)
            store = grown
        write(store, ix, 0, 1)
    assert store.tiles_used == 313
    assert growths < 20
    assert copied < 4 * store.tiles_used


def test_the_first_growth_of_an_empty_store_is_exact():
    store = TileStore(NOWHERE, INT16).grown(CellRect(5000, -5000, 10, 10))
    assert store.rect == CellRect(4992, -5056, 64, 128)
    store.take(TileStore(NOWHERE, INT16))
    assert not store.planes[PLANE].cells.any()


def test_tiles_and_bytes_are_counted():
    store, cells = filled(CellRect(0, 0, 640, 640), 40)
    tiles = {(i // 64, j // 64) for i, j in cells}
    assert store.tiles_used == len(tiles)
    assert store.nbytes == len(tiles) * 64 * 64 * 2 + 640 * 8 + 10 * 10 * 8
    for rect in (
        CellRect(0, 0, 640, 640),
        CellRect(63, 64, 2, 1),
        CellRect(130, 130, 1, 1),
        CellRect(100, 0, 300, 65),
    ):
        met = {
            (i, j)
            for i in range(rect.ix // 64, (rect.ix + rect.width - 1) // 64 + 1)
            for j in range(rect.iy // 64, (rect.iy + rect.height - 1) // 64 + 1)
        }
        assert store.untouched_tiles(rect) == len(met - tiles)


def test_untouched_tiles_of_a_store_that_does_not_begin_at_zero():
    store = TileStore(CellRect(-128, 64, 256, 64), INT16)
    write(store, -128, 64, 1)
    assert store.untouched_tiles(CellRect(-128, 64, 256, 64)) == 3
    assert store.untouched_tiles(CellRect(-65, 127, 1, 1)) == 0
    assert store.untouched_tiles(CellRect(-65, 127, 2, 1)) == 1


def resident():
    """Bytes of memory that this process has."""
    fields = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(fields["VmRSS"].split()[0]) * 1024


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the system does not tell")
def test_memory_comes_with_the_first_write():
    before = resident()
    store = TileStore(CellRect(0, 0, 16_384, 16_384), INT16)  # 512 MB
    for cell in range(0, 16_384, 64):
        write(store, cell, cell, 1)
    assert resident() - before < 64 * 1024**2


def test_no_address_space_is_a_limit():
    with pytest.raises(LimitReached, match="no address space"):
        TileStore(CellRect(0, 0, 2**31, 2**31), INT16)


def test_what_is_written_is_read_back_and_takes_only_the_tiles_it_needs():
    rng = np.random.default_rng(8)
    dense = rng.integers(-5, 5, (130, 200)).astype(np.int16)
    dense[:, 40:150] = 0
    store = TileStore(CellRect(-100, 30, 400, 300), INT16)
    rect = CellRect(-70, 50, 200, 130)
    store.write(rect, {PLANE: dense})
    assert np.array_equal(naive.stored(store, rect), dense)
    assert np.count_nonzero(store.planes[PLANE].cells) == np.count_nonzero(dense)
    rows, columns = np.nonzero(dense)
    tiles = set(zip((columns - 70 + 128) // 64, (rows + 50) // 64, strict=True))
    assert set(zip(*np.nonzero(store.touched), strict=True)) == tiles
    assert store.tiles_used == len(tiles)
    store.write(rect, {PLANE: dense})
    assert store.tiles_used == len(tiles)


def test_a_cell_of_minus_zero_is_written():
    store = TileStore(CellRect(0, 0, 64, 64), (Plane(PLANE, np.dtype(np.float64)),))
    dense = np.zeros((2, 2))
    dense[1, 0] = -0.0
    store.write(CellRect(3, 4, 2, 2), {PLANE: dense})
    assert store.tiles_used == 1
    assert np.signbit(naive.stored(store, CellRect(3, 4, 2, 2))).tolist() == [[False, False], [True, False]]


def test_the_first_cells_get_room_around_where_its_tables_are_a_small_part_of_the_memory():
    first = CellRect(5000, -5000, 10, 10)
    store = TileStore(NOWHERE, INT16).grown(first, max_bytes=2**31)
    for beyond in (CellRect(904, -9096, 1, 1), CellRect(9105, -895, 1, 1)):
        assert store.rect.contains(beyond)
    assert store.nbytes < 2**31 / 100
    assert TileStore(NOWHERE, INT16).grown(first, max_bytes=10**6).rect == CellRect(4992, -5056, 64, 128)
