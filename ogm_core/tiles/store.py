"""Tile store: a map's cells in memory, in column strips 64 cells wide.

    strip 0        strip 1              A strip holds 64 columns, row after row, so
    +--------+     +--------+
    | tile   |     | tile   |               address(i, j) = column[i] + 64 j
    +--------+     +--------+
    | tile   |     | tile   |           with a table `column` of one number a column: no tile look-up per
    +--------+     +--------+           cell, and every 64 x 64 tile is one contiguous block.

The memory is a private anonymous mapping: the system gives zeroed pages when they are first written, so a
stored 0 ("never updated", see cells.model) costs nothing until a beam comes by.

A map has one such memory a plane of its cell model. A plane twice as fine has 128 of its cells where the
others have 64, and its `column` counts in its own.
"""

import contextlib
import mmap
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.model import Plane, cell_bytes
from ogm_core.errors import SMALLER_MAP, LimitReached, NoRoom
from ogm_core.lattice import TILE, TILE_BITS, CellRect

__all__ = ["TILE", "TILE_BITS", "StoredPlane", "TileStore", "tile_bytes", "tiles_met"]

_TILE_CELLS = TILE * TILE
_FIRST_ROOM = 4096
"""Cells on every side of a map's first ones: most maps never have to be moved."""
_SMALL_PART = 100


class StoredPlane(NamedTuple):
    """A plane in memory: its cells, tile after tile in strips, and the address of each column's foot."""

    cells: NDArray[Any]
    column: NDArray[np.int64]
    side: int
    """How many of its cells lie along a side of a cell of the map, 1 or 2."""

    @property
    def tile_cells(self) -> int:
        """How many of its cells are in a tile."""
        return _TILE_CELLS * self.side**2

    def tiles(self, shape: tuple[int, ...]) -> NDArray[Any]:
        """Its cells, shape (tiles in x, tiles in y, cells of a tile), for a store of that many tiles."""
        return self.cells.reshape(*shape, self.tile_cells)


