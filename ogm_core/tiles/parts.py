"""Parts of a tile store: columns side by side, as kernels take a whole store, in the same memory.

Kernels that update count cells from a window's corner. They find the foot of its first column in the first
number of `column`, and in that how far inside its tile the window begins; `touched` begins with that tile.
"""

from collections.abc import Mapping
from typing import Any

from ogm_core.lattice import CellRect
from ogm_core.tiles.store import TILE, StoredPlane, TileStore


class StorePart:
    """Some columns of a store, for one thread. Where a tile is cut, two parts have it in their `touched`."""

    __slots__ = ("cells", "columns", "planes", "tiles_used", "touched")

    def __init__(self, store: TileStore, first: int, end: int) -> None:
        """The columns from number `first` up to `end`, which is not one of them."""
        self.touched = store.touched[first // TILE : -(-end // TILE)]
        self.planes: Mapping[str, StoredPlane] = {
            name: StoredPlane(cells, column[side * first : side * end], side)
            for name, (cells, column, side) in store.planes.items()
        }
        self.cells: tuple[Any, ...] = store.cells
        self.columns = tuple({plane.side: plane.column for plane in self.planes.values()}.values())
        self.tiles_used = 0
        """What kernels count here is no number of tiles: those that are cut may be counted twice."""


def part_of_window(window: CellRect, first: int, end: int) -> CellRect:
    """The cells of a window, which begins in the store's corner, that lie in these columns."""
    return CellRect(window.ix + first, window.iy, min(window.width, end) - first, window.height)
