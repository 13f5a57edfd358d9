"""View of copied tiles as planes of a rectangle: laid out only where somebody asks for them."""

import threading
from typing import Any, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.model import CellSource, Plane, Planes
from ogm_core.lattice import CellRect
from ogm_core.tiles.copies import TileCopies
from ogm_core.tiles.store import TILE

_ALL = slice(None)


class TiledCells(Protocol):
    """Which tiles of a map there are, and of which revision."""

    @property
    def rect(self) -> CellRect:
        """The rectangle that the tiles fill."""

    @property
    def revision(self) -> int:
        """Of the copy."""

    @property
    def lineage(self) -> object:
        """See `TileCopies`."""

    @property
    def numbers(self) -> NDArray[np.int64]:
        """Of every tile its number in the copy, shape (tiles in x, tiles in y); 0: never written."""

    def revisions(self, columns: slice, rows: slice) -> NDArray[np.int64]:
        """Of some tiles the revision since which each is as it is; -1 where none was written."""


class TiledView(Protocol):
    """Cells of a map, and the tiles that they lie in."""

    @property
    def rect(self) -> CellRect:
        """The rectangle of what is served."""

    @property
    def tiles(self) -> TiledCells:
        """The tiles."""

    def window(self, rect: CellRect, margin: int = 0) -> Planes:
        """The planes of any cells of the lattice, also of those outside; 0 where nothing was written."""

    def side_by_side(self, numbers: NDArray[np.int64]) -> Planes:
        """The planes of tiles of these numbers, from left to right; 0 is a tile that was never written."""


