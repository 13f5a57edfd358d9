"""Held-out beams: what scans that are not in a map have measured, as rays in the map frame."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.grid_settings import GridSettings
from ogm_core.sensor_models.beams import HIT, BeamModel, classify
from ogm_core.sensor_models.projection import beam_model, read_only, sensor_poses
from ogm_core.types import PlacedScan, Ranges

X, Y, DX, DY, RANGE = range(5)
"""Columns of rays: where they start, m; their direction, a unit vector; what was measured, m."""


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutBeams:
    """The returns of held-out scans; no returns and what does not count are left out.

    `rays`: float64, shape (n, 5), see X to RANGE. `scans`: of which scan each is, numbered as they were held
    out, shape (n,). `readings`: how many beams each scan had, whatever they have measured.
    """

    rays: NDArray[np.float64]
    scans: NDArray[np.int64]
    readings: NDArray[np.int64]

    def part(self, wanted: NDArray[np.bool_]) -> "HeldOutBeams":
        """Those of some scans; `wanted`: whether each is one of them. Numbers stay."""
        rays = wanted[self.scans]
        return HeldOutBeams(self.rays[rays], self.scans[rays], np.where(wanted, self.readings, 0))


def beams_of(scans: Sequence[PlacedScan], settings: GridSettings) -> HeldOutBeams:
    """The returns of some scans, of any length: which beams count is the map's to say, `reach` is not."""
    rays = [returns_of(placed, settings) for placed in scans]
    return HeldOutBeams(
        np.concatenate([np.empty((0, 5)), *rays]),
        np.repeat(np.arange(len(rays)), [len(part) for part in rays]),
        np.array([placed.scan.ranges.size for placed in scans], np.int64),
    )


def returns_of(placed: PlacedScan, settings: GridSettings, every: int = 1) -> NDArray[np.float64]:
    """The returns among the beams of a scan, or among one in `every`, as rays."""
    beam = beam_model(placed.scan, settings)._replace(reach=math.inf)
    rays: NDArray[np.float64] = collect_returns(
        read_only(placed.scan.ranges), beam, sensor_poses(placed), every
    )
    return rays


@njit(cache=True, nogil=True, error_model="numpy")
def collect_returns(
    ranges: Ranges, beam: BeamModel, sensor: NDArray[np.float64], every: int
) -> NDArray[np.float64]:
    """Rays of the beams that are hits; `sensor` as in `beams.project`."""
    rays = np.empty((ranges.size, 5))
    n = 0
    for k in range(0, ranges.size, every):
        measured = float(ranges[k])
        kind, _ = classify(measured, beam)
        if kind != HIT:
            continue
        p = k if len(sensor) > 1 else 0
        bearing = sensor[p, 2] + (beam.angle_min + k * beam.angle_increment)
        if not math.isfinite(bearing):
            continue
        rays[n, X], rays[n, Y] = sensor[p, 0], sensor[p, 1]
        rays[n, DX], rays[n, DY] = math.cos(bearing), math.sin(bearing)
        rays[n, RANGE] = measured
        n += 1
    return rays[:n].copy()
