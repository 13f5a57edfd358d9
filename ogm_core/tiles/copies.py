"""Copy-on-write tiles: copies that nobody changes any more, each of which copies only what has changed.

    copy of revision 7    copy of revision 8    A copy is a table of tiles, each with a number, and the blocks
    +---+---+---+         +---+---+---+         in which tiles of successive numbers lie. The next copy has a
    | 1 | 2 | 3 |         | 1 | 5 | 6 |         block more, of the tiles that were written since, and shares
    +---+---+---+         +---+---+---+         the others. Equal numbers are equal cells, and 0 is a tile
    | 0 | 4 | 0 |         | 0 | 4 | 0 |         that was never written.
    +---+---+---+         +---+---+---+

A block of which less than half is still in use is given up, and what is left of it copied with the rest; and
the memory of a block is at most half as large again as its tiles: a copy takes three times its tiles at most.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.lattice import CellRect
from ogm_core.tiles.aging import Aging, aged_revisions
from ogm_core.tiles.store import TILE, TileStore

_FEW = 32
"""So few tiles are copied into new memory: to make room for them beforehand gains nothing."""

Tiles = Mapping[str, NDArray[Any]]
"""Stored cells of n tiles by plane: shape (n, cells of a tile), row after row."""


class Block(NamedTuple):
    """Tiles with the numbers `first`, `first` + 1 and so on."""

    first: int
    planes: Tiles
    used: int
    """How many of them are in the copy's table."""

    @property
    def size(self) -> int:
        """How many tiles it has."""
        return len(next(iter(self.planes.values())))

    @property
    def end(self) -> int:
        """The number after its last tile's."""
        return self.first + self.size


@dataclass(frozen=True, slots=True, eq=False)
class TileCopies:
    """Every tile of a store as it was at one revision."""

    rect: CellRect
    """The cells under `numbers`."""
    numbers: NDArray[np.int64]
    """Shape (tiles in x, tiles in y), from the lower-left one."""
    copied: NDArray[np.int64]
    """Of the same shape: the revision at which each tile was copied, 0 where none was."""
    of: NDArray[np.int64]
    """Of the same shape: the revision that each tile's cells are of, as the store counts; 0: none."""
    blocks: tuple[Block, ...]
    """In order of their tiles' numbers."""
    revision: int
    next_number: int
    lineage: object
    """One object for all copies of a store and of those that grew from it: their numbers can be compared."""

    @property
    def nbytes(self) -> int:
        """Memory that the copy holds, what its tiles share with other copies included."""
        tiles = (plane for block in self.blocks for plane in block.planes.values())
        return 3 * self.numbers.nbytes + sum(
            (plane if plane.base is None else plane.base).nbytes for plane in tiles
        )

    def placed(self, rect: CellRect) -> NDArray[np.int64]:
        """`numbers` of the tiles of `rect`, which holds this one's; those of the others are 0."""
        return placed(self.numbers, self.rect, rect)

    def revisions(self, columns: slice, rows: slice) -> NDArray[np.int64]:
        """Of some tiles of `numbers`: the revision since which each is as it is; -1 where none was written.

        Within a lineage, equal revisions of a tile are equal cells. What a map begins with is of revision 0
        until the first scan is in; then it is of 1, as if that had written it.
        """
        of = self.of[columns, rows]
        return np.where(of == 0, -1, np.minimum(of, self.revision))

    def find(self, numbers: NDArray[np.int64]) -> list[tuple[Tiles, NDArray[np.intp], NDArray[np.int64]]]:
        """Where tiles of these numbers, none of them 0, lie.

        For each block: its tiles, which of `numbers` are there, and in which of its rows.
        """
        of_block = np.searchsorted([block.first for block in self.blocks], numbers, "right") - 1
        found = []
        for index in np.unique(of_block).tolist():
            here = np.flatnonzero(of_block == index)
            block = self.blocks[index]
            found.append((block.planes, here, numbers[here] - block.first))
        return found


