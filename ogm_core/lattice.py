"""Lattice: world <-> cell arithmetic, the only module where metres become cells and cells become metres.

A map's lattice is fixed for its life. Cells are half open: cell (ix, iy) holds the points with
ix <= (x - anchor_x) / resolution < ix + 1, and likewise in y. Serving crops; it never shifts the lattice.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import BadParameter, BadSetting

MIN_RESOLUTION = 0.001
"""The smallest cell, m: with ranges up to 1000 m a beam stays below 2^20 cells (sensor_models.bresenham)."""
MAX_RESOLUTION = 1e6
"""The largest cell, m."""
MAX_INDEX = 2**52
"""Cells beyond this index are not addressed: a float64 no longer tells neighbours apart."""
_WHOLE = 1e-6
SAME_RESOLUTION = 1e-6
"""Resolutions that differ by no more, relatively, are one: files round them."""
TILE_BITS = 6
TILE = 1 << TILE_BITS
"""Cells are stored in tiles, 64 cells wide and high, from cell (0, 0) on."""


class CellRect(NamedTuple):
    """A rectangle of cells: lower-left cell (ix, iy), `width` columns, `height` rows."""

    ix: int
    iy: int
    width: int
    height: int

    @property
    def cells(self) -> int:
        """How many cells it holds."""
        return self.width * self.height

    def union(self, other: "CellRect") -> "CellRect":
        """The smallest rectangle that holds both."""
        ix, iy = min(self.ix, other.ix), min(self.iy, other.iy)
        right = max(self.ix + self.width, other.ix + other.width)
        top = max(self.iy + self.height, other.iy + other.height)
        return CellRect(ix, iy, right - ix, top - iy)

    def intersection(self, other: "CellRect") -> "CellRect":
        """The cells that both hold; width and height are 0 if there are none."""
        ix, iy = max(self.ix, other.ix), max(self.iy, other.iy)
        right = min(self.ix + self.width, other.ix + other.width)
        top = min(self.iy + self.height, other.iy + other.height)
        if right <= ix or top <= iy:
            return CellRect(ix, iy, 0, 0)
        return CellRect(ix, iy, right - ix, top - iy)

    def meets(self, other: "CellRect") -> bool:
        """Whether there is a cell that both hold."""
        return max(self.ix, other.ix) < min(self.ix + self.width, other.ix + other.width) and max(
            self.iy, other.iy
        ) < min(self.iy + self.height, other.iy + other.height)

    def widened(self, by: int) -> "CellRect":
        """It, and so many cells more on every side."""
        return CellRect(self.ix - by, self.iy - by, self.width + 2 * by, self.height + 2 * by)

    def contains(self, other: "CellRect") -> bool:
        """Whether every cell of `other` lies in this rectangle."""
        return (
            self.ix <= other.ix
            and self.iy <= other.iy
            and other.ix + other.width <= self.ix + self.width
            and other.iy + other.height <= self.iy + self.height
        )


@dataclass(frozen=True, slots=True)
class Clip:
    """A rectangle of a lattice that a map keeps to: cells (ix, iy), xmin <= ix < xmax and ymin <= iy < ymax.

    Whole tiles; None where it is open. Maps of one lattice whose clips meet edge to edge hold, together, the
    cells of the map without a clip.

    Raises:
        BadSetting: an edge is none of tiles, or the rectangle is empty.
    """

    xmin: int | None = None
    ymin: int | None = None
    xmax: int | None = None
    ymax: int | None = None

    def __post_init__(self) -> None:
        for name in ("xmin", "ymin", "xmax", "ymax"):
            edge = getattr(self, name)
            if edge is not None and not (abs(edge) <= MAX_INDEX and edge % TILE == 0):
                raise BadSetting(
                    f"clip: {name} is cell {edge}: an edge of tiles is needed, a multiple of {TILE} cells"
                )
        if not self.rect.cells:
            raise BadSetting(f"clip: xmin < xmax and ymin < ymax are needed, got {self}")

    @property
    def rect(self) -> CellRect:
        """Its cells; where it is open, up to beyond the farthest that are addressed."""
        far = 2 * MAX_INDEX
        xmin, ymin = (-far if edge is None else edge for edge in (self.xmin, self.ymin))
        xmax, ymax = (far if edge is None else edge for edge in (self.xmax, self.ymax))
        return CellRect(xmin, ymin, max(xmax - xmin, 0), max(ymax - ymin, 0))


class Region(NamedTuple):
    """An axis-aligned rectangle of the world, m."""

    xmin: float
    ymin: float
    xmax: float
    ymax: float

    @property
    def span(self) -> str:
        """From where to where it reaches, in words."""
        return f"x {self.xmin:.9g} to {self.xmax:.9g}, y {self.ymin:.9g} to {self.ymax:.9g} m"


@dataclass(frozen=True, slots=True)
class Lattice:
    """Square cells of `resolution` metres; `anchor` is the lower-left corner of cell (0, 0)."""

    resolution: float
    anchor: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not MIN_RESOLUTION <= self.resolution <= MAX_RESOLUTION:
            raise BadSetting(
                f"resolution: {MIN_RESOLUTION:g} to {MAX_RESOLUTION:g} m is needed, got {self.resolution:g}"
            )

    def cell_of(self, x: float, y: float) -> tuple[int, int]:
        """Indices (ix, iy) of the cell that holds the point (x, y), m.

        Raises:
            BadParameter: the point is not finite, or farther away than cells can be told apart.
        """
        return self.place_of(x, y)[0]

    def place_of(self, x: float, y: float) -> tuple[tuple[int, int], tuple[float, float]]:
        """The cell that holds the point (x, y), m, and where in it: from its lower-left corner, in cells.

        In [0, 1], where 1 is a point just below the next cell, rounded.

        Raises:
            BadParameter: the point is not finite, or farther away than cells can be told apart.
        """
        u = (x - self.anchor[0]) / self.resolution
        v = (y - self.anchor[1]) / self.resolution
        if not (abs(u) < MAX_INDEX and abs(v) < MAX_INDEX):
            raise BadParameter(f"point ({x:g}, {y:g}): no cell has such coordinates")
        ix, iy = math.floor(u), math.floor(v)
        return (ix, iy), (u - ix, v - iy)

    def in_cells(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points, m, shape (..., 2), in cells from the anchor: what `cell_of` takes the floor of."""
        cells: NDArray[np.float64] = (points - self.anchor) / self.resolution
        return cells

    def corner_of(self, ix: int, iy: int) -> tuple[float, float]:
        """World position of the lower-left corner of cell (ix, iy), m."""
        return self.anchor[0] + ix * self.resolution, self.anchor[1] + iy * self.resolution

    def region_of(self, rect: CellRect) -> Region:
        """What the cells of a rectangle fill of the world."""
        corner = self.corner_of(rect.ix + rect.width, rect.iy + rect.height)
        return Region(*self.corner_of(rect.ix, rect.iy), *corner)

    def cover(self, region: Region) -> CellRect:
        """The smallest rectangle of cells that covers `region` (rounded outward).

        An edge of the region within 1e-6 cells of an edge between cells is that one: sums and products of
        the resolution seldom meet it exactly. So a region on the edges of cells covers these, and no others.

        Raises:
            BadParameter: the region is inverted, empty or not finite.
        """
        if not all(map(math.isfinite, region)):
            raise BadParameter("region: four finite numbers are needed")
        if not (region.xmin < region.xmax and region.ymin < region.ymax):
            raise BadParameter("region: xmin < xmax and ymin < ymax are needed")
        ix, iy = (math.floor(self._index(value, axis)) for axis, value in enumerate(region[:2]))
        right, top = (math.ceil(self._index(value, axis)) for axis, value in enumerate(region[2:]))
        return CellRect(ix, iy, max(1, right - ix), max(1, top - iy))

    def _index(self, value: float, axis: int) -> float:
        """Coordinate in cells, whole within 1e-6, cut off where cells can no longer be told apart."""
        cells = (value - self.anchor[axis]) / self.resolution
        cells = min(max(cells, -float(MAX_INDEX)), float(MAX_INDEX))
        return round(cells) if abs(cells - round(cells)) <= _WHOLE else cells


