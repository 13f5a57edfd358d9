"""A copy of a map at one revision: what readers get, cut and shrunk before it is encoded."""

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.classes import OCCUPIED, trinary
from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.model import Encoder, StoredCells
from ogm_core.errors import BadParameter
from ogm_core.lattice import CellRect, Lattice, Region


class CellSource(Protocol):
    """Stored cells that are not yet one array, [iy, ix], row 0 south; they never change."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""

    def __getitem__(self, part: tuple[slice, slice]) -> StoredCells:
        """The cells of some rows and columns."""

    def dense(self) -> StoredCells:
        """All of them."""

    def known_cells(self) -> int:
        """How many of them were ever updated."""

    def value_counts(self) -> NDArray[np.int64]:
        """How often each int16 cell but 0, unknown, occurs, shape (65536,), by its bits."""

    def png(self, model: LogOdds, encoder: Encoder) -> bytes:
        """PNG of what `encoder` draws of them, north up; there is at least one cell."""


@dataclass(frozen=True, slots=True, eq=False)
class MapSnapshot:
    """Stored cells of a rectangle of the map, and what is needed to read them.

    `stored` is [iy, ix], shape (height, width), row 0 south, as `model` stores them: an array, or what makes
    one. `offset` is the lower-left cell (ix, iy). `stamp` is that of the newest integrated scan, ns since the
    Unix epoch, None if there is none. After `shrink` a pixel stands for `factor` x `factor` cells.
    """

    stored: StoredCells | CellSource
    model: LogOdds
    lattice: Lattice
    offset: tuple[int, int]
    epoch: str
    revision: int
    stamp: int | None
    factor: int = 1

    @property
    def cells(self) -> StoredCells:
        """The stored cells as one array."""
        return self.stored if isinstance(self.stored, np.ndarray) else self.stored.dense()

    @property
    def width(self) -> int:
        """Columns of `cells`."""
        return int(self.stored.shape[1])

    @property
    def height(self) -> int:
        """Rows of `cells`."""
        return int(self.stored.shape[0])

    @property
    def empty(self) -> bool:
        """Whether there is nothing to draw."""
        return self.width * self.height == 0

    @property
    def known_cells(self) -> int:
        """How many cells were ever updated."""
        if isinstance(self.stored, np.ndarray):
            return int(np.count_nonzero(self.model.known(self.stored)))
        return self.stored.known_cells()

    @property
    def resolution(self) -> float:
        """Metres per pixel."""
        return self.lattice.resolution * self.factor

    @property
    def origin(self) -> tuple[float, float]:
        """World position of the lower-left corner, m."""
        return self.lattice.corner_of(*self.offset)

    @property
    def rect(self) -> CellRect:
        """The map's cells under the pixels; after `shrink` the last row and column may reach beyond them."""
        return CellRect(*self.offset, self.width * self.factor, self.height * self.factor)

    def meta(self) -> dict[str, Any]:
        """What every map reply carries, in the names and shapes of /map.json.

        `resolution`, `width` and `height` are those of the pixels; `offset` counts cells of the lattice.
        """
        x, y = self.origin
        return {
            "epoch": self.epoch,
            "revision": self.revision,
            "stamp": self.stamp,
            "resolution": self.resolution,
            "width": self.width,
            "height": self.height,
            "origin": {"x": x, "y": y, "theta": 0.0},
            "anchor": list(self.lattice.anchor),
            "offset": list(self.offset),
        }

    def crop(self, region: Region) -> "MapSnapshot":
        """The part that covers `region`, rounded outward; what lies outside the map is left out.

        An empty map crops to itself.

        Raises:
            BadParameter: the region is inverted, not finite, or wholly outside the map.
        """
        wanted = self.lattice.cover(region)
        if self.empty:
            return self
        part = self.rect.intersection(wanted)
        if not part.cells:
            raise BadParameter(f"region {_span(region)} lies wholly outside the map, {_span(self._extent())}")
        left, bottom = (part.ix - self.rect.ix) // self.factor, (part.iy - self.rect.iy) // self.factor
        right = _divided_up(part.ix + part.width - self.rect.ix, self.factor)
        top = _divided_up(part.iy + part.height - self.rect.iy, self.factor)
        offset = self.offset[0] + left * self.factor, self.offset[1] + bottom * self.factor
        return replace(self, stored=self.stored[bottom:top, left:right], offset=offset)

    def shrink(self, max_size: int) -> "MapSnapshot":
        """The map with square blocks of cells in place of cells, by the smallest whole factor that fits.

        No side is longer than `max_size` pixels. Blocks count from the lower-left cell. A block is its
        likeliest occupied cell if that one counts as occupied, else its least likely known cell: occupied
        wins, then free. Unknown if none of its cells is known.

        Raises:
            BadParameter: `max_size` is below 1.
        """
        if max_size < 1:
            raise BadParameter(f"max_size: at least 1 pixel is needed, got {max_size}")
        factor = _divided_up(max(self.width, self.height), max_size)
        if factor <= 1:
            return self
        return replace(self, stored=_blocks(self.model, self.cells, factor), factor=self.factor * factor)

    def _extent(self) -> Region:
        ix, iy, width, height = self.rect
        return Region(*self.origin, *self.lattice.corner_of(ix + width, iy + height))


def _blocks(model: LogOdds, cells: StoredCells, factor: int) -> StoredCells:
    """One stored cell per block. Stored cells grow with their probability, so they are compared as stored."""
    least, most = _ends(cells.dtype)
    known = model.known(cells)
    highest = _pooled(np.maximum, np.where(known, cells, least), factor)
    lowest = _pooled(np.minimum, np.where(known, cells, most), factor)
    blocks = np.where(model.encode(highest, trinary) == OCCUPIED, highest, lowest)
    blocks[highest == least] = 0
    return blocks


def _ends(dtype: np.dtype[Any]) -> tuple[Any, Any]:
    """The ends of a type's range; the lower one is not a cell (see cells.log_odds)."""
    if dtype.kind == "f":
        return dtype.type(-np.inf), dtype.type(np.inf)
    limits = np.iinfo(dtype)
    return dtype.type(limits.min), dtype.type(limits.max)


def _pooled(extreme: np.ufunc, cells: StoredCells, factor: int) -> StoredCells:
    """The `extreme` of every block of `factor` x `factor` cells; the last ones may be smaller."""
    return _pooled_rows(extreme, _pooled_rows(extreme, cells, factor).T, factor).T


def _pooled_rows(extreme: np.ufunc, cells: StoredCells, factor: int) -> StoredCells:
    # One pass over whole rows per row of a block: five times faster than reduceat or a 4-D reshape.
    pooled = cells[::factor].copy(order="K")
    for row in range(1, min(factor, len(cells))):
        part = cells[row::factor]
        extreme(pooled[: len(part)], part, out=pooled[: len(part)])
    return pooled


def _divided_up(a: int, b: int) -> int:
    return -(-a // b)


def _span(region: Region) -> str:
    return f"x {region.xmin:.9g} to {region.xmax:.9g}, y {region.ymin:.9g} to {region.ymax:.9g} m"
