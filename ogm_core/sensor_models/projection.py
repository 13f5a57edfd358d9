"""Projection of a placed scan onto a map's lattice: the kernels of `beams`, by name."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import LimitReached
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Lattice
from ogm_core.sensor_models import beams
from ogm_core.types import PlacedScan, Ranges, Scan


class Beams(NamedTuple):
    """The beams of a scan on a lattice.

    `ends` is int64, shape (5, N): the end cell's ix and iy, the kind, the start cell's ix and iy, in the rows
    IX, IY, KIND, IX0 and IY0 of `beams`; a skipped beam has its kind only. `lines` is float64, shape (4, N),
    or (4, 0) where nobody needs it: how far ahead of the start point, in x and in y, the edge of its cell
    lies, and the vector from the start to the end point; in cells.
    """

    ends: NDArray[np.int64]
    lines: NDArray[np.float64]


def beam_model(scan: Scan, settings: GridSettings) -> beams.BeamModel:
    """Gather a scan's and a map's parameters; the scan's own distances come first."""
    alpha, clear_range, reach = settings.distances
    return beams.BeamModel(
        float(scan.angle_min),
        float(scan.angle_increment),
        float(scan.range_min),
        float(scan.range_max),
        alpha,
        clear_range if scan.clear_range is None else float(scan.clear_range),
        reach if scan.reach is None else float(scan.reach),
    )


def sensor_poses(placed: PlacedScan) -> NDArray[np.float64]:
    """The sensor's poses in the map frame: shape (N, 3) if its sweep is known, else (1, 3)."""
    return np.array([placed.pose], np.float64) if placed.sweep is None else placed.sweep.beams


@lru_cache(maxsize=16)
def directions(angle_min: float, angle_increment: float, count: int) -> NDArray[np.float64]:
    """Cosine and sine of every beam's bearing in the sensor's frame, shape (2, count), read-only."""
    with np.errstate(over="ignore", invalid="ignore"):  # a bearing that is not finite has neither
        bearings = angle_min + np.arange(count) * angle_increment
        found = np.stack((np.cos(bearings), np.sin(bearings)))
    found.flags.writeable = False
    return found


def project(
    placed: PlacedScan, lattice: Lattice, settings: GridSettings, *, exact: bool = False, subcells: int = 1
) -> Beams:
    """Project a placed scan onto a lattice; with its lines if they are to be `exact`.

    With `subcells`, a power of two, points count in so many parts of a cell's side.

    Raises:
        LimitReached: the sensor or a beam's end is farther away than cells can be addressed.
    """
    ranges, model = read_only(placed.scan.ranges), tuple(beam_model(placed.scan, settings))
    onto = float(lattice.anchor[0]), float(lattice.anchor[1]), float(lattice.resolution) / subcells
    projected = Beams(np.empty((5, ranges.size), np.int64), np.empty((4, ranges.size if exact else 0)))
    if placed.sweep is None:
        x, y, theta = placed.pose
        sensor, turned = (float(x), float(y), float(theta)), directions(*model[:2], ranges.size)
        if beams.project_turned(ranges, model, sensor, onto, *projected, turned):
            return projected
    if not beams.project(ranges, model, sensor_poses(placed), onto, *projected):
        raise LimitReached(
            "the sensor or a beam's end is farther away than cells can be addressed: "
            "are its pose and ranges right?",
            "too_far",
        )
    return projected


def read_only(ranges: Ranges) -> Ranges:
    """The same ranges in the one form that the kernels are compiled for."""
    flags = ranges.flags
    if ranges.dtype == np.float32 and flags.c_contiguous and flags.aligned and not flags.writeable:
        return ranges
    view = ranges.view()
    if ranges.dtype != np.float32 or not (flags.c_contiguous and flags.aligned):
        view = np.require(ranges, np.float32, ["C", "A"]).view()
    view.flags.writeable = False
    return view