def bounded(resolution: float, bounds: Region) -> tuple[Lattice, CellRect]:
    """Lattice anchored at the bounds' lower-left corner, and the cells that the bounds span.

    Raises:
        BadSetting: the bounds are inverted, not finite, or do not span a whole number of cells (within 1e-6).
    """
    lattice = Lattice(resolution, (bounds.xmin, bounds.ymin))
    if not all(map(math.isfinite, bounds)) or bounds.xmin >= bounds.xmax or bounds.ymin >= bounds.ymax:
        raise BadSetting(f"bounds: finite XMIN < XMAX and YMIN < YMAX are needed, got {_listed(bounds)}")
    spans = (bounds.xmax - bounds.xmin) / resolution, (bounds.ymax - bounds.ymin) / resolution
    for axis, span in zip("xy", spans, strict=True):
        if not (span < MAX_INDEX and abs(span - round(span)) <= _WHOLE and round(span) >= 1):
            raise BadSetting(
                f"bounds: {span:.9g} cells of {resolution:g} m in {axis}; a whole number is needed, "
                f"so change the bounds {_listed(bounds)} or the resolution"
            )
    return lattice, CellRect(0, 0, round(spans[0]), round(spans[1]))


def _listed(bounds: Region) -> str:
    return ",".join(f"{value:g}" for value in bounds)
