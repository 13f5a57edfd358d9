"""Map snapshot: a copy of a map at one revision, cut and shrunk before it is encoded."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.model import CellModel, CellSource, Encoder, Known, Probability, StoredCells, row_bands
from ogm_core.errors import BadParameter
from ogm_core.lattice import CellRect, Lattice, Region

_ALL = slice(None)


@dataclass(frozen=True, slots=True, eq=False)
class MapSnapshot:
    """Cells of a rectangle of the map, and what is needed to read them.

    `stored` gives the planes that `model` keeps: [iy, ix], shape (height, width), row 0 south. `offset` is
    the lower-left cell (ix, iy). `epoch`, `run` and `revision` say together which map it is: of one life, as
    one process has written it, after so many changes. `stamp` is that of the newest integrated scan, ns since
    the Unix epoch, None if there is none. After `shrink` a pixel stands for `factor` x `factor` cells.
    """

    stored: CellSource
    model: CellModel
    lattice: Lattice
    offset: tuple[int, int]
    epoch: str
    revision: int
    stamp: int | None
    factor: int = 1
    run: str = ""
    erasures: int = 0
    """How many of the changes were no scans: cells were erased."""
    tag: str = ""
    """Of a map that several mappers have written: what tells its states apart, as the revision does not."""
    missing: tuple[dict[str, Any], ...] = ()
    """The shares of a map that are not in it, as JSON tells them: it is of no epoch then."""
    half_life: float | None = None
    """In so many seconds the map forgets half of what it knows; None: it never does."""

    @property
    def scans(self) -> int:
        """How many scans were integrated."""
        return self.revision - self.erasures

    @property
    def cells(self) -> StoredCells:
        """The stored cells of a model that has one plane."""
        (plane,) = self.model.planes
        return self.stored.planes()[plane.name]

    @property
    def width(self) -> int:
        """Columns."""
        return int(self.stored.shape[1])

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.stored.shape[0])

    @property
    def empty(self) -> bool:
        """Whether there is nothing to draw."""
        return self.width * self.height == 0

    @property
    def known_cells(self) -> int:
        """How many cells were ever updated."""
        return self.model.known_cells(self.stored)

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

    def published(self, rows: slice = _ALL, columns: slice = _ALL) -> tuple[Probability, Known]:
        """Probability of "occupied", the prior's where unknown, and which cells were ever updated."""
        return self.model.published(self.stored.planes(rows, columns, self.model.margin))

    def counted(self, rows: slice = _ALL, columns: slice = _ALL) -> dict[str, NDArray[Any]] | None:
        """What was counted in cells, by name; None of models that do not count."""
        return self.model.counted(self.stored.planes(rows, columns, self.model.margin))

    def log_odds(self, rows: slice = _ALL, columns: slice = _ALL) -> NDArray[np.float64]:
        """Log odds of "occupied", the prior's where unknown."""
        return self.model.published_log_odds(self.stored.planes(rows, columns, self.model.margin))

    def encode(self, encoder: Encoder, rows: slice = _ALL) -> NDArray[Any]:
        """What an elementwise encoder makes of the cells of some rows."""
        south, north, _ = rows.indices(self.height)
        dtype = encoder(np.empty(0), np.empty(0, np.bool_), self.model.free_below).dtype
        encoded = np.empty((max(north - south, 0), self.width), dtype)
        for band in row_bands(encoded.shape):
            part = slice(south + band.start, min(south + band.stop, north))
            planes = self.stored.planes(part, _ALL, self.model.margin)
            encoded[band] = self.model.encoded(planes, encoder)
        return encoded

    def meta(self) -> dict[str, Any]:
        """What every map reply carries, in the names and shapes of /map.json.

        `resolution`, `width` and `height` are those of the pixels; `offset` counts cells of the lattice.
        A map of which a part is missing has `missing` in place of `epoch`, `run` and `revision`.
        """
        x, y = self.origin
        which: dict[str, Any] = {"epoch": self.epoch, "run": self.run, "revision": self.revision}
        if self.missing:  # whoever compares such maps compares nothing
            which = {"missing": list(self.missing)}
        elif self.tag:
            which["tag"] = self.tag
        return {
            **which,
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
            raise BadParameter(
                f"region {region.span} lies wholly outside the map, {self.lattice.region_of(self.rect).span}"
            )
        left, bottom = (part.ix - self.rect.ix) // self.factor, (part.iy - self.rect.iy) // self.factor
        right = _divided_up(part.ix + part.width - self.rect.ix, self.factor)
        top = _divided_up(part.iy + part.height - self.rect.iy, self.factor)
        return self._part(slice(bottom, top), slice(left, right))

    def part(self, rect: CellRect) -> "MapSnapshot":
        """The cells of `rect`, which lies in the map; of a map that was not shrunk."""
        south, west = rect.iy - self.rect.iy, rect.ix - self.rect.ix
        return self._part(slice(south, south + rect.height), slice(west, west + rect.width))

    def _part(self, rows: slice, columns: slice) -> "MapSnapshot":
        offset = self.offset[0] + columns.start * self.factor, self.offset[1] + rows.start * self.factor
        return replace(self, stored=self.stored.part(rows, columns), offset=offset)

    def finest(self) -> "MapSnapshot":
        """The map in the cells that tell most of it: half as wide, if its model has those; else itself."""
        halved = self.model.halved(self.stored) if self.factor == 1 else None
        if halved is None:
            return self
        model, stored = halved
        lattice = Lattice(self.lattice.resolution / 2, self.lattice.anchor)
        return replace(
            self, stored=stored, model=model, lattice=lattice, offset=(2 * self.offset[0], 2 * self.offset[1])
        )

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
        model, planes = self.model.pooled(self.stored, factor)
        stored = CellArrays(planes, {plane.name: plane.side for plane in model.planes})
        return replace(self, stored=stored, model=model, factor=self.factor * factor)


def _divided_up(a: int, b: int) -> int:
    return -(-a // b)