def room_for(
    store: TileStore,
    before: TileCopies | None,
    aging: Aging | None = None,
    *,
    giving_up: bool = True,
    keeping_old: bool = False,
) -> Tiles:
    """Memory for the tiles that `copy_tiles`, with the same arguments, would copy now, and some more.

    It is there when it returns: copying into new memory takes many times longer than copying. Another thread
    may write the store meanwhile, since the number is a guess.
    """
    current = None if keeping_old else aging
    stale = int(np.count_nonzero(_to_copy(store, before, current, giving_up=giving_up)[3]))
    if stale <= _FEW:
        return {}
    return {
        name: np.full((stale + stale // 8 + 8, plane.tile_cells), 0, plane.cells.dtype)
        for name, plane in store.planes.items()
    }


def copy_tiles(
    store: TileStore,
    revision: int,
    before: TileCopies | None = None,
    room: Tiles | None = None,
    aging: Aging | None = None,
    *,
    giving_up: bool = True,
    keeping_old: bool = False,
) -> TileCopies:
    """Copy the tiles of `store`, now at `revision`; those not written since the copy `before` are shared.

    What is copied has aged, and so have the tiles that have missed a tick since they were copied: they are
    copied anew, unless `keeping_old`.

    `before` must be of the same store, or of one that it was grown from. The copies go into `room`, if that
    is large enough, and not much too large: a block keeps all of it. Without `giving_up` blocks are kept
    however little of them is in use, so that nothing is copied but what was written.

    If another thread writes the store meanwhile, the result is no copy of one revision, but may be the next
    one's `before`: what was written after `revision` is copied again.
    """
    current = None if keeping_old else aging
    numbers, copied, blocks, stale = _to_copy(store, before, current, giving_up=giving_up)
    first = 1 if before is None else before.next_number
    which = np.flatnonzero(stale)
    planes = _cells_of(store, which, room or {})
    if aging is not None:
        aging.apply(planes, store.revisions.reshape(-1)[which])
    numbers.reshape(-1)[which] = np.arange(first, first + len(which))
    copied.reshape(-1)[which] = revision
    of = np.array(store.revisions) if aging is None else aged_revisions(store.touched, copied, aging.ticks)
    for array in (*planes.values(), numbers, copied, of):
        array.flags.writeable = False
    if len(which):
        blocks = (*blocks, Block(first, planes, len(which)))
    lineage = object() if before is None else before.lineage
    end = first + len(which)
    return TileCopies(store.rect, numbers, copied, of, blocks, revision, end, lineage)


def uncopied_tiles(store: TileStore, before: TileCopies | None) -> int:
    """How many tiles have changed in place since the copy `before`."""
    return int(np.count_nonzero(store.revisions > _copied(store, before)))


def aged_tiles(store: TileStore, before: TileCopies | None, aging: Aging) -> int:
    """How many tiles have missed a tick since the copy `before`, or are not in it."""
    return int(np.count_nonzero((store.touched > 0) & (_copied(store, before) < aging.last)))


def _copied(store: TileStore, before: TileCopies | None) -> NDArray[np.int64]:
    """When each tile of a store was copied, 0 where it was not."""
    if before is None:
        return np.zeros_like(store.touched)
    return placed(before.copied, before.rect, store.rect)


class CopyAhead(NamedTuple):
    """What a copy made while another thread writes the store is made of, taken before it begins.

    It may hold tiles that were half written: they are of a later revision, and the next copy makes them anew.
    It counts for nothing if the store has grown meanwhile: cells have moved.
    """

    store: TileStore
    revision: int
    before: TileCopies | None
    aging: Aging | None
    keeping_old: bool = True

    def made(self) -> TileCopies:
        """The copy: any thread, while another writes."""
        return copy_tiles(
            *(self.store, self.revision, self.before, None, self.aging), keeping_old=self.keeping_old
        )


def _cells_of(store: TileStore, which: NDArray[np.intp], room: Tiles) -> dict[str, NDArray[Any]]:
    """Cells of some tiles of a store, by their places in its table; in `room`, if it is of the right size."""
    planes = {}
    for name, plane in store.planes.items():
        given = room.get(name)
        if given is None or not _fits(given, len(which), plane.cells.dtype):
            given = np.empty((len(which), plane.tile_cells), plane.cells.dtype)
        planes[name] = tiles = given[: len(which)]
        np.take(plane.cells.reshape(-1, plane.tile_cells), which, axis=0, out=tiles, mode="clip")
    return planes


def _fits(room: NDArray[Any], tiles: int, dtype: np.dtype[Any]) -> bool:
    return room.dtype == dtype and tiles <= len(room) <= tiles + tiles // 2


def _to_copy(
    store: TileStore, before: TileCopies | None, aging: Aging | None, *, giving_up: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64], tuple[Block, ...], NDArray[np.bool_]]:
    """Of a store's tiles: their numbers in the copy `before`, when they were copied, and which to copy now.

    And, third, the blocks of `before` that are kept. With `aging` tiles are copied that have missed a tick.
    """
    if before is None:
        nowhere, none = CellRect(store.rect.ix, store.rect.iy, 0, 0), np.zeros((0, 0), np.int64)
        before = TileCopies(nowhere, none, none, none, (), 0, 1, None)
    numbers, copied = before.placed(store.rect), placed(before.copied, before.rect, store.rect)
    # A map that begins with cells says that they are of revision 1 while it is still at 0: they count as
    # written since revision 0, however often they are copied.
    stale = store.revisions > copied
    if aging is not None:
        stale |= (store.touched > 0) & (copied < aging.last)
    return numbers, copied, kept_blocks(before.blocks, numbers, stale, giving_up=giving_up), stale


def kept_blocks(
    blocks: tuple[Block, ...], numbers: NDArray[np.int64], stale: NDArray[np.bool_], *, giving_up: bool
) -> tuple[Block, ...]:
    """Blocks that are half in use or more once tiles are `stale`; the rest of others becomes stale too.

    Without `giving_up` those that are in use at all.
    """
    gone = numbers[stale]
    of_block = np.searchsorted([block.first for block in blocks], gone[gone > 0], "right") - 1
    lost = np.bincount(of_block, minlength=len(blocks))
    kept = []
    for block, loss in zip(blocks, lost.tolist(), strict=True):
        used = block.used - loss
        if used and (2 * used >= block.size or not giving_up):
            kept.append(block._replace(used=used))
        elif used:
            stale |= (numbers >= block.first) & (numbers < block.end)
    return tuple(kept)


def placed(table: NDArray[Any], rect: CellRect, wider: CellRect) -> NDArray[Any]:
    """A table of the tiles of `rect`, with zeros for those that `wider`, a rectangle of tiles, adds."""
    whole = np.zeros((wider.width // TILE, wider.height // TILE), table.dtype)
    tx, ty = (rect.ix - wider.ix) // TILE, (rect.iy - wider.iy) // TILE
    whole[tx : tx + table.shape[0], ty : ty + table.shape[1]] = table
    return whole
