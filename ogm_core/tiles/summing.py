"""Sums of tiles: those of one store made anew, each of the tiles of other stores in its place."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.model import Planes
from ogm_core.tiles.store import TILE, TileStore

_AT_ONCE = 64
"""So many tiles are summed together."""

Add = Callable[[Mapping[str, NDArray[Any]], Planes], None]
"""Adds the planes of some cells to those of as many others, in place (a cell model's `add`)."""


def sum_tiles(store: TileStore, places: NDArray[np.int64], others: Iterable[TileStore], add: Add) -> None:
    """Make tiles of `store` the sums of those of the others; zero where none of them was written.

    `places`, shape (n, 2), are tiles of the lattice, (tx, ty), all in `store`. What says of which revision
    they are stays.
    """
    others = list(others)
    for first in range(0, len(places), _AT_ONCE):
        some = places[first : first + _AT_ONCE]
        tx, ty = _within(store, some).T
        sums = {
            name: np.zeros((len(some), plane.tile_cells), plane.cells.dtype)
            for name, plane in store.planes.items()
        }
        for other in others:
            _add_tiles(sums, some, other, add)
        for name, plane in store.planes.items():
            plane.tiles(store.touched.shape)[tx, ty] = sums[name]


def written_tiles(store: TileStore) -> NDArray[np.int64]:
    """Tiles of the lattice, (tx, ty), that were ever written: shape (n, 2)."""
    return np.argwhere(store.touched) + _corner(store)


def revisions_at(store: TileStore, places: NDArray[np.int64]) -> NDArray[np.int64]:
    """Revision that last wrote into each of these tiles of the lattice, 0 where none did or none is there."""
    found = np.zeros(len(places), np.int64)
    here = _within(store, places)
    inside = ((here >= 0) & (here < store.touched.shape)).all(axis=1)
    found[inside] = store.touched[tuple(here[inside].T)]
    return found


def mark(store: TileStore, places: NDArray[np.int64], revision: int | NDArray[np.int64]) -> None:
    """Say that these tiles of the lattice, all in `store`, are of a revision, or each of its own."""
    tx, ty = _within(store, places).T
    store.tiles_used += int(np.count_nonzero(store.touched[tx, ty] == 0))
    store.touched[tx, ty] = revision


def empty(store: TileStore, places: NDArray[np.int64], revision: int) -> None:
    """Empty these tiles of the lattice, all in `store`, in a revision."""
    tx, ty = _within(store, places).T
    store.empty(tx, ty, revision)


def _add_tiles(
    sums: Mapping[str, NDArray[Any]], places: NDArray[np.int64], other: TileStore, add: Add
) -> None:
    """Add to the sums those of these tiles that `other` has."""
    (which,) = np.nonzero(revisions_at(other, places))
    if not len(which):
        return
    tx, ty = _within(other, places[which]).T
    planes = {name: plane.tiles(other.touched.shape)[tx, ty] for name, plane in other.planes.items()}
    some = {name: tiles[which] for name, tiles in sums.items()}
    add(some, planes)
    for name, tiles in sums.items():
        tiles[which] = some[name]


def _corner(store: TileStore) -> NDArray[np.int64]:
    return np.array((store.rect.ix // TILE, store.rect.iy // TILE))


def _within(store: TileStore, places: NDArray[np.int64]) -> NDArray[np.int64]:
    """Tiles of the lattice as the store's tables count them."""
    within: NDArray[np.int64] = places - _corner(store)
    return within
