"""Erasing: cells of a tile store become unknown again, and where known cells are left is found anew."""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.lattice import CellRect
from ogm_core.tiles.aging import Aging
from ogm_core.tiles.polygon import Polygon
from ogm_core.tiles.store import TILE, TileStore


def erase(store: TileStore, area: Polygon, part: CellRect, revision: int, aging: Aging | None = None) -> int:
    """Make the cells of `area` in `part`, a rectangle, unknown; return how many were not.

    Tiles of the area age; those in which one was known are marked with `revision`.
    """
    part = part.intersection(store.rect).intersection(area.rect)
    if not part.cells:
        return 0
    west, south = part.ix - store.rect.ix, part.iy - store.rect.iy
    erased = 0
    for ty in range(south // TILE, (south + part.height - 1) // TILE + 1):
        low, high = max(south, ty * TILE), min(south + part.height, (ty + 1) * TILE)
        band = area.inside(CellRect(part.ix, low + store.rect.iy, part.width, high - low))
        for tx in np.flatnonzero(store.touched[:, ty]).tolist():
            left, right = max(west, tx * TILE), min(west + part.width, (tx + 1) * TILE)
            if left >= right or not band[:, left - west : right - west].any():
                continue
            wanted = np.zeros((TILE, TILE), np.bool_)
            rows, columns = (
                slice(low - ty * TILE, high - ty * TILE),
                slice(left - tx * TILE, right - tx * TILE),
            )
            wanted[rows, columns] = band[:, left - west : right - west]
            if aging is not None:
                aging.age(store, np.array([tx]), np.array([ty]), revision)
            count = _erase_in_tile(store, (tx, ty), wanted)
            if count:
                store.touched[tx, ty] = revision
                erased += count
    return erased


def written_rect(store: TileStore, aging: Aging | None = None) -> CellRect | None:
    """The smallest rectangle of the lattice with every cell that holds something; None if none does.

    What tiles would hold that have missed ticks, which stay as they are.
    """
    first, last = [], []
    for axis in (0, 1):
        lines = np.flatnonzero(store.touched.any(axis=1 - axis)).tolist()
        along = partial(_written_along, store, axis, aging=aging)
        low = next((cells for line in lines if (cells := along(line)).size), None)
        if low is None:
            return None
        high = next(cells for line in reversed(lines) if (cells := along(line)).size)
        first.append(int(low[0]))
        last.append(int(high[-1]))
    width, height = (end - begin + 1 for begin, end in zip(first, last, strict=True))
    return CellRect(store.rect.ix + first[0], store.rect.iy + first[1], width, height)


def _erase_in_tile(store: TileStore, tile: tuple[int, int], wanted: NDArray[np.bool_]) -> int:
    written = np.zeros_like(wanted)
    found = []
    for plane in store.planes.values():
        cells = _as_integers(plane.tiles(store.touched.shape))[tile].reshape(
            TILE, plane.side, TILE, plane.side
        )
        found.append(cells)
        written |= (cells != 0).any(axis=(1, 3))
    gone = written & wanted
    for cells in found:
        cells.transpose(0, 2, 1, 3)[gone] = 0
    return int(np.count_nonzero(gone))


def _written_along(store: TileStore, axis: int, line: int, aging: Aging | None) -> NDArray[np.intp]:
    """In a column of tiles (axis 0) the columns with a written cell, in a row of tiles (axis 1) the rows."""
    others = np.flatnonzero(store.touched.take(line, axis=axis))
    where = (np.full_like(others, line), others)[:: 1 if axis == 0 else -1]
    copied = {name: plane.tiles(store.touched.shape)[where] for name, plane in store.planes.items()}
    if aging is not None:
        aging.apply(copied, store.revisions[where])
    found = np.zeros(TILE, np.bool_)
    for name, plane in store.planes.items():
        tiles = _as_integers(copied[name]) != 0
        cells = tiles.reshape(len(others), TILE, plane.side, TILE, plane.side)
        found |= cells.any(axis=(0, 1, 2, 4) if axis == 0 else (0, 2, 3, 4))
    return np.flatnonzero(found) + line * TILE


def _as_integers(tiles: NDArray[Any]) -> NDArray[np.signedinteger]:
    """Cells by their bits: a known zero of float64 cells is stored as -0.0."""
    return tiles.view(np.dtype(f"i{tiles.itemsize}"))
