"""Tiles of a map that counts, as its mapper keeps them: what is served of them, by NumPy."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.halves import halved
from ogm_core.cells.model import Known, Planes, Probability
from ogm_core.cells.rate import PLANES, Rate, RateHalves, log_odds_of
from ogm_core.lattice import CellRect
from ogm_core.tiles.store import TILE

MODEL = "rate"
"""What such a model calls itself on the wire."""
PER_CELL = 2
"""Served cells along a side of one that is counted in, unless those themselves are asked for."""
SPREAD = Rate.spread
"""Cells around a tile whose probability depends on it."""

Place = tuple[int, int]
Tiles = Mapping[Place, Mapping[str, NDArray[Any]]]


def lay_out_counts(
    tiles: Tiles,
    stale: Iterable[Place],
    extent: CellRect,
    log_odds: NDArray[np.float32],
    per_cell: int,
    free_below: float,
) -> None:
    """Put the log odds of tiles and of the cells around them where they lie in a map of this extent.

    As /map.npz has them: cells half as wide, or with 1 `per_cell` those that are counted in; NaN where
    unknown; what juts out is left out. Read back they are free where they are counted free.
    """
    for tx, ty in stale:
        part = CellRect(tx * TILE, ty * TILE, TILE, TILE).widened(SPREAD).intersection(extent)
        if not part.cells:
            continue
        published = _cells(tiles, part) if per_cell == 1 else _halves(tiles, part)
        served = log_odds_of(*published, free_below)
        y, x = per_cell * (part.iy - extent.iy), per_cell * (part.ix - extent.ix)
        log_odds[y : y + served.shape[0], x : x + served.shape[1]] = served


def _cells(tiles: Tiles, part: CellRect) -> tuple[Probability, Known]:
    """What is published of cells that are counted in."""
    return Rate().published(window(tiles, part.widened(Rate.margin)))


def _halves(tiles: Tiles, part: CellRect) -> tuple[Probability, Known]:
    """What is published of their halves."""
    planes = window(tiles, part.widened(SPREAD))
    # Of the two cells more at every side, four halves, three are looked at.
    rows, columns = (slice(1, PER_CELL * (length + 2 * SPREAD) - 1) for length in (part.height, part.width))
    return RateHalves().published(halved(planes, rows, columns))


def window(tiles: Tiles, rect: CellRect) -> Planes:
    """The planes of a rectangle of cells; 0 where there is no tile."""
    planes = {name: np.zeros((side * rect.height, side * rect.width), dtype) for name, dtype, side in PLANES}
    first, last = (rect.ix // TILE, rect.iy // TILE), (rect.ix + rect.width - 1, rect.iy + rect.height - 1)
    for tx in range(first[0], last[0] // TILE + 1):
        for ty in range(first[1], last[1] // TILE + 1):
            tile = tiles.get((tx, ty))
            part = CellRect(tx * TILE, ty * TILE, TILE, TILE).intersection(rect)
            if tile is None:
                continue
            for name, _, side in PLANES:
                cells = tile[name].reshape(side * TILE, side * TILE)
                here, there = (
                    (
                        slice(side * (part.iy - iy), side * (part.iy - iy + part.height)),
                        slice(side * (part.ix - ix), side * (part.ix - ix + part.width)),
                    )
                    for ix, iy in ((rect.ix, rect.iy), (tx * TILE, ty * TILE))
                )
                planes[name][here] = cells[there]
    return planes
