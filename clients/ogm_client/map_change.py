"""Change of a map: what of a copy is not what it was at an earlier version."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ogm_client.map_copy import MapCopy, Place
from ogm_client.transport import Version
from ogm_core.lattice import CellRect, Region
from ogm_core.tiles.store import TILE


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """What a follower's map is now, and what of it has changed."""

    epoch: str
    run: str
    revision: int
    region: Region | None
    """What holds every changed tile, m, rounded outward to whole tiles; None: no cell has changed.

    Of a map that counts, with two cells around them, whose probabilities depend on them.
    """
    tiles: NDArray[np.int64]
    """Which tiles of 64 x 64 cells have changed, shape (n, 2): (tx, ty) begins at cell (64 tx, 64 ty)."""
    whole: bool
    """Whether nothing of what was seen before holds any more: all tiles are among the changed ones."""
    reset: bool
    """Whether another life of the map was seen before: it was reset, restored, or its mapper started anew."""

    @property
    def version(self) -> Version:
        """Which map it is: what the next `wait` is told."""
        return Version(self.epoch, self.run, self.revision)


def change_since(copy: MapCopy, seen: Version | None) -> Change:
    """What a copy, which has a map, is now, and what of it has changed since the version `seen`."""
    mine, newest = copy.version, copy.newest
    assert mine is not None
    assert newest is not None
    other_life = seen is None or not seen.is_before(mine)
    changed = sorted(copy.changed_since(seen))
    rect = _rect_around(changed)
    region = None if rect is None else newest.lattice.region_of(rect.widened(copy.spread))
    tiles = np.array(changed, np.int64).reshape(-1, 2)
    return Change(*mine, region, tiles, whole=other_life, reset=seen is not None and other_life)


def _rect_around(tiles: list[Place]) -> CellRect | None:
    """The cells of the smallest rectangle that holds some tiles; None of no tile."""
    if not tiles:
        return None
    left, bottom = (min(tile[axis] for tile in tiles) for axis in (0, 1))
    right, top = (max(tile[axis] for tile in tiles) + 1 for axis in (0, 1))
    return CellRect(left * TILE, bottom * TILE, (right - left) * TILE, (top - bottom) * TILE)