class TileView:
    """The planes of a rectangle of cells (a `cells.model.CellSource`). Any thread."""

    def __init__(
        self, tiles: TileCopies, rect: CellRect, planes: tuple[Plane, ...], *, all_written: bool = True
    ) -> None:
        """Cells of `rect`, which lies in `tiles`; `all_written`: no cell outside it was ever written."""
        self.tiles = tiles
        self.rect = rect
        self._kinds = planes
        self._all_written = all_written
        self._lock = threading.Lock()
        self._whole: Planes | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rect.height, self.rect.width

    @property
    def nbytes(self) -> int:
        """Memory that the view holds besides its tiles: the whole, once somebody has asked for it."""
        return sum(plane.nbytes for plane in (self._whole or {}).values())

    def planes(self, rows: slice = _ALL, columns: slice = _ALL, margin: int = 0) -> Planes:
        """The planes of some rows and columns, with so many cells more on every side; 0 beyond the map.

        The whole rectangle without margin is the same arrays for all who ask.
        """
        rect = self._cut(rows, columns)
        if margin:
            return self.window(rect, margin)
        if rect == self.rect:
            with self._lock:
                if self._whole is None:
                    self._whole = self._laid_out(rect)
                return self._whole
        if self._whole is None:
            return self._laid_out(rect)
        x, y = rect.ix - self.rect.ix, rect.iy - self.rect.iy
        return {
            kind.name: self._whole[kind.name][
                y * kind.side : (y + rect.height) * kind.side, x * kind.side : (x + rect.width) * kind.side
            ]
            for kind in self._kinds
        }

    def window(self, rect: CellRect, margin: int = 0) -> Planes:
        """The planes of any cells of the lattice, also of those outside; 0 where nothing was written."""
        return self._laid_out(rect.widened(margin))

    def side_by_side(self, numbers: NDArray[np.int64]) -> Planes:
        """The planes of tiles of these numbers, from left to right; 0 is a tile that was never written."""
        written = np.flatnonzero(numbers)
        return self._dense(
            numbers[written], TILE * written, np.zeros_like(written), (TILE, TILE * len(numbers))
        )

    def part(self, rows: slice, columns: slice) -> CellSource:
        """The rectangle of some rows and columns; it is laid out when somebody asks for it."""
        return TileView(self.tiles, self._cut(rows, columns), self._kinds, all_written=False)

    def written(self, name: str) -> int:
        """How many numbers of a plane are not 0, bit for bit, counted tile by tile: nothing is laid out."""
        if not self._all_written:
            return CellArrays(self.planes()).written(name)
        numbers, count = self.tiles.numbers, 0
        for tiles, _, rows in self.tiles.find(numbers[numbers > 0]):
            # As integers: a known zero of float64 cells is stored as -0.0 (see cells.log_odds).
            count += _count_written(tiles[name].view(f"i{tiles[name].itemsize}"), rows)
        return count

    def value_counts(self, name: str) -> NDArray[np.int64]:
        """How often each value but 0 occurs in a plane of 16 bits: shape (65536,), by its bits."""
        if not self._all_written:
            return CellArrays(self.planes()).value_counts(name)
        numbers, counts = self.tiles.numbers, np.zeros(2**16, np.int64)
        for tiles, _, rows in self.tiles.find(numbers[numbers > 0]):
            _count_values(tiles[name].view(np.uint16), rows, counts)
        counts[0] = 0
        return counts

    def _cut(self, rows: slice, columns: slice) -> CellRect:
        (south, north, _), (west, east, _) = rows.indices(self.rect.height), columns.indices(self.rect.width)
        return CellRect(self.rect.ix + west, self.rect.iy + south, max(east - west, 0), max(north - south, 0))

    def _laid_out(self, rect: CellRect) -> Planes:
        frame = self.tiles.rect
        shape = self.tiles.numbers.shape
        west, south = max((rect.ix - frame.ix) // TILE, 0), max((rect.iy - frame.iy) // TILE, 0)
        east = min(-((frame.ix - rect.ix - rect.width) // TILE), shape[0])
        north = min(-((frame.iy - rect.iy - rect.height) // TILE), shape[1])
        numbers = self.tiles.numbers[west : max(east, west), south : max(north, south)]
        tx, ty = np.nonzero(numbers)
        columns, rows = TILE * (tx + west) + frame.ix - rect.ix, TILE * (ty + south) + frame.iy - rect.iy
        return self._dense(numbers[tx, ty], columns, rows, (rect.height, rect.width))

    def _dense(
        self, numbers: NDArray[np.int64], columns: NDArray[Any], rows: NDArray[Any], shape: tuple[int, int]
    ) -> Planes:
        """The planes of rows and columns with tiles of these numbers in these places, and 0 elsewhere."""
        found = self.tiles.find(numbers)
        planes = {}
        for name, dtype, side in self._kinds:
            dense = np.zeros((shape[0] * side, shape[1] * side), dtype)
            for tiles, here, which in found:
                _lay_out(tiles[name], which, columns[here] * side, rows[here] * side, dense, TILE * side)
            planes[name] = dense
        return planes


@njit(cache=True, nogil=True, error_model="numpy")
def _lay_out(
    tiles: NDArray[Any],
    which: NDArray[np.int64],
    columns: NDArray[np.int64],
    rows: NDArray[np.int64],
    dense: NDArray[Any],
    size: int,
) -> None:
    """Copy `tiles[which]`, `size` x `size` cells each, to these columns and rows; cut what juts out."""
    height, width = dense.shape
    for k in range(len(which)):
        tile = tiles[which[k]]
        column = columns[k]
        west, east = max(0, -column), min(size, width - column)
        for r in range(max(0, -rows[k]), min(size, height - rows[k])):
            row, first = dense[rows[k] + r], size * r
            for c in range(west, east):
                # Unsigned places spare numba's check for negative ones: rows are copied at memory speed.
                row[np.uint64(column + c)] = tile[np.uint64(first + c)]


@njit(cache=True, nogil=True, error_model="numpy")
def _count_written(tiles: NDArray[Any], which: NDArray[np.int64]) -> int:
    """How many cells of `tiles[which]`, as integers, are not 0."""
    count = 0
    for k in range(len(which)):
        tile, written = tiles[which[k]], np.int32(0)
        for c in range(tiles.shape[1]):
            written += np.int32(tile[c] != 0)
        count += int(written)
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _count_values(tiles: NDArray[np.uint16], which: NDArray[np.int64], counts: NDArray[np.int64]) -> None:
    """Add to `counts`, by a cell's bits, how often each occurs in `tiles[which]`."""
    for k in range(len(which)):
        for c in range(tiles.shape[1]):
            counts[tiles[which[k], c]] += 1
