"""Initial map of a mapper: empty, or filled from a ROS map file."""

import logging
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.classes import FREE_BELOW, OCCUPIED_ABOVE, trinary
from ogm_core.cells.log_odds import PLANE, LogOdds
from ogm_core.cells.model import CellModel, Planes, StoredCells
from ogm_core.errors import BadMapFile, BadSetting, LimitReached
from ogm_core.grid import OccupancyGrid
from ogm_services.settings.settings import Settings

if TYPE_CHECKING:
    from ogm_core.files.ros_map_reader import RosMap

SAME_RESOLUTION = 1e-6
"""Resolutions that differ by no more, relatively, are one: files round them."""
log = logging.getLogger(__name__)
_UNDECIDED_UP_TO = OCCUPIED_ABOVE - 0.002
"""Stored cells are rounded: what is undecided keeps this far away from "occupied"."""


def started_grid(settings: Settings, epoch: str) -> OccupancyGrid:
    """The map that the settings describe, before any scan.

    With `mapper.start_map` the lattice is the file's: its resolution, and its origin as the anchor.

    Raises:
        BadMapFile: the file or its picture is not what is needed.
        BadSetting: it contradicts the settings: another resolution, beyond the limits, a confidence too low.
    """
    path = settings.mapper.start_map
    if path is None:
        return OccupancyGrid(settings.grid_settings(), epoch)
    # Here, because what reads pictures loads slowly, and most maps start empty.
    from ogm_core.files.ros_map_reader import read_ros_map

    ros_map = read_ros_map(path, log.warning)
    _check_not_turned(ros_map, path)
    _check_resolution(settings, ros_map.resolution, path)
    grid_settings = replace(settings.grid_settings(), resolution=ros_map.resolution, anchor=ros_map.origin)
    grid = OccupancyGrid(grid_settings, epoch)
    try:
        grid.begin_with(_start_planes(ros_map.occupancy, grid.model, settings.mapper.start_confidence))
    except LimitReached as error:
        raise BadSetting(
            f"mapper.start_map: {path}: {error}; raise the limit, or start with a smaller map"
        ) from error
    return grid


def _check_not_turned(ros_map: "RosMap", path: Path) -> None:
    if not ros_map.yaw:
        return
    height, width = ros_map.occupancy.shape
    c, s = math.cos(ros_map.yaw), math.sin(ros_map.yaw)
    x, y = (
        edge + ros_map.resolution * (min(0.0, width * along) + min(0.0, height * up))
        for edge, along, up in zip(ros_map.origin, (c, s), (-s, c), strict=True)
    )
    raise BadMapFile(
        f"{path}: origin: the map is turned by {ros_map.yaw:g} rad, and the cells of a start map lie along "
        f"the axes: turn its picture counter-clockwise by {math.degrees(ros_map.yaw):.6g} degrees, without "
        f"mixing greys and with 205 (unknown) around it, and set origin to [{x:.6g}, {y:.6g}, 0]"
    )


def _start_planes(occupancy: NDArray[np.int8], model: CellModel, confidence: float) -> Planes:
    if not isinstance(model, LogOdds):
        raise BadSetting(
            "mapper.start_map: a ROS map starts a map of log odds: leave it out, or map.cell_model"
        )
    return {PLANE: start_cells(occupancy, model, confidence)}


def start_cells(occupancy: NDArray[np.int8], model: LogOdds, confidence: float) -> StoredCells:
    """Stored cells of a ROS map's occupancy, of the same shape: 0 to 100, or -1 for unknown.

    p = occupancy / 100, limited to [1 - confidence, confidence], and to the model's clamps. Every cell keeps
    its class: occupied (p > 0.65), free (p < 0.196), neither or unknown.

    Raises:
        BadSetting: that confidence, or these clamps, do not allow that.
    """
    said = np.arange(101) / 100.0
    p = np.clip(said, 1.0 - confidence, confidence)
    p = np.where(said > OCCUPIED_ABOVE, p, np.minimum(p, _UNDECIDED_UP_TO))
    # One entry more, for unknown: -1 is the last one's index.
    known = np.append(np.ones(101, np.bool_), False)
    table = model.store(np.append(np.log(p / (1.0 - p)), 0.0), known)
    stored = model.probability(table)
    if not np.array_equal(trinary(stored, known), trinary(np.append(said, 0.0), known)):
        raise BadSetting(
            f"mapper.start_confidence: with {confidence:g} and the clamps map.l_min and map.l_max, occupied "
            f"cells would start at p = {stored[100]:.4g} and free ones at {stored[0]:.4g}; more than "
            f"{OCCUPIED_ABOVE} and less than {FREE_BELOW} are needed: raise it, or leave the clamps alone"
        )
    cells: StoredCells = table[occupancy]
    return cells


def _check_resolution(settings: Settings, resolution: float, path: Path) -> None:
    given = settings.map.resolution
    if "resolution" in settings.map.model_fields_set and not math.isclose(
        given, resolution, rel_tol=SAME_RESOLUTION
    ):
        raise BadSetting(
            f"map.resolution is {given!r} m, but the cells of mapper.start_map {path} are {resolution!r} m: "
            "leave map.resolution out"
        )
