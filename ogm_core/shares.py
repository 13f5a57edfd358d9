"""Shares: a map that is cut into rectangles of tiles, each kept by a mapper of its own. Loads no kernels."""

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ogm_core.errors import BadSetting
from ogm_core.lattice import MAX_INDEX, TILE, CellRect, Clip, Lattice, Region
from ogm_core.placing.receipts import Whose
from ogm_core.status import ShareInfo
from ogm_core.types import PlacedScan, Pose

MAX_SHARES = 1024
"""So many shares a map may have."""
_WHOLE = 1e-6
_ROUNDED = 2
"""So many cells farther than `reach` a scan may write at most: its ends are rounded to cells."""
_EDGES = np.min, np.max


@dataclass(frozen=True, slots=True)
class Cuts:
    """Where a map is cut: at these x and y, m, each strictly rising. Without any it is one share.

    Raises:
        BadSetting: they do not rise, or make too many shares.
    """

    x: tuple[float, ...] = ()
    y: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for axis, cuts in (("x", self.x), ("y", self.y)):
            for before, after in pairwise(cuts):
                if not before < after:
                    raise BadSetting(
                        f"shares.cuts_{axis}: {after:g} comes after {before:g}: each has to be "
                        "larger than the one before"
                    )
        if self.count > MAX_SHARES:
            raise BadSetting(f"shares: these cuts make {self.count} shares, {MAX_SHARES} at most can be")

    @property
    def count(self) -> int:
        """How many shares they make."""
        return (len(self.x) + 1) * (len(self.y) + 1)

    def check(self, lattice: Lattice, bounds: Region | None = None) -> None:
        """Refuse cuts that are no edges of a lattice's tiles, or that lie outside a map's bounds.

        Raises:
            BadSetting: there is one; the text says where the nearest edges are.
        """
        for axis, cuts in enumerate((self.x, self.y)):
            for cut in cuts:
                _edge(cut, axis, lattice)
                if bounds is not None and not bounds[axis] < cut < bounds[axis + 2]:
                    raise BadSetting(
                        f"shares.cuts_{'xy'[axis]}: {cut:g} m lies outside map.bounds, {bounds.span}: "
                        "it cuts nothing off"
                    )


@dataclass(frozen=True, slots=True)
class Share:
    """Share `index` of a map with these cuts: counted from 0 in the south-west, along x first.

    Raises:
        BadSetting: there is no such share.
    """

    cuts: Cuts
    index: int

    def __post_init__(self) -> None:
        if not 0 <= self.index < self.cuts.count:
            raise BadSetting(
                f"shares.index: {self.index}: with these cuts a map has the shares 0 to {self.cuts.count - 1}"
            )

    @property
    def bounds(self) -> tuple[float | None, float | None, float | None, float | None]:
        """xmin, ymin, xmax, ymax, m; None where it is open."""
        column, row = self.index % (len(self.cuts.x) + 1), self.index // (len(self.cuts.x) + 1)
        x, y = (None, *self.cuts.x, None), (None, *self.cuts.y, None)
        return x[column], y[row], x[column + 1], y[row + 1]

    def info(self) -> ShareInfo:
        """What a status says of it."""
        cuts = self.cuts
        return ShareInfo(self.index, cuts.count, list(cuts.x), list(cuts.y), list(self.bounds))

    def clip(self, lattice: Lattice) -> Clip:
        """Its cells.

        Raises:
            BadSetting: a cut is no edge of the lattice's tiles.
        """
        edges = (None if edge is None else _edge(edge, k % 2, lattice) for k, edge in enumerate(self.bounds))
        return Clip(*edges)


def _edge(cut: float, axis: int, lattice: Lattice) -> int:
    """The first cell from a cut on, which begins a tile."""
    side = TILE * lattice.resolution
    tiles = (cut - lattice.anchor[axis]) / side
    if not abs(tiles) < MAX_INDEX // TILE:
        raise BadSetting(f"shares.cuts_{'xy'[axis]}: {cut:g} m is farther away than cells are")
    if abs(tiles - round(tiles)) * TILE > _WHOLE:
        below, above = (lattice.anchor[axis] + at * side for at in (math.floor(tiles), math.ceil(tiles)))
        raise BadSetting(
            f"shares.cuts_{'xy'[axis]}: {cut:.9g} m is no edge of tiles of {TILE} cells of "
            f"{lattice.resolution:g} m: the nearest are {below:.9g} and {above:.9g}"
        )
    return TILE * round(tiles)


class Reached(NamedTuple):
    """Where a scan may write, whatever it measured: edges in cells, not rounded; all are within."""

    xmin: float
    ymin: float
    xmax: float
    ymax: float

    @classmethod
    def by(cls, placed: PlacedScan, lattice: Lattice, reach: float) -> "Reached":
        """`reach` of the map, m: the sensor's own takes its place."""
        scan, (x, y, _), sweep = placed
        resolution, (ax, ay) = lattice.resolution, lattice.anchor
        by = (reach if scan.reach is None else scan.reach) / resolution + _ROUNDED
        if sweep is None:
            u, v = (x - ax) / resolution, (y - ay) / resolution
            return cls(u - by, v - by, u + by, v + by)
        (u0, v0), (u1, v1) = ((edge(sweep.beams[:, :2], axis=0) - (ax, ay)) / resolution for edge in _EDGES)
        return cls(float(u0 - by), float(v0 - by), float(u1 + by), float(v1 + by))

    def meets(self, rect: CellRect) -> bool:
        """Whether it may write a cell of a rectangle."""
        ix, iy, width, height = rect
        return self.xmin < ix + width and self.xmax >= ix and self.ymin < iy + height and self.ymax >= iy

    def lies_in(self, rect: CellRect) -> bool:
        """Whether it writes no cell but those of a rectangle."""
        ix, iy, width, height = rect
        return self.xmin >= ix and self.xmax < ix + width and self.ymin >= iy and self.ymax < iy + height


@dataclass(frozen=True, slots=True)
class Ground:
    """The cells that one share owns, and how far scans reach, m: whose a placed scan is to count."""

    clip: Clip
    lattice: Lattice
    reach: float
    rect: CellRect = field(init=False)
    """Those of `clip`, once for all scans."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "rect", self.clip.rect)

    def whose(self, placed: PlacedScan) -> Whose:
        """`home` where the sensor stood on these cells, at the scan's stamp: that holds in one share alone.

        In the others the scan is at the `border` if it may reach cells of theirs, else `elsewhere`.
        """
        if self._holds(placed.pose):
            return "home"
        return "border" if Reached.by(placed, self.lattice, self.reach).meets(self.rect) else "elsewhere"

    def _holds(self, pose: Pose) -> bool:
        """Also of poses so far away that cells are not addressed there."""
        (ax, ay), resolution, clip = self.lattice.anchor, self.lattice.resolution, self.clip
        return _within((pose.x - ax) / resolution, clip.xmin, clip.xmax) and _within(
            (pose.y - ay) / resolution, clip.ymin, clip.ymax
        )


def _within(at: float, begin: int | None, end: int | None) -> bool:
    return (begin is None or at >= begin) and (end is None or at < end)
