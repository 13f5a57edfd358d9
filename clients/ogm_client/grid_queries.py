"""Queries of a grid: what its cells mean for who moves among them, computed here, without a mapper."""

import math
from collections.abc import Sequence
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ogm_client.footprints import footprints_of
from ogm_client.map_layer import MapLayer
from ogm_client.raycast import WORDS, Ray, Rays, Unknown, goes_through
from ogm_core.cells.classes import trinary
from ogm_core.cells.log_odds import probability_of
from ogm_core.errors import BadParameter
from ogm_core.lattice import CellRect, Lattice
from ogm_core.queries.distances import distances, inflated
from ogm_core.queries.footprints import WORDS as STATES
from ogm_core.queries.footprints import Footprints
from ogm_core.queries.rays import RayCaster


class GridQueries:
    """What is computed from the cells of a `MapGrid`, whose fields these are."""

    __slots__ = ()

    log_odds: NDArray[np.floating[Any]]
    resolution: float
    anchor: tuple[float, float]
    offset: tuple[int, int]
    epoch: str
    revision: int
    stamp: int | None
    run: str
    free_below: float

    @overload
    def raycast(
        self, x: float, y: float, theta: float, max_range: float = math.inf, *, unknown: Unknown = "stop"
    ) -> Ray: ...
    @overload
    def raycast(
        self,
        x: float,
        y: float,
        theta: NDArray[Any] | Sequence[float],
        max_range: float = math.inf,
        *,
        unknown: Unknown = "stop",
    ) -> Rays: ...
    def raycast(
        self,
        x: float,
        y: float,
        theta: float | NDArray[Any] | Sequence[float],
        max_range: float = math.inf,
        *,
        unknown: Unknown = "stop",
    ) -> Ray | Rays:
        """What a beam from the point (x, y), m, along `theta` would read in this map.

            wall = grid.raycast(1.0, 2.0, math.pi / 2).range
            scan = grid.raycast(x, y, theta + bearings, max_range=30.0).range

        `theta` in rad, counter-clockwise from the map's x axis; of an array, a ray each, and the result's
        arrays have its shape. A ray ends where it enters the first cell that is not free, as `occupancy` has
        it, at the latest where it leaves this grid, or after `max_range` m. With `unknown="pass"` only
        occupied cells end it, and beyond this grid there is none. The cell that it starts in is not asked.
        (Amanatides & Woo 1987.)

        Raises:
            BadParameter: the point or `theta` is not finite, the point lies outside this grid, or
                `max_range` is not positive.
            MapEmpty: there is no cell.
        """
        bearings = np.asarray(theta, np.float64)
        if not np.isfinite(bearings).all():
            raise BadParameter("theta: finite radians are needed")
        caster = RayCaster(
            *(self.log_odds, Lattice(self.resolution, self.anchor), self.offset, (x, y), max_range),
            through_unknown=goes_through(unknown),
            free_below=self.free_below,
        )
        rays = [caster.cast(bearing) for bearing in bearings.ravel().tolist()]
        told = [Ray(distance, WORDS[found]) for found, distance in rays]
        return told[0] if bearings.ndim == 0 else Rays.of(told, bearings.shape)

    def check(
        self,
        points: ArrayLike | None = None,
        *,
        footprints: Sequence[ArrayLike] | None = None,
        margin: float = 0.0,
    ) -> NDArray[np.str_]:
        """Whether points (x, y), or the polygons of `footprints`, m, are free in this map.

            grid.check([(1.5, 0.5), (2.0, 0.5)], margin=0.25)
            grid.check(footprints=[[(1.2, 0.3), (1.8, 0.3), (1.8, 0.7), (1.2, 0.7)]], margin=0.05)

        Of each, in their order: "occupied" if it, grown by `margin` m, meets an occupied cell, as `occupancy`
        has it, edges included; else "unknown" if it meets one that is unknown or undecided, or beyond this
        grid; else "free". What is within 1e-6 cells is met.

        Raises:
            BadParameter: not one of the two is given, or it is something else, there are too many, or they
                meet too many cells.
        """
        asked = Footprints(footprints_of(points, footprints), margin, Lattice(self.resolution, self.anchor))
        height, width = self.log_odds.shape
        whole = CellRect(*self.offset, width, height)
        part = asked.rect.intersection(whole)
        south, west = part.iy - whole.iy, part.ix - whole.ix
        log_odds = self.log_odds[south : south + part.height, west : west + part.width]
        if not part.cells:
            log_odds = self.log_odds[:0]
        states = asked.states(trinary(probability_of(log_odds), ~np.isnan(log_odds), self.free_below), part)
        return np.array([STATES[state] for state in states.tolist()], np.str_)

    def distance(self, max_distance: float = math.inf) -> MapLayer:
        """How far the nearest occupied cell is, of every cell: metres between their centres, float32.

        Occupied cells are those of this grid, as `occupancy` has it. What is farther than `max_distance` m
        has just that; where nothing is occupied, and without it, distances are infinite. Unknown cells have
        distances, too. It is computed by SciPy.

        Raises:
            BadParameter: `max_distance` is below 0.001 m.
            MissingExtra: SciPy is not installed.
        """
        states, whole = self._states()
        return self._layer(distances(states, whole, self.resolution, max_distance))

    def inflate(self, radius: float) -> MapLayer:
        """`occupancy`, int8, with all occupied, 100, within `radius` m of an occupied cell.

        From centre to centre; unknown cells become occupied, too. It is computed by SciPy.

        Raises:
            BadParameter: the radius is not 0 to 100 m.
            MissingExtra: SciPy is not installed.
        """
        states, whole = self._states()
        return self._layer(inflated(states, whole, self.resolution, radius))

    def _states(self) -> tuple[NDArray[np.int8], CellRect]:
        height, width = self.log_odds.shape
        states = trinary(probability_of(self.log_odds), ~np.isnan(self.log_odds), self.free_below)
        return states, CellRect(0, 0, width, height)

    def _layer(self, values: NDArray[Any]) -> MapLayer:
        place = self.resolution, self.anchor, self.offset
        return MapLayer(values, *place, self.epoch, self.revision, self.stamp, self.run)
