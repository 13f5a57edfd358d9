"""Polygon on a lattice: the cells whose centre lies in it.

A centre on an edge lies in the polygon if the inside is to its right, or above a level edge: polygons that
share an edge have no cell in common, and none lies between them. Where a polygon crosses itself a centre is
inside if a ray from it crosses the edges an odd number of times (even-odd rule).
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import BadParameter
from ogm_core.lattice import MAX_INDEX, CellRect, Lattice, Region

MAX_POINTS = 64
"""Corners of a polygon; so many, each of two numbers, fit into the parameters of a query on Zenoh."""
_SNAP = 1e-6
Point = tuple[float, float]


class Polygon:
    """The cells of a lattice whose centre lies in a polygon. Nobody changes it."""

    def __init__(self, points: Sequence[Point], lattice: Lattice) -> None:
        """`points` are its corners in order, m; the last one is joined to the first.

        A corner within 1e-6 cells of the line through centres lies on it, as rounding would have it.

        Raises:
            BadParameter: there are fewer than 3 or more than MAX_POINTS, one is not finite, or farther away
                than cells can be told apart.
        """
        if not 3 <= len(points) <= MAX_POINTS:
            raise BadParameter(f"polygon: 3 to {MAX_POINTS} points are needed, got {len(points)}")
        with np.errstate(over="ignore", invalid="ignore"):  # what is too far away is refused
            places = lattice.in_cells(np.array(points, np.float64)) - 0.5  # a cell's centre is at its indices
        if not np.all(np.abs(places) < MAX_INDEX):
            raise BadParameter("polygon: finite numbers are needed, of places that have cells")
        whole = np.round(places)
        corners = np.where(np.abs(places - whole) <= _SNAP, whole, places)
        self._corners: list[Point] = [(x, y) for x, y in corners.tolist()]
        (west, south), (east, north) = (
            [math.ceil(value) for value in edge.tolist()]
            for edge in (corners.min(axis=0), corners.max(axis=0))
        )
        self.rect = CellRect(west, south, east - west, north - south)
        """The smallest rectangle that may hold its cells; without cells if no centre lies in it."""

    @classmethod
    def of_region(cls, region: Region, lattice: Lattice) -> "Polygon":
        """That of a region's corners.

        Raises:
            BadParameter: the region is inverted, empty or not finite.
        """
        xmin, ymin, xmax, ymax = region
        if not (xmin < xmax and ymin < ymax):
            raise BadParameter("region: xmin < xmax and ymin < ymax are needed")
        return cls([(xmin, ymin), (xmax, ymin), (xmax, ymax), (xmin, ymax)], lattice)

    def inside(self, rect: CellRect) -> NDArray[np.bool_]:
        """Which cells of `rect` have their centre inside: [iy, ix], row 0 south."""
        # True in the first cell whose centre is not left of an edge: from there on the inside is outside.
        turns = np.zeros((rect.height, rect.width + 1), np.bool_)
        for k, corner in enumerate(self._corners):
            (x0, y0), (x1, y1) = sorted((self._corners[k - 1], corner), key=lambda point: point[1])
            first, end = max(math.ceil(y0), rect.iy), min(math.ceil(y1), rect.iy + rect.height)
            if first >= end:
                continue
            rows = np.arange(first, end)
            crossed = x0 + (rows - y0) * (x1 - x0) / (y1 - y0)
            columns = np.clip(np.ceil(crossed).astype(np.int64) - rect.ix, 0, rect.width)
            turns[rows - rect.iy, columns] ^= True
        return np.logical_xor.accumulate(turns[:, :-1], axis=1)
