"""Counted copy: the occupancy grid map that a copy of counts stands for, as its mapper serves it."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_client.errors import BadReply
from ogm_client.map_grid import MapGrid
from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.model import Plane
from ogm_core.cells.rate import Rate
from ogm_core.lattice import CellRect
from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.store import TILE
from ogm_core.wire.map_update import MapUpdate

NAME = Rate().described["name"]
Tiles = Mapping[tuple[int, int], Mapping[str, NDArray[Any]]]
_BYTES_A_CELL = sum(plane.side**2 * plane.dtype.itemsize for plane in Rate.planes) + 4 * 2**2
"""Of the counts, and of the log odds of four halves."""


def counted_grid(newest: MapUpdate, tiles: Tiles, max_bytes: int) -> MapGrid:
    """The map of these tiles, at the newest update, in the finest cells that counts tell of.

    Raises:
        BadReply: they are no such counts, or take more than `max_bytes`.
    """
    if newest.planes != Rate.planes:
        told = ", ".join(plane.name for plane in newest.planes)
        raise BadReply(f"map.tiles: counts of {NAME} in other planes than known here: {told}")
    extent = newest.extent
    size = extent.cells * _BYTES_A_CELL
    if size > max_bytes:
        raise BadReply(f"map.tiles: its cells take {size} bytes, at most {max_bytes} are allowed")
    planes = {plane.name: _laid_out(plane, tiles, extent) for plane in newest.planes}
    stored = CellArrays(planes, {plane.name: plane.side for plane in newest.planes})
    snapshot = MapSnapshot(
        *(stored, Rate(), newest.lattice, (extent.ix, extent.iy)),
        epoch=newest.epoch,
        revision=newest.revision,
        stamp=newest.stamp,
        run=newest.run,
    )
    return MapGrid.from_snapshot(snapshot.finest())


def _laid_out(plane: Plane, tiles: Tiles, extent: CellRect) -> NDArray[Any]:
    """A plane of the extent's cells, [iy, ix]."""
    n = plane.side
    laid_out = np.zeros((extent.height * n, extent.width * n), plane.dtype)
    for (tx, ty), cells in tiles.items():
        rect = CellRect(tx * TILE, ty * TILE, TILE, TILE)
        part = rect.intersection(extent)
        if part.cells:
            numbers = cells[plane.name].reshape(TILE * n, TILE * n)
            laid_out[_window(part, extent, n)] = numbers[_window(part, rect, n)]
    return laid_out


def _window(part: CellRect, whole: CellRect, n: int) -> tuple[slice, slice]:
    """Where a part lies in what it is part of, rows and columns of n numbers a cell."""
    x, y = (part.ix - whole.ix) * n, (part.iy - whole.iy) * n
    return slice(y, y + part.height * n), slice(x, x + part.width * n)