class TileStore:
    """The planes of a rectangle of whole tiles, all unknown at first. Owned by the map's one writer."""

    def __init__(self, rect: CellRect, planes: tuple[Plane, ...], within: CellRect | None = None) -> None:
        """Reserve room for every cell of `rect`, rounded outward to tiles.

        It lies `within` whole tiles, None: anywhere, and so will the stores that grow from it.

        Raises:
            LimitReached: the system refuses the address space.
        """
        tx, ty = rect.ix // TILE, rect.iy // TILE
        shape = -(-(rect.ix + rect.width) // TILE) - tx, -(-(rect.iy + rect.height) // TILE) - ty
        self.kinds = planes
        self._within = within
        self.rect = CellRect(tx * TILE, ty * TILE, shape[0] * TILE, shape[1] * TILE)
        self._memory: dict[str, mmap.mmap] = {}
        self.planes: Mapping[str, StoredPlane] = {plane.name: self._reserve(plane, shape) for plane in planes}
        self.cells = tuple(plane.cells for plane in self.planes.values())
        """The planes' cells, in order, for kernels that take them all."""
        self.columns = tuple({plane.side: plane.column for plane in self.planes.values()}.values())
        """The addresses of columns, for these kernels: of planes of side 1, of those of side 2."""
        self.touched: NDArray[np.int64] = np.zeros(shape, np.int64)
        """Revision that last wrote into each tile, shape (tiles in x, tiles in y); 0: never."""
        self.aged: NDArray[np.int64] | None = None
        """Revision at which each tile last aged in place (see tiles.aging), or was emptied; None: none was.

        0: never. What was emptied is `touched` no more, until it is written again.
        """
        self.current = 0, CellRect(0, 0, 0, 0)
        """A tick, by its revision, and a rectangle of cells whose tiles have missed none up to that one."""
        self.tiles_used = 0
        self.tile_bytes = tile_bytes(planes)
        """Memory of one tile, all planes together."""
        columns = sum(plane.column.nbytes for plane in self.planes.values())
        self._table_bytes = self.touched.nbytes + columns

    def _reserve(self, plane: Plane, shape: tuple[int, int]) -> StoredPlane:
        width = TILE * plane.side
        strip_cells = shape[1] * width * width
        memory = _untouched(shape[0] * strip_cells * plane.dtype.itemsize)
        self._memory[plane.name] = memory
        columns = np.arange(shape[0] * width)
        return StoredPlane(
            np.frombuffer(memory, plane.dtype, shape[0] * strip_cells),
            (columns // width) * strip_cells + columns % width,
            plane.side,
        )

    @property
    def revisions(self) -> NDArray[np.int64]:
        """Revision that each tile's cells are of: the last that wrote them, let them age, or emptied them."""
        return self.touched if self.aged is None else np.maximum(self.touched, self.aged)

    @property
    def nbytes(self) -> int:
        """Memory of the tiles that were ever written, and of the tables."""
        return self.tiles_used * self.tile_bytes + self._table_bytes

    def admitting(
        self, updated: CellRect, new_tiles: Callable[["TileStore"], int], max_bytes: int
    ) -> "TileStore":
        """This store, or a larger one in its place, with room for what a scan writes into `updated`.

        `new_tiles` counts those that it would write that were never written: it is asked only where a cheap
        bound does not do. A larger store holds this one's cells, and this one is spent.

        Raises:
            NoRoom: it would hold more than `max_bytes`; no cell has changed.
        """
        store = self if self.rect.contains(updated) else self.grown(updated, max_bytes)
        room = max(0, (max_bytes - store.nbytes) // store.tile_bytes)  # what is there stays, and is written
        if tiles_met(updated) > room and store.untouched_tiles(updated) > room:
            fresh = new_tiles(store)
            if fresh > room:
                raise NoRoom(
                    f"it needs {fresh} more tiles of {store.tile_bytes} bytes, for which "
                    f"mapper.max_bytes = {max_bytes} has no room: raise it, {SMALLER_MAP}",
                    "max_bytes",
                )
        if store is not self:
            store.take(self)
        return store

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
                    return self._reserving(roomy)
            return self._reserving(rect)
        west = self.rect.width // 2 if rect.ix < self.rect.ix else 0
        south = self.rect.height // 2 if rect.iy < self.rect.iy else 0
        wanted = self.rect.union(rect)
        east = self.rect.width // 2 if wanted.ix + wanted.width > self.rect.ix + self.rect.width else 0
        north = self.rect.height // 2 if wanted.iy + wanted.height > self.rect.iy + self.rect.height else 0
        roomy = CellRect(
            wanted.ix - west, wanted.iy - south, wanted.width + west + east, wanted.height + south + north
        )
        store: TileStore = self._reserving(roomy)
        dx, dy = store._tile_of(self)
        width, height = self.touched.shape
        store.touched[dx : dx + width, dy : dy + height] = self.touched
        if self.aged is not None:
            store.aged = np.zeros_like(store.touched)
            store.aged[dx : dx + width, dy : dy + height] = self.aged
        store.tiles_used = self.tiles_used
        return store

    def _reserving(self, rect: CellRect) -> "TileStore":
        """An empty store of the same planes over as much of `rect` as it may cover."""
        within = self._within
        return TileStore(rect if within is None else rect.intersection(within), self.kinds, within)

    def take(self, other: "TileStore") -> None:
        """Move every tile that was written in `other`, which this store was grown from, and nothing else.

        `other` is given back to the system strip by strip, so that growing takes no second map's memory.
        """
        dx, dy = self._tile_of(other)
        written = [np.flatnonzero(strip) for strip in other.touched]
        for name, plane in self.planes.items():
            source, target = other.planes[name].tiles(other.touched.shape), plane.tiles(self.touched.shape)
            for tx, rows in enumerate(written):
                for ty in rows:
                    target[tx + dx, ty + dy] = source[tx, ty]
                other.give_back(name, tx * len(other.touched[tx]), len(other.touched[tx]))

    def give_back(self, name: str, first: int, count: int) -> bool:
        """Give the memory of some tiles of a plane, in strips from `first` on, back to the system.

        Their cells then read 0; False: nothing was done, as they do not fill its pages.
        """
        plane = self.planes[name]
        size = plane.tile_cells * plane.cells.itemsize
        if not hasattr(mmap, "MADV_DONTNEED") or (first * size | count * size) % mmap.PAGESIZE:
            return False
        self._memory[name].madvise(mmap.MADV_DONTNEED, first * size, count * size)
        return True

    def empty(self, tx: NDArray[np.int64], ty: NDArray[np.int64], revision: int) -> None:
        """Make tiles unknown, in a revision, which take no memory then: as if they had never been written."""
        self.tiles_used -= int(np.count_nonzero(self.touched[tx, ty]))
        self.touched[tx, ty] = 0
        if self.aged is None:
            self.aged = np.zeros_like(self.touched)
        self.aged[tx, ty] = revision
        for place in (tx * self.touched.shape[1] + ty).tolist():
            for name, plane in self.planes.items():
                if not self.give_back(name, place, 1):
                    plane.cells.reshape(-1, plane.tile_cells)[place] = 0

    def write(self, rect: CellRect, planes: Mapping[str, NDArray[Any]]) -> None:
        """Put the cells of `rect` in place: each plane's [iy, ix]; what lies outside is left out.

        Only tiles in which a number is not 0 are written; their revision is that of a first scan.
        """
        left, bottom = rect.ix - self.rect.ix, rect.iy - self.rect.iy
        for tx, ty in np.ndindex(*self.touched.shape):
            west, south = max(left, tx * TILE), max(bottom, ty * TILE)
            east = min(left + rect.width, (tx + 1) * TILE)
            north = min(bottom + rect.height, (ty + 1) * TILE)
            if west >= east or south >= north:
                continue
            for name, plane in self.planes.items():
                n = plane.side
                part = planes[name][
                    (south - bottom) * n : (north - bottom) * n, (west - left) * n : (east - left) * n
                ]
                if not part.view(f"i{part.itemsize}").any():
                    continue
                tile = plane.tiles(self.touched.shape)[tx, ty].reshape(TILE * n, TILE * n)
                rows = slice((south - ty * TILE) * n, (north - ty * TILE) * n)
                tile[rows, (west - tx * TILE) * n : (east - tx * TILE) * n] = part
                self.tiles_used += int(self.touched[tx, ty] == 0)
                self.touched[tx, ty] = 1

    def put(self, tiles: Iterable[tuple[int, int, int, Mapping[str, NDArray[Any]], str]]) -> None:
        """Put whole tiles in place: (tx, ty) on the lattice, revision, cells of each plane, and whose.

        Raises:
            IndexError: one of them lies outside this store.
        """
        left, bottom = self.rect.ix // TILE, self.rect.iy // TILE
        places = {name: plane.tiles(self.touched.shape) for name, plane in self.planes.items()}
        for tx, ty, revision, cells, *_ in tiles:
            x, y = tx - left, ty - bottom
            if x < 0 or y < 0:
                raise IndexError(f"tile ({tx}, {ty})")
            self.tiles_used += int(self.touched[x, y] == 0)
            self.touched[x, y] = revision
            for name, place in places.items():
                place[x, y] = cells[name]

    def _tile_of(self, other: "TileStore") -> tuple[int, int]:
        """Tile of this store that holds the lower-left cell of `other`."""
        return (other.rect.ix - self.rect.ix) // TILE, (other.rect.iy - self.rect.iy) // TILE

    def untouched_tiles(self, rect: CellRect) -> int:
        """How many of the tiles that `rect`, which lies inside, meets were never written."""
        left, bottom = rect.ix - self.rect.ix, rect.iy - self.rect.iy
        right, top = left + rect.width - 1, bottom + rect.height - 1
        met = self.touched[left // TILE : right // TILE + 1, bottom // TILE : top // TILE + 1]
        return met.size - int(np.count_nonzero(met))


def tile_bytes(planes: tuple[Plane, ...]) -> int:
    """Memory of one tile of these planes together."""
    return _TILE_CELLS * sum(map(cell_bytes, planes))


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
