"""Ray casting in NumPy: what a beam from a point in a map would read.

The way through the cells is that of J. Amanatides, A. Woo: A fast voxel traversal algorithm for ray tracing,
Eurographics 1987, and the arithmetic that of `ray_kernel.cast_ray`, which is compiled; here the crossings of
a ray with the grid's lines are listed at once, as NumPy arrays, and sorted.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.log_odds import probability_of
from ogm_core.cells.thresholds import FREE_BELOW, OCCUPIED_ABOVE
from ogm_core.errors import BadParameter, MapEmpty
from ogm_core.lattice import CellRect, Lattice

FOUND_WALL, FOUND_NOTHING, FOUND_UNKNOWN = 0, 1, 2
"""Where a cast ray ends: at an occupied cell, nowhere, or at one that is unknown or undecided."""


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
        *,
        through_unknown: bool = False,
        free_below: float = FREE_BELOW,
    ) -> None:
        """`log_odds` is [iy, ix], row 0 south, NaN where unknown, `offset` its lower-left cell; metres.

        What is unknown or undecided, not below `free_below`, stops a ray, and so does the grid's edge, unless
        it goes `through_unknown`.
        """
        if not max_range > 0.0:
            raise BadParameter(f"max_range: a positive number of metres is needed, got {max_range}")
        self._log_odds, self._offset = log_odds, offset
        height, width = log_odds.shape
        self._cell, self._start = start_of(lattice, CellRect(*offset, width, height), point)
        self._resolution, self._max_range = lattice.resolution, max_range
        self._through_unknown, self._free_below = through_unknown, free_below

    def cast(self, theta: float) -> tuple[int, float]:
        """Where the ray along `theta`, rad, ends, and its range, m; its first cell is not asked."""
        distances, columns, rows, n = self._way(theta)
        # As `cells.classes.trinary` has it; NaN, of what is unknown, is neither.
        p = probability_of(self._log_odds[rows[:n], columns[:n]])
        stops = p > OCCUPIED_ABOVE if self._through_unknown else ~(p < self._free_below)
        end = int(stops.argmax()) if n else 0
        if n and stops[end]:
            return FOUND_WALL if p[end] > OCCUPIED_ABOVE else FOUND_UNKNOWN, self._metres(distances[end])
        if n < distances.size and not self._through_unknown:
            return FOUND_UNKNOWN, self._metres(distances[n])
        return FOUND_NOTHING, float(self._max_range)

    def _way(self, theta: float) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64], int]:
        """The cells that the ray enters, in order: at which distance, in cells, and [column], [row].

        Who has left a rectangle never comes back: the first so many of them, last, are inside.
        """
        height, width = self._log_odds.shape
        (u, v), (du, dv) = self._start, (math.cos(theta), math.sin(theta))
        longest = self._max_range / self._resolution
        along_u = _crossings(u, self._cell[0], du, longest, self._offset[0], width)
        along_v = _crossings(v, self._cell[1], dv, longest, self._offset[1], height)
        distances = np.concatenate((along_u, along_v))
        order = np.argsort(distances, kind="stable")  # through a corner: in u first
        distances = distances[order]
        order = order[distances <= longest]
        in_u = order < along_u.size
        columns = self._cell[0] - self._offset[0] + (1 if du > 0.0 else -1) * np.cumsum(in_u)
        rows = self._cell[1] - self._offset[1] + (1 if dv > 0.0 else -1) * np.cumsum(~in_u)
        inside = (columns < width) if du > 0.0 else (columns >= 0)
        inside &= (rows < height) if dv > 0.0 else (rows >= 0)
        return distances[: order.size], columns, rows, int(np.count_nonzero(inside))

    def _metres(self, distance: float) -> float:
        return abs(float(distance)) * self._resolution  # from a line westward it is -0.0


def start_of(
    lattice: Lattice, rect: CellRect, point: tuple[float, float]
) -> tuple[tuple[int, int], tuple[float, float]]:
    """The cell (ix, iy) that holds a point, m, in which rays begin, and the point in cells from the anchor.

    Raises:
        BadParameter: the point is not finite, or does not lie in `rect`, the cells of the map.
        MapEmpty: there are none.
    """
    ix, iy = lattice.cell_of(*point)
    if not rect.cells:
        raise MapEmpty("the map has no known cell yet: try again after the first scan")
    if not rect.contains(CellRect(ix, iy, 1, 1)):
        raise BadParameter(
            f"point ({point[0]:g}, {point[1]:g}) lies outside the map, {lattice.region_of(rect).span}"
        )
    u, v = lattice.in_cells(np.array(point, np.float64)).tolist()
    return (ix, iy), (u, v)


def directions_of(bearings: Sequence[float]) -> NDArray[np.float64]:
    """Unit vectors along bearings, rad, shape (n, 2): of the same library whoever casts, to the last bit."""
    return np.array([(math.cos(bearing), math.sin(bearing)) for bearing in bearings]).reshape(-1, 2)


def window_of(
    start: tuple[float, float], directions: NDArray[np.float64], longest: float, rect: CellRect
) -> CellRect:
    """The cells of `rect` that rays from `start` along `directions` can enter within `longest`, all in cells.

    The point lies in `rect`. There is a cell to spare on every side, for what is rounded.
    """
    point = np.array(start)
    ends = np.vstack((point, point + np.minimum(longest, rect.width + rect.height) * directions))
    west, south = np.floor(ends.min(axis=0)).astype(np.int64).tolist()
    east, north = np.floor(ends.max(axis=0)).astype(np.int64).tolist()
    return CellRect(west - 1, south - 1, east - west + 3, north - south + 3).intersection(rect)


def _crossings(
    start: float, cell: int, step: float, longest: float, first: int, cells: int
) -> NDArray[np.float64]:
    """Distances at which a ray crosses the grid's lines of one axis, up to the one where it leaves.

    Those beyond `longest` need not be there: two to spare are, for what is rounded.
    """
    if step == 0.0:
        return np.empty(0)
    most = int(min(longest * abs(step), float(cells))) + 2
    ahead = (
        (cell + 1, min(first + cells, cell + most) + 1, 1)
        if step > 0.0
        else (cell, max(first, cell - most) - 1, -1)
    )
    lines = np.arange(*ahead, dtype=np.float64)
    with np.errstate(over="ignore"):  # along an axis that a ray hardly moves along, the next line is at inf
        return (lines - start) / step
