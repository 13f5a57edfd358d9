"""A scan at its sensor's pose, projected onto a map's lattice: the kernels of ogm_core.beams, by name."""

import math

import numpy as np
from numpy.typing import NDArray

from ogm_core import beams
from ogm_core.errors import BadParameter, LimitReached
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Lattice
from ogm_core.types import Pose, Ranges, Scan

Ends = NDArray[np.int64]
"""End cell (ix, iy) and kind of every beam of a scan, shape (3, N)."""


def beam_model(scan: Scan, settings: GridSettings) -> beams.BeamModel:
    """Gather a scan's and a map's parameters; no limit becomes infinity."""
    return beams.BeamModel(
        float(scan.angle_min),
        float(scan.angle_increment),
        float(scan.range_min),
        float(scan.range_max),
        float(settings.alpha),
        math.inf if settings.clear_range is None else float(settings.clear_range),
        math.inf if settings.reach is None else float(settings.reach),
    )


def end_cells(
    scan: Scan, pose: Pose, lattice: Lattice, settings: GridSettings
) -> tuple[Ends, tuple[int, int]]:
    """End cells of a scan taken at the sensor's `pose` in the map frame, and the sensor's own cell.

    Raises:
        LimitReached: the sensor or a beam's end is farther away than cells can be addressed.
    """
    try:
        start = lattice.cell_of(pose.x, pose.y)
    except BadParameter as error:
        raise LimitReached(f"the sensor is out of reach: {error}") from error
    addressed, ends = beams.end_cells(
        read_only(scan.ranges),
        beam_model(scan, settings),
        float(pose.x),
        float(pose.y),
        float(pose.theta),
        float(lattice.anchor[0]),
        float(lattice.anchor[1]),
        float(lattice.resolution),
    )
    if not addressed:
        raise LimitReached("a beam ends farther away than cells can be addressed")
    return ends, start


def read_only(ranges: Ranges) -> Ranges:
    """The same ranges in the one form that the kernels are compiled for."""
    view = np.require(ranges, np.float32, ["C", "A"]).view()
    view.flags.writeable = False
    return view
