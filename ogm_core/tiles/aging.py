"""Aging: cells of tiles as the ticks (see cells.forgetting) leave them that passed since they were written.

A tick touches no tile. A tile's revision tells which ticks it has missed: those of later revisions. They are
made up for when it is next written, and in the copy of a tile when that is made for a reader. A tile whose
copy has aged counts as of the revision of the last tick that its copy has.
"""

from collections.abc import Callable, Iterable
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

    def age(
        self, store: TileStore, tx: NDArray[np.intp], ty: NDArray[np.intp], was: NDArray[np.int64]
    ) -> None:
        """Let these tiles of a store, which were of the revisions `was` till now, age."""
        shape = store.touched.shape
        places = {name: plane.tiles(shape) for name, plane in store.planes.items()}
        tiles = {name: place[tx, ty] for name, place in places.items()}
        self.apply(tiles, was)
        for name, place in places.items():
            place[tx, ty] = tiles[name]

    def before_writing(self, store: TileStore, rect: CellRect, mark: Callable[[], None]) -> None:
        """Let `mark` mark the tiles that are about to be written, all in `rect`, and those of them age.

        Unless no tile there has missed a tick: then `mark` need not.
        """
        left, bottom = (rect.ix - store.rect.ix) // TILE, (rect.iy - store.rect.iy) // TILE
        right, top = left + rect.width // TILE + 2, bottom + rect.height // TILE + 2
        touched = store.touched[left:right, bottom:top]
        was = touched.copy()
        old = (was > 0) & (was < self.last)
        if not old.any():
            return
        mark()
        tx, ty = np.nonzero(old & (touched != was))
        if len(tx):
            self.age(store, tx + left, ty + bottom, was[tx, ty])


def aged_revisions(
    touched: NDArray[np.int64], copied: NDArray[np.int64], ticks: Iterable[int]
) -> NDArray[np.int64]:
    """The revisions that copies of tiles are of.

    `touched` says when each tile was written, `copied` when it was copied: at a tick every known tile's
    revision becomes the tick's, and a copy has aged by those before it. 0 where a tile was never written.
    """
    passed = np.array((0, *ticks), np.int64)
    last = passed[np.searchsorted(passed, copied, "right") - 1]
    return np.where(touched > 0, np.maximum(touched, last), 0)
