"""Where a map's cells lie in memory: column strips, 64 cells wide.

    strip 0        strip 1              A strip holds 64 columns, row after row, so
    +--------+     +--------+
    | tile   |     | tile   |               address(i, j) = column[i] + 64 j
    +--------+     +--------+
    | tile   |     | tile   |           with a table `column` of one number a column: no tile look-up per
    +--------+     +--------+           cell, and every 64 x 64 tile is one contiguous block.

The memory is a private anonymous mapping: the system gives zeroed pages when they are first written, so a
stored 0 ("never updated", see cells.log_odds) costs nothing until a beam comes by.
"""

import contextlib
import mmap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import LimitReached
from ogm_core.lattice import CellRect

TILE_BITS = 6
TILE = 1 << TILE_BITS
"""Tiles are 64 cells wide and high."""
_TILE_CELLS = TILE * TILE
_FIRST_ROOM = 4096
"""Cells on every side of a map's first ones: most maps never have to be moved."""
_SMALL_PART = 100


class TileStore:
    """Cells of a rectangle of whole tiles, all unknown at first. Owned by the map's one writer."""

    def __init__(self, rect: CellRect, dtype: np.dtype[Any]) -> None:
        """Reserve room for every cell of `rect`, rounded outward to tiles.

        Raises:
            LimitReached: the system refuses the address space.
        """
        tx, ty = rect.ix // TILE, rect.iy // TILE
        shape = -(-(rect.ix + rect.width) // TILE) - tx, -(-(rect.iy + rect.height) // TILE) - ty
        self.rect = CellRect(tx * TILE, ty * TILE, shape[0] * TILE, shape[1] * TILE)
        strip_cells = shape[1] * _TILE_CELLS
        self._memory = _untouched(shape[0] * strip_cells * dtype.itemsize)
        self.cells: NDArray[Any] = np.frombuffer(self._memory, dtype, shape[0] * strip_cells)
        columns = np.arange(self.rect.width)
        self.column: NDArray[np.int64] = (columns // TILE) * strip_cells + columns % TILE
        self.touched: NDArray[np.int64] = np.zeros(shape, np.int64)
        """Revision that last wrote into each tile, shape (tiles in x, tiles in y); 0: never."""
        self.tiles_used = 0

    @property
    def tile_bytes(self) -> int:
        """Memory of one tile."""
        return _TILE_CELLS * self.cells.itemsize

    @property
    def nbytes(self) -> int:
        """Memory of the tiles that were ever written, and of the tables."""
        return self.tiles_used * self.tile_bytes + self.column.nbytes + self.touched.nbytes

    def grown(self, rect: CellRect, max_bytes: int = 0) -> "TileStore":
        """A store that also covers `rect`, with room to spare where it grew; its cells follow by `take`.

        The first cells get much room around, unless its tables would be much of `max_bytes`: room for cells
        costs addresses, not memory.

        Room in proportion to the size keeps the sum of all copies linear in the final size. What it will hold
        is known before anything is copied.
        """
        if not self.rect.cells:
            roomy = CellRect(
                rect.ix - _FIRST_ROOM,
                rect.iy - _FIRST_ROOM,
                rect.width + 2 * _FIRST_ROOM,
                rect.height + 2 * _FIRST_ROOM,
            )
            if _table_bytes(roomy) * _SMALL_PART < max_bytes:
                with contextlib.suppress(LimitReached):  # no address space for that much
                    return TileStore(roomy, self.cells.dtype)
            return TileStore(rect, self.cells.dtype)
        west = self.rect.width // 2 if rect.ix < self.rect.ix else 0
        south = self.rect.height // 2 if rect.iy < self.rect.iy else 0
        wanted = self.rect.union(rect)
        east = self.rect.width // 2 if wanted.ix + wanted.width > self.rect.ix + self.rect.width else 0
        north = self.rect.height // 2 if wanted.iy + wanted.height > self.rect.iy + self.rect.height else 0
        roomy = CellRect(
            wanted.ix - west, wanted.iy - south, wanted.width + west + east, wanted.height + south + north
        )
        store = TileStore(roomy, self.cells.dtype)
        dx, dy = store._tile_of(self)
        width, height = self.touched.shape
        store.touched[dx : dx + width, dy : dy + height] = self.touched
        store.tiles_used = self.tiles_used
        return store

    def take(self, other: "TileStore") -> None:
        """Move every tile that was written in `other`, which this store was grown from, and nothing else.

        `other` is given back to the system strip by strip, so that growing takes no second map's memory.
        """
        dx, dy = self._tile_of(other)
        source = other.cells.reshape(*other.touched.shape, _TILE_CELLS)
        target = self.cells.reshape(*self.touched.shape, _TILE_CELLS)
        for tx in range(other.touched.shape[0]):
            for ty in np.flatnonzero(other.touched[tx]):
                target[tx + dx, ty + dy] = source[tx, ty]
            other.forget_strip(tx)

    def forget_strip(self, tx: int) -> None:
        """Give the memory of strip number `tx` back to the system; its cells read 0 from then on."""
        size = self.touched.shape[1] * self.tile_bytes
        if hasattr(mmap, "MADV_DONTNEED") and (tx * size) % mmap.PAGESIZE == 0:
            self._memory.madvise(mmap.MADV_DONTNEED, tx * size, size)

    def write(self, rect: CellRect, dense: NDArray[Any]) -> None:
        """Put the cells of `rect`, which lies inside, in place: shape (height, width), [iy, ix].

        Only tiles in which a cell is not 0 are written; their revision is that of a first scan.
        """
        left, bottom = rect.ix - self.rect.ix, rect.iy - self.rect.iy
        tiles = self.cells.reshape(*self.touched.shape, TILE, TILE)
        for tx, ty in np.ndindex(*self.touched.shape):
            west, south = max(left, tx * TILE), max(bottom, ty * TILE)
            east = min(left + rect.width, (tx + 1) * TILE)
            north = min(bottom + rect.height, (ty + 1) * TILE)
            if west >= east or south >= north:
                continue
            part = dense[south - bottom : north - bottom, west - left : east - left]
            if not part.view(f"i{part.itemsize}").any():
                continue
            tiles[tx, ty, south - ty * TILE : north - ty * TILE, west - tx * TILE : east - tx * TILE] = part
            self.tiles_used += int(self.touched[tx, ty] == 0)
            self.touched[tx, ty] = 1

    def _tile_of(self, other: "TileStore") -> tuple[int, int]:
        """Tile of this store that holds the lower-left cell of `other`."""
        return (other.rect.ix - self.rect.ix) // TILE, (other.rect.iy - self.rect.iy) // TILE

    def untouched_tiles(self, rect: CellRect) -> int:
        """How many of the tiles that `rect`, which lies inside, meets were never written."""
        left, bottom = rect.ix - self.rect.ix, rect.iy - self.rect.iy
        right, top = left + rect.width - 1, bottom + rect.height - 1
        met = self.touched[left // TILE : right // TILE + 1, bottom // TILE : top // TILE + 1]
        return met.size - int(np.count_nonzero(met))


def tiles_met(rect: CellRect) -> int:
    """How many tiles a rectangle may meet, wherever it lies on their lattice."""
    return (rect.width // TILE + 2) * (rect.height // TILE + 2)


def _table_bytes(rect: CellRect) -> int:
    """About the memory of a store's tables, eight bytes a column and a tile."""
    return 8 * (rect.width + tiles_met(rect))


def _untouched(size: int) -> mmap.mmap:
    """Zeroed memory of `size` bytes whose pages exist only once they are written."""
    try:
        memory = mmap.mmap(-1, max(size, 1), flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    except (OSError, OverflowError, MemoryError) as error:
        raise LimitReached(f"no address space for {size} bytes: {error}") from error
    if hasattr(mmap, "MADV_NOHUGEPAGE"):
        # A huge page would make 2 MB of the first cell that is written in it.
        memory.madvise(mmap.MADV_NOHUGEPAGE)
    return memory
