"""Changes: the tiles of a copy that are not what they were at an earlier revision."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.lattice import CellRect
from ogm_core.tiles.copies import TileCopies
from ogm_core.tiles.store import TILE


class ChangedTiles(NamedTuple):
    """Tiles of one copy, in the order in which they lie in memory."""

    copies: TileCopies
    tx: NDArray[np.intp]
    ty: NDArray[np.intp]
    """Columns and rows of the copy's tables."""

    @classmethod
    def since(cls, copies: TileCopies, revision: int) -> "ChangedTiles":
        """The tiles that were written, or have aged, after `revision`; after 0 all that were ever written."""
        tx, ty = np.nonzero(copies.of > revision)
        order = np.argsort(copies.numbers[tx, ty])
        return cls(copies, tx[order], ty[order])

    def __len__(self) -> int:
        """How many there are."""
        return len(self.tx)

    def parts(self, most: int) -> Iterator["ChangedTiles"]:
        """The same tiles, `most` at a time; one part without any if there are none."""
        for first in range(0, max(len(self), 1), most):
            part = slice(first, first + most)
            yield ChangedTiles(self.copies, self.tx[part], self.ty[part])

    def meeting(self, rect: CellRect) -> "ChangedTiles":
        """Those of them in which a cell of `rect` lies."""
        x, y = (TILE * places for places in self.places.T)
        inside = (x < rect.ix + rect.width) & (x + TILE > rect.ix)
        inside &= (y < rect.iy + rect.height) & (y + TILE > rect.iy)
        return ChangedTiles(self.copies, self.tx[inside], self.ty[inside])

    @property
    def places(self) -> NDArray[np.int64]:
        """Which tiles of the lattice they are, (tx, ty): shape (n, 2)."""
        left, bottom = self.copies.rect.ix // TILE, self.copies.rect.iy // TILE
        return np.stack((self.tx + left, self.ty + bottom), axis=1).astype(np.int64)

    def planes(self) -> dict[str, NDArray[Any]]:
        """Their stored cells by plane: shape (n, cells of a tile), row after row."""
        found = self.copies.find(self.copies.numbers[self.tx, self.ty])
        if len(found) == 1:
            ((tiles, _, rows),) = found
            # Mostly: what has changed since the copy before is this one's newest block. Nobody writes it.
            if rows[-1] - rows[0] + 1 == len(rows):
                return {name: cells[rows[0] : rows[-1] + 1] for name, cells in tiles.items()}
        planes: dict[str, NDArray[Any]] = {}
        for tiles, here, rows in found:
            for name, cells in tiles.items():
                if name not in planes:
                    planes[name] = np.empty((len(self), cells.shape[1]), cells.dtype)
                # In order of their numbers those of a block are side by side.
                part = planes[name][here[0] : here[-1] + 1]
                np.take(cells, rows, axis=0, out=part, mode="clip")
        return planes
