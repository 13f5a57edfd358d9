"""Pasted tiles: copies whose tiles come from elsewhere, as those of a store come from its memory.

They are copies like others (see `tiles.copies`): nobody changes them, and what has not changed is shared.
What is pasted becomes a block of its own as it is, so whoever pastes must not write it any more.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ogm_core.lattice import CellRect
from ogm_core.tiles.copies import Block, TileCopies, Tiles, kept_blocks, placed
from ogm_core.tiles.store import TILE

NOWHERE = CellRect(0, 0, 0, 0)


def no_tiles() -> TileCopies:
    """Copies of a map in which nothing was ever written."""
    none = np.zeros((0, 0), np.int64)
    return TileCopies(NOWHERE, none, none, none, (), 0, 1, object())


def pasted(before: TileCopies, places: NDArray[np.int64], planes: Tiles, revision: int) -> TileCopies:
    """The copies with these tiles in place of those that were there, all of them written at `revision`.

    `places` are tiles (tx, ty) of the lattice, shape (n, 2), none of them twice. A revision is never below
    that of `before`.
    """
    if not len(places):
        return replace(before, revision=revision)
    rect = _with(before.rect, places)
    numbers, copied, of = (
        placed(table, before.rect, rect) for table in (before.numbers, before.copied, before.of)
    )
    here = places[:, 0] - rect.ix // TILE, places[:, 1] - rect.iy // TILE
    stale = np.zeros(numbers.shape, np.bool_)
    stale[here] = True
    blocks = kept_blocks(before.blocks, numbers, stale, giving_up=True)
    stale[here] = False
    moved = np.nonzero(stale)  # what is left of blocks that are given up
    first, end = before.next_number, before.next_number + len(places)
    if len(moved[0]):
        planes = _joined(planes, before, numbers[moved])
        numbers[moved] = np.arange(end, end + len(moved[0]))
        end += len(moved[0])
    numbers[here] = np.arange(first, first + len(places))
    copied[here] = of[here] = revision
    for table in (*planes.values(), numbers, copied, of):
        table.flags.writeable = False
    blocks = (*blocks, Block(first, planes, end - first))
    return TileCopies(rect, numbers, copied, of, blocks, revision, end, before.lineage)


def differing(before: TileCopies, places: NDArray[np.int64], planes: Tiles) -> NDArray[np.bool_]:
    """Which of these tiles (see `pasted`) are not in the copies, or have other cells there, bit for bit."""
    tx, ty = places[:, 0] - before.rect.ix // TILE, places[:, 1] - before.rect.iy // TILE
    inside = (tx >= 0) & (ty >= 0) & (tx < before.numbers.shape[0]) & (ty < before.numbers.shape[1])
    numbers = np.zeros(len(places), np.int64)
    numbers[inside] = before.numbers[tx[inside], ty[inside]]
    differ: NDArray[np.bool_] = numbers == 0
    held = np.flatnonzero(numbers)
    for tiles, here, rows in before.find(numbers[held]):
        for name, cells in planes.items():
            bits = f"i{cells.itemsize}"
            other = tiles[name].view(bits)[rows] != cells.view(bits)[held[here]]
            differ[held[here]] |= other.any(axis=1)
    return differ


def without(copies: TileCopies, which: NDArray[np.bool_]) -> TileCopies:
    """The copies without some of their tiles, as if these had never been written: of another lineage.

    `which` has the shape of the copies' tables. Memory of theirs is given back with the next pasting.
    """
    numbers, copied, of = (np.where(which, 0, table) for table in (copies.numbers, copies.copied, copies.of))
    for table in (numbers, copied, of):
        table.flags.writeable = False
    gone = copies.numbers[which]
    at = np.searchsorted([block.first for block in copies.blocks], gone[gone > 0], "right") - 1
    lost = np.bincount(at, minlength=len(copies.blocks)).tolist()
    blocks = tuple(
        block._replace(used=block.used - loss)
        for block, loss in zip(copies.blocks, lost, strict=True)
        if block.used > loss
    )
    return replace(copies, numbers=numbers, copied=copied, of=of, blocks=blocks, lineage=object())


def _with(rect: CellRect, places: NDArray[np.int64]) -> CellRect:
    """The smallest rectangle of tiles that holds `rect` and these tiles."""
    (west, south), (east, north) = places.min(axis=0).tolist(), places.max(axis=0).tolist()
    met = CellRect(TILE * west, TILE * south, TILE * (east - west + 1), TILE * (north - south + 1))
    return rect.union(met) if rect.cells else met


def _joined(planes: Tiles, before: TileCopies, numbers: NDArray[np.int64]) -> Tiles:
    """Planes of tiles, and behind them those of tiles of `before` with these numbers."""
    found = before.find(numbers)
    joined = {}
    for name, cells in planes.items():
        whole = np.empty((len(cells) + len(numbers), cells.shape[1]), cells.dtype)
        whole[: len(cells)] = cells
        for tiles, here, rows in found:
            whole[len(cells) + here] = tiles[name][rows]
        joined[name] = whole
    return joined
