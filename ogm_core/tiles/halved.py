"""Halved tiles: a copy's tiles on the lattice of the halves of their cells, as pictures of tiles need them.

Every tile of the copy is four of 64 x 64 halves, with the same number and the same revision.
"""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.halves import Halves, halved
from ogm_core.cells.model import CellSource, Planes
from ogm_core.lattice import CellRect
from ogm_core.tiles.copies import TileCopies
from ogm_core.tiles.view import TiledCells, TiledView, TileView


class HalvedTiles:
    """The tiles of a copy (a `tiles.view.TiledCells`), four for each of them."""

    def __init__(self, tiles: TileCopies) -> None:
        self._tiles = tiles
        self.rect = doubled(tiles.rect)
        self.revision, self.lineage = tiles.revision, tiles.lineage

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        """Of every tile its number in the copy, shape (tiles in x, tiles in y); 0: never written."""
        return _four(self._tiles.numbers)

    def revisions(self, columns: slice, rows: slice) -> NDArray[np.int64]:
        """Of some tiles the revision since which each is as it is; -1 where none was written."""
        around = (slice(part.start // 2, -(-part.stop // 2)) for part in (columns, rows))
        inner = (slice(part.start % 2, part.start % 2 + part.stop - part.start) for part in (columns, rows))
        return _four(self._tiles.revisions(*around))[tuple(inner)]


class HalvedView:
    """The halves of a view (a `tiles.view.TiledView`). Any thread."""

    def __init__(self, view: TileView) -> None:
        self._view = view
        self.rect = doubled(view.rect)
        self.tiles: TiledCells = HalvedTiles(view.tiles)

    def window(self, rect: CellRect, margin: int = 0) -> Planes:
        """The planes of any halves of the lattice, also of those outside; 0 where nothing was written."""
        wanted = rect.widened(margin)
        ix, iy = wanted.ix // 2, wanted.iy // 2
        right, top = -(-(wanted.ix + wanted.width) // 2), -(-(wanted.iy + wanted.height) // 2)
        rows, columns = (
            slice(first - 2 * begin, first - 2 * begin + length)
            for first, begin, length in ((wanted.iy, iy, wanted.height), (wanted.ix, ix, wanted.width))
        )
        return halved(self._view.window(CellRect(ix, iy, right - ix, top - iy)), rows, columns)

    def side_by_side(self, numbers: NDArray[np.int64]) -> Planes:
        """Refuse: halves are published with those around them."""
        raise NotImplementedError(f"{len(numbers)} tiles of halves have no values without their surroundings")


def tiled(stored: CellSource) -> TiledView | None:
    """A live map's cells or halves with their tiles; None of others, as of a picture that was shrunk."""
    if isinstance(stored, Halves):
        view = stored.source
        if isinstance(view, TileView) and stored.shape == (2 * view.shape[0], 2 * view.shape[1]):
            return HalvedView(view)
        return None
    return stored if isinstance(stored, TileView) else None


def doubled(rect: CellRect) -> CellRect:
    """The halves of a rectangle of cells."""
    return CellRect(*(2 * length for length in rect))


def _four(table: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.repeat(np.repeat(table, 2, axis=0), 2, axis=1)
