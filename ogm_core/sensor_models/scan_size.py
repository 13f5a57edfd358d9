"""Size of a scan in cells: how many its beams speak of, told from its ranges alone, before it has a pose.

A beam of `beam` speaks of the cells along its free length, a scan of `sector` of the cells of its area and of
those along its outline: these are what integrating it takes time for. Lengths in metres.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.grid_settings import GridSettings
from ogm_core.sensor_models.beams import BeamModel, reading
from ogm_core.sensor_models.projection import read_only
from ogm_core.types import Scan


class ScanSize:
    """Sizes of scans for one map; `bounded`: what surely lies beyond its bounds is not counted."""

    def __init__(self, settings: GridSettings, *, bounded: bool = True) -> None:
        self._sector = settings.sensor_model == "sector"
        self._alpha, self._clear_range, self._reach = settings.distances
        self._resolution = float(settings.resolution)
        bounds = settings.bounds_rect
        self._longest, self._largest = math.inf, math.inf
        if bounds is not None and bounded:
            self._longest, self._largest = float(bounds.width + bounds.height), float(bounds.cells)

    def of(self, scan: Scan) -> float:
        """How many cells a scan speaks of, about."""
        near, far = float(scan.range_min), float(scan.range_max)
        ranges, increment = read_only(scan.ranges), float(scan.angle_increment)
        return self.cells(ranges, increment, near, far, scan.clear_range, scan.reach)

    def at_most(self, scan: Scan) -> float:
        """Of how many cells a scan may speak, whatever its ranges are, about."""
        reach = self._reach if scan.reach is None else scan.reach
        length = min(min(float(scan.range_max), reach) / self._resolution, self._longest)
        along = scan.ranges.size * length
        if not self._sector:
            return along
        turn = min(scan.ranges.size * abs(float(scan.angle_increment)), math.tau)
        return along + min(turn * length * length / 2.0, self._largest)

    def cells(
        self,
        ranges: NDArray[np.float32],
        angle_increment: float,
        range_min: float,
        range_max: float,
        clear_range: float | None = None,
        reach: float | None = None,
        *,
        beyond_clears: bool = False,
    ) -> float:
        """How many cells a scan speaks of, about; `clear_range` and `reach` take the place of the map's.

        `beyond_clears`: a finite range above range_max is no return; else it is no reading.
        """
        clear_range = self._clear_range if clear_range is None else clear_range
        reach = self._reach if reach is None else reach
        cells, area = _cells(
            ranges,
            (range_min, range_max, self._alpha, clear_range, reach),
            (abs(angle_increment), self._resolution, self._longest),
            self._sector,
            beyond_clears,
        )
        return float(cells + min(area, self._largest))


@njit(cache=True, error_model="numpy")
def _cells(
    ranges: NDArray[np.float32],
    distances: tuple[float, float, float, float, float],
    lattice: tuple[float, float, float],
    sector: bool,
    beyond_clears: bool,
) -> tuple[float, float]:
    """Cells along the beams, or along the outline of what they see, and cells of that area."""
    range_min, range_max, alpha, clear_range, reach = distances
    beam = BeamModel(0.0, 0.0, range_min, range_max, alpha, clear_range, reach)
    increment, resolution, longest = lattice
    along = area = before = farthest = 0.0
    for k in range(ranges.size):
        r = float(ranges[k])
        if beyond_clears and r > range_max:
            r = math.inf
        length = min(reading(r, beam)[2] / resolution, longest)
        along += abs(length - before) if sector else length
        area += length * length
        before = length
        farthest = max(farthest, length)
    if not sector:
        return along, 0.0
    circle = math.pi * farthest * farthest  # which more than a turn does not leave
    return along, min(area * increment / 2.0, circle)
