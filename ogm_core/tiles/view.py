"""The cells of a map's snapshot, as copies of tiles: laid out only where somebody asks for them."""

import threading
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.model import Encoder, StoredCells
from ogm_core.lattice import CellRect
from ogm_core.pictures.map_picture import MapPicture
from ogm_core.pictures.png import write_png
from ogm_core.tiles.copies import TileCopies
from ogm_core.tiles.store import TILE

Pictures = dict[Encoder, MapPicture]
"""The pictures of a map that have been asked for, by palette; all its snapshots share them."""


class TileView:
    """Stored cells of a rectangle, [iy, ix], row 0 south (an `ogm_core.snapshot.CellSource`). Any thread."""

    def __init__(self, tiles: TileCopies, rect: CellRect, dtype: np.dtype[Any], pictures: Pictures) -> None:
        """Cells of `rect`, which lies in `tiles`."""
        self.tiles = tiles
        self.dtype = dtype
        self._rect = rect
        self._pictures = pictures
        self._lock = threading.Lock()
        self._dense: StoredCells | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self._rect.height, self._rect.width

    def __getitem__(self, part: tuple[slice, slice]) -> StoredCells:
        if self._dense is not None:
            return self._dense[part]
        (south, north, _), (west, east, _) = (
            cut.indices(size) for cut, size in zip(part, self.shape, strict=True)
        )
        return self._laid_out(
            CellRect(self._rect.ix + west, self._rect.iy + south, max(east - west, 0), max(north - south, 0))
        )

    def dense(self) -> StoredCells:
        """All of them in one array, the same for all who ask."""
        with self._lock:
            if self._dense is None:
                self._dense = self._laid_out(self._rect)
            return self._dense

    def known_cells(self) -> int:
        """How many cells were ever updated, counted tile by tile: nothing is laid out."""
        numbers, count = self.tiles.numbers, 0
        for tiles, _, rows in self.tiles.find(numbers[numbers > 0]):
            # As integers: a known zero of float64 cells is stored as -0.0 (see cells.log_odds).
            count += _count_known(tiles.view(f"i{tiles.itemsize}"), rows)
        return count

    def value_counts(self) -> NDArray[np.int64]:
        """How often each stored int16 cell occurs, shape (65536,), by its bits; not counted is 0, unknown."""
        numbers, counts = self.tiles.numbers, np.zeros(2**16, np.int64)
        for tiles, _, rows in self.tiles.find(numbers[numbers > 0]):
            _count_values(tiles, rows, counts)
        counts[0] = 0
        return counts

    def png(self, model: LogOdds, encoder: Encoder) -> bytes:
        """PNG of what `encoder` draws, north up; there is at least one cell."""
        if self.dtype != np.int16:
            return write_png(model.encode(self.dense(), encoder)[::-1])
        picture = self._pictures.get(encoder)
        if picture is None:
            picture = self._pictures.setdefault(encoder, MapPicture(model.table(encoder)))
        return picture.png(self.tiles, self._rect)

    def _laid_out(self, rect: CellRect) -> StoredCells:
        dense = np.zeros((rect.height, rect.width), self.dtype)
        frame = self.tiles.rect
        west, south = (rect.ix - frame.ix) // TILE, (rect.iy - frame.iy) // TILE
        east, north = (
            -((frame.ix - rect.ix - rect.width) // TILE),
            -((frame.iy - rect.iy - rect.height) // TILE),
        )
        numbers = self.tiles.numbers[west:east, south:north]
        tx, ty = np.nonzero(numbers)
        columns, rows = TILE * (tx + west) + frame.ix - rect.ix, TILE * (ty + south) + frame.iy - rect.iy
        for tiles, here, which in self.tiles.find(numbers[tx, ty]):
            _lay_out(tiles, which, columns[here], rows[here], dense)
        return dense


@njit(cache=True, nogil=True, error_model="numpy")
def _lay_out(
    tiles: NDArray[Any],
    which: NDArray[np.int64],
    columns: NDArray[np.int64],
    rows: NDArray[np.int64],
    dense: NDArray[Any],
) -> None:
    """Copy `tiles[which]` to where their lower-left cells have these columns and rows; cut what juts out."""
    height, width = dense.shape
    for k in range(len(which)):
        column = columns[k]
        west, east = max(0, -column), min(TILE, width - column)
        for r in range(max(0, -rows[k]), min(TILE, height - rows[k])):
            for c in range(west, east):
                dense[rows[k] + r, column + c] = tiles[which[k], TILE * r + c]


@njit(cache=True, nogil=True, error_model="numpy")
def _count_known(tiles: NDArray[Any], which: NDArray[np.int64]) -> int:
    """How many cells of `tiles[which]`, as integers, are not 0."""
    count = 0
    for k in range(len(which)):
        tile, known = tiles[which[k]], np.int32(0)
        for c in range(TILE * TILE):
            known += np.int32(tile[c] != 0)
        count += int(known)
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _count_values(tiles: NDArray[np.int16], which: NDArray[np.int64], counts: NDArray[np.int64]) -> None:
    """Add to `counts`, by a cell's bits, how often each occurs in `tiles[which]`."""
    for k in range(len(which)):
        for c in range(TILE * TILE):
            counts[np.uint16(tiles[which[k], c])] += 1
