"""Ray casting in a map: what a beam from a point in it would read.

The way through the cells is that of J. Amanatides, A. Woo: A fast voxel traversal algorithm for ray tracing,
Eurographics 1987, and the arithmetic that of `ogm_core.quality.agreement.cast_ray`, which is compiled; here
the crossings of a ray with the grid's lines are listed at once, as NumPy arrays, and sorted.
"""

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.classes import FREE, OCCUPIED, trinary
from ogm_core.cells.log_odds import probability_of
from ogm_core.errors import BadParameter, MapEmpty
from ogm_core.lattice import Lattice

Found = Literal["occupied", "unknown", "nothing"]


@dataclass(frozen=True, slots=True)
class Ray:
    """Where a ray through a map ends: at `range` m, and what it has `found` there.

    - "occupied": the first cell on its way that is not free is occupied, and is entered at `range`;
    - "unknown": that cell is unknown or undecided, or it lies outside the grid;
    - "nothing": every cell within the `max_range` of the cast is free; `range` is `max_range`.
    """

    range: float
    found: Found


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """The same of many rays, arrays of one shape: `range` in m, float64, and `found`, the words of `Ray`."""

    range: NDArray[np.float64]
    found: NDArray[np.str_]


class RayCaster:
    """Casts rays from a point through the cells of a grid.

    Raises:
        BadParameter: the point is not finite or outside the grid, or `max_range` is not positive.
        MapEmpty: there is no cell.
    """

    def __init__(
        self,
        log_odds: NDArray[np.floating[Any]],
        lattice: Lattice,
        offset: tuple[int, int],
        point: tuple[float, float],
        max_range: float,
    ) -> None:
        """`log_odds` is [iy, ix], row 0 south, NaN where unknown, `offset` its lower-left cell; metres."""
        if not max_range > 0.0:
            raise BadParameter(f"max_range: a positive number of metres is needed, got {max_range}")
        self._log_odds, self._offset = log_odds, offset
        self._cell = lattice.cell_of(*point)
        self._check_inside(lattice, point)
        self._start = lattice.in_cells(np.array(point, np.float64)).tolist()
        self._resolution, self._max_range = lattice.resolution, max_range

    def cast(self, theta: float) -> Ray:
        """The ray along `theta`, rad. The cell that it starts in is not asked."""
        height, width = self._log_odds.shape
        distances, columns, rows = self._way(theta)
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        # Who has left a rectangle never comes back: the first `n` cells are inside.
        n = np.count_nonzero(inside)
        p = probability_of(self._log_odds[rows[:n], columns[:n]])
        states = trinary(p, ~np.isnan(p))
        stops = np.flatnonzero(states != FREE)
        if stops.size:
            end = stops[0]
            return self._ray(distances[end], "occupied" if states[end] == OCCUPIED else "unknown")
        if n < distances.size:
            return self._ray(distances[n], "unknown")
        return Ray(float(self._max_range), "nothing")

    def _way(self, theta: float) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
        """The cells that the ray enters, in order: at which distance, in cells, and [column], [row]."""
        height, width = self._log_odds.shape
        (u, v), (du, dv) = self._start, (math.cos(theta), math.sin(theta))
        along_u = _crossings(u, self._cell[0], du, self._offset[0], width)
        along_v = _crossings(v, self._cell[1], dv, self._offset[1], height)
        distances = np.concatenate((along_u, along_v))
        order = np.argsort(distances, kind="stable")  # through a corner: in u first
        distances = distances[order]
        order = order[distances <= self._max_range / self._resolution]
        in_u = order < along_u.size
        columns = self._cell[0] - self._offset[0] + (1 if du > 0.0 else -1) * np.cumsum(in_u)
        rows = self._cell[1] - self._offset[1] + (1 if dv > 0.0 else -1) * np.cumsum(~in_u)
        return distances[: order.size], columns, rows

    def _ray(self, distance: float, found: Found) -> Ray:
        return Ray(abs(float(distance)) * self._resolution, found)  # from a line westward it is -0.0

    def _check_inside(self, lattice: Lattice, point: tuple[float, float]) -> None:
        height, width = self._log_odds.shape
        if not self._log_odds.size:
            raise MapEmpty("the map has no known cell yet: try again after the first scan")
        ix, iy = self._offset
        if not (ix <= self._cell[0] < ix + width and iy <= self._cell[1] < iy + height):
            (xmin, ymin), (xmax, ymax) = lattice.corner_of(ix, iy), lattice.corner_of(ix + width, iy + height)
            raise BadParameter(
                f"point ({point[0]:g}, {point[1]:g}) lies outside the map, "
                f"x {xmin:.9g} to {xmax:.9g}, y {ymin:.9g} to {ymax:.9g} m"
            )


def _crossings(start: float, cell: int, step: float, first: int, cells: int) -> NDArray[np.float64]:
    """Distances at which a ray crosses the grid's lines of one axis, up to the one where it leaves."""
    if step == 0.0:
        return np.empty(0)
    ahead = (cell + 1, first + cells + 1, 1) if step > 0.0 else (cell, first - 1, -1)
    lines = np.arange(*ahead, dtype=np.float64)
    with np.errstate(over="ignore"):  # along an axis that a ray hardly moves along, the next line is at inf
        return (lines - start) / step
