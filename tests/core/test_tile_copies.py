"""Copies of tiles: what they hold, what they share, and that nothing changes them."""

import numpy as np
import pytest

import naive
from ogm_core.cells.log_odds import PLANE
from ogm_core.cells.model import Plane
from ogm_core.lattice import CellRect
from ogm_core.tiles.copies import copy_tiles, room_for
from ogm_core.tiles.store import TILE, TileStore
from ogm_core.tiles.view import TileView

INT16, FLOAT64 = np.dtype(np.int16), np.dtype(np.float64)


class Desk:
    """A store, its revision, and writers of cells."""

    def __init__(self, rect, dtype=INT16, seed=0):
        self.store = TileStore(rect, (Plane(PLANE, np.dtype(dtype)),))
        self.revision = 0
        self.rng = np.random.default_rng(seed)

    def write(self, *cells):
        """One more revision: these cells, or 30 of a random square; the store grows if need be."""
        self.revision += 1
        for ix, iy in cells or self._square():
            if not self.store.rect.contains(CellRect(ix, iy, 1, 1)):
                grown = self.store.grown(CellRect(ix, iy, 1, 1))
                grown.take(self.store)
                self.store = grown
            i, j = ix - self.store.rect.ix, iy - self.store.rect.iy
            self.store.planes[PLANE].cells[self.store.planes[PLANE].column[i] + TILE * j] = self.rng.integers(
                1, 30_000
            )
            self.store.touched[i // TILE, j // TILE] = self.revision

    def _square(self):
        corner = self.rng.integers(-300, 300, 2)
        return (corner + self.rng.integers(0, 100, (30, 2))).tolist()

    def cells(self):
        """What is in the store, by the slow way."""
        return naive.stored(self.store, self.store.rect)

    def copy(self, before=None):
        return copy_tiles(self.store, self.revision, before)


def cells_of(copies, dtype=INT16, rect=None):
    return TileView(copies, rect or copies.rect, (Plane(PLANE, np.dtype(dtype)),)).planes()[PLANE]


@pytest.mark.parametrize("dtype", [INT16, FLOAT64])
def test_every_copy_is_the_store_at_its_revision_for_ever(dtype):
    desk, copies, kept = Desk(CellRect(0, 0, 0, 0), dtype), None, []
    for step in range(120):
        desk.write()
        if step % 3:
            copies = desk.copy(copies)
            kept.append((copies, desk.cells()))
    assert desk.store.rect.ix < -256
    assert desk.store.rect.iy < -256
    for copies, cells in kept:
        assert copies.revision <= 120
        assert np.array_equal(cells_of(copies, dtype), cells)


def test_only_what_was_written_since_is_copied():
    desk = Desk(CellRect(0, 0, 640, 640))
    desk.write(*((64 * i, 64 * j) for i in range(8) for j in range(5)))
    first = desk.copy()
    desk.write((64, 64), (65, 127), (640 - 1, 640 - 1))
    second = desk.copy(first)
    assert second.blocks[0].planes[PLANE] is first.blocks[0].planes[PLANE]
    assert [len(block.planes[PLANE]) for block in second.blocks] == [40, 2]
    same = second.numbers == first.numbers
    assert np.argwhere(~same).tolist() == [[1, 1], [9, 9]]
    assert np.count_nonzero(second.numbers) == 41
    third = desk.copy(second)
    assert third.blocks == second.blocks
    assert np.array_equal(third.numbers, second.numbers)


def test_growth_keeps_what_was_copied():
    desk = Desk(CellRect(0, 0, 128, 64))
    desk.write((0, 0), (64, 0))
    first = desk.copy()
    desk.write((-1, -1), (500, 300))
    second = desk.copy(first)
    assert second.blocks[0].planes[PLANE] is first.blocks[0].planes[PLANE]
    tx, ty = -second.rect.ix // TILE, -second.rect.iy // TILE
    assert second.numbers[tx : tx + 2, ty].tolist() == first.numbers[:, 0].tolist() == [1, 2]
    assert np.array_equal(cells_of(second), desk.cells())


def test_old_blocks_are_given_up_before_they_take_more_room_than_the_tiles():
    desk, copies = Desk(CellRect(-320, -320, 750, 750), seed=3), None
    for _ in range(300):
        desk.write()
        copies = desk.copy(copies)
        held = sum(len(block.planes[PLANE]) for block in copies.blocks)
        assert held <= 2 * np.count_nonzero(copies.numbers)
        for block in copies.blocks:
            used = np.count_nonzero((copies.numbers >= block.first) & (copies.numbers < block.end))
            assert 2 * used >= len(block.planes[PLANE])
            assert used == block.used
    assert np.array_equal(cells_of(copies), desk.cells())


@pytest.mark.parametrize("written", [1, 5, 40, 200])
def test_what_was_made_ready_takes_no_more_than_half_again_of_what_is_copied(written):
    """A copy a scan, as of a robot that drives along a corridor."""
    desk, copies = Desk(CellRect(0, 0, 64, 64 * 900)), None
    for k in range(4):
        desk.write(*((0, 64 * (k * written + i)) for i in range(written)))
        copies = copy_tiles(desk.store, desk.revision, copies, room_for(desk.store, copies))
    blocks = [block.planes[PLANE] for block in copies.blocks]
    held = sum((block if block.base is None else block.base).nbytes for block in blocks)
    assert 4 * written * 8192 <= held <= 1.5 * 4 * written * 8192


def test_nobody_can_write_into_a_copy():
    desk = Desk(CellRect(0, 0, 64, 64))
    desk.write((3, 4))
    copies = desk.copy()
    for array in (copies.numbers, copies.blocks[0].planes[PLANE]):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 5


def test_cells_that_a_map_begins_with_and_those_of_its_first_scan():
    desk = Desk(CellRect(0, 0, 128, 64))
    dense = np.zeros((64, 128), np.int16)
    dense[5, 70] = 9
    desk.store.write(desk.store.rect, {PLANE: dense})  # as of revision 1; the map is at 0
    first = desk.copy()
    desk.write((70, 6))  # revision 1
    second = desk.copy(first)
    assert cells_of(first)[:, 70].nonzero()[0].tolist() == [5]
    assert cells_of(second)[:, 70].nonzero()[0].tolist() == [5, 6]


def test_a_store_without_cells():
    desk = Desk(CellRect(0, 0, 0, 0))
    copies = desk.copy()
    assert (copies.numbers.shape, copies.blocks) == ((0, 0), ())
    desk.write((1000, -1000))
    after = desk.copy(copies)
    assert np.array_equal(cells_of(after), desk.cells())
    assert cells_of(after).any()


@pytest.mark.parametrize("dtype", [INT16, FLOAT64])
def test_any_part_can_be_laid_out(dtype):
    desk = Desk(CellRect(0, 0, 0, 0), dtype, seed=5)
    copies = None
    for _ in range(20):
        desk.write()
        copies = desk.copy(copies)
    whole, frame = desk.cells(), desk.store.rect
    for _ in range(100):
        west, east = sorted(desk.rng.choice(frame.width + 1, 2, replace=False).tolist())
        south, north = sorted(desk.rng.choice(frame.height + 1, 2, replace=False).tolist())
        rect = CellRect(frame.ix + west, frame.iy + south, east - west, north - south)
        part = TileView(copies, rect, (Plane(PLANE, np.dtype(dtype)),))
        expected = whole[south:north, west:east]
        assert part.shape == expected.shape
        cuts = slice(1, rect.height // 2), slice(rect.width // 3, rect.width)
        assert np.array_equal(part.planes(*cuts)[PLANE], expected[cuts])
        assert np.array_equal(part.planes()[PLANE], expected)
        assert part.planes()[PLANE] is part.planes()[PLANE]
        assert np.array_equal(part.planes(*cuts)[PLANE], expected[cuts])
