"""Aging: cells of tiles as the ticks (see cells.forgetting) leave them that passed since they were written.

A tick touches no tile. The revision that a tile's cells are of tells which ticks they have missed: those of
later revisions. They are made up for in place when a scan next writes thereabouts, and in the copy of a tile
that is made for a reader. A tile that has aged is still the same: it is not stored again.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.model import CellModel, Planes
from ogm_core.lattice import CellRect
from ogm_core.tiles.store import TILE, TileStore

_AT_ONCE = 64
"""Tiles: few enough to stay in the processor's cache, and to take little memory on the way."""


@dataclass(frozen=True, slots=True, eq=False)
class Aging:
    """The ticks that have passed in a map's life, and what its cell model makes of cells that missed some."""

    ticks: NDArray[np.int64]
    """The revisions at which they passed, rising; at least one."""
    model: CellModel

    @classmethod
    def by(cls, ticks: tuple[int, ...], model: CellModel) -> "Aging | None":
        """None while no tick has passed."""
        return cls(np.array(ticks, np.int64), model) if ticks else None

    @property
    def last(self) -> int:
        """The revision of the last tick."""
        return int(self.ticks[-1])

    def apply(self, planes: Planes, revisions: NDArray[np.int64]) -> None:
        """Let tiles age that are of these revisions: arrays of shape (n, cells of a tile), in place."""
        missed = len(self.ticks) - np.searchsorted(self.ticks, revisions, "right")
        for ticks in np.unique(missed[missed > 0]).tolist():
            late = np.flatnonzero(missed == ticks)
            for begin in range(0, len(late), _AT_ONCE):
                which = late[begin : begin + _AT_ONCE]
                aged = self.model.decayed({name: cells[which] for name, cells in planes.items()}, ticks)
                for name, cells in planes.items():
                    cells[which] = aged[name]

    def age(self, store: TileStore, tx: NDArray[np.intp], ty: NDArray[np.intp], revision: int) -> None:
        """Let these tiles of a store age in place, while it comes to `revision`."""
        places = [(name, plane.tiles(store.touched.shape)) for name, plane in store.planes.items()]
        tiles = {name: place[tx, ty] for name, place in places}
        self.apply(tiles, store.revisions[tx, ty])
        for name, place in places:
            place[tx, ty] = tiles[name]
        if store.aged is None:
            store.aged = np.zeros_like(store.touched)
        store.aged[tx, ty] = revision

    def before_writing(self, store: TileStore, rect: CellRect, revision: int) -> None:
        """Let tiles that meet `rect`, in which a scan is about to write as `revision`, age.

        All of them: to find out, scan by scan, which it will write costs more than to let the others age.
        """
        last, current = store.current
        if last == self.last and current.contains(rect):
            return
        left, bottom = (rect.ix - store.rect.ix) // TILE, (rect.iy - store.rect.iy) // TILE
        width, height = rect.width // TILE + 2, rect.height // TILE + 2
        here = slice(left, left + width), slice(bottom, bottom + height)
        old = (store.touched[here] > 0) & (store.touched[here] < self.last)
        if store.aged is not None:
            old &= store.aged[here] < self.last
        if old.any():
            tx, ty = np.nonzero(old)
            self.age(store, tx + left, ty + bottom, revision)
        corner = store.rect.ix + left * TILE, store.rect.iy + bottom * TILE
        store.current = self.last, CellRect(*corner, width * TILE, height * TILE)


def aged_revisions(
    touched: NDArray[np.int64], copied: NDArray[np.int64], ticks: Iterable[int]
) -> NDArray[np.int64]:
    """The revisions that copies of tiles are of.

    `touched` says when each tile was written, `copied` when it was copied: at a tick every known tile's
    revision becomes the tick's, and a copy has aged by those before it. 0 where a tile was never written.
    """
    passed = np.array((0, *ticks), np.int64)
    of, written = np.zeros_like(touched), touched > 0  # of many tiles there are, few ever are
    last = passed[np.searchsorted(passed, copied[written], "right") - 1]
    of[written] = np.maximum(touched[written], last)
    return of
