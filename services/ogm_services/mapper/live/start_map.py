"""Initial map of a mapper: empty, or filled from a file: a ROS map, or a map that was saved as NPZ."""

import logging
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.classes import trinary
from ogm_core.cells.log_odds import PLANE, LogOdds
from ogm_core.cells.model import CellModel, Planes, StoredCells, cell_bytes
from ogm_core.cells.rate import PLANES, Rate
from ogm_core.cells.thresholds import OCCUPIED_ABOVE
from ogm_core.errors import BadMapFile, BadSetting, LimitReached, OutsideBounds
from ogm_core.files.counted_maps import CountedMap, load_counts
from ogm_core.files.map_files import MAX_NPZ_BYTES, NpzMap, load_npz
from ogm_core.grid import OccupancyGrid
from ogm_core.lattice import SAME_RESOLUTION
from ogm_core.separate_grid import grid_of
from ogm_services.settings.settings import Settings, is_npz

if TYPE_CHECKING:
    from ogm_core.files.ros_map_reader import RosMap

log = logging.getLogger(__name__)
_AWAY = 0.002
"""Stored cells are rounded: what is undecided keeps this far away from "occupied" and "free"."""


def started_grid(settings: Settings, epoch: str, run: str = "") -> OccupancyGrid:
    """The map that the settings describe, before any scan; `epoch` and `run` as `OccupancyGrid` has them.

    With `mapper.start_map` the lattice is the file's: its resolution, and its anchor; a ROS map's is its
    origin.

    Raises:
        BadMapFile: the file or its picture is not what is needed.
        BadSetting: it contradicts the settings: another resolution, beyond the limits, a confidence too low,
            log odds that these cells cannot have.
    """
    path = settings.mapper.start_map
    if path is None:
        return grid_of(settings.mapper_grid_settings(), epoch, run)
    try:
        return (_grid_of_npz if is_npz(path) else _grid_of_ros_map)(settings, epoch, run, path)
    except LimitReached as error:
        raise BadSetting(
            f"mapper.start_map: {path}: {error}; raise the limit, or start with a smaller map"
        ) from error


def _grid_of_ros_map(settings: Settings, epoch: str, run: str, path: Path) -> OccupancyGrid:
    # Here, because what reads pictures loads slowly, and most maps start empty.
    from ogm_core.files.ros_map_reader import read_ros_map

    ros_map = read_ros_map(path, log.warning)
    _check_not_turned(ros_map, path)
    _check_resolution(settings, ros_map.resolution, path)
    grid_settings = replace(settings.grid_settings(), resolution=ros_map.resolution, anchor=ros_map.origin)
    grid = grid_of(grid_settings, epoch, run)
    cells = start_cells(ros_map.occupancy, _log_odds(grid.model), settings.mapper.start_confidence)
    grid.begin_with({PLANE: cells})
    return grid


def _grid_of_npz(settings: Settings, epoch: str, run: str, path: Path) -> OccupancyGrid:
    """The map that was saved, value for value, on its lattice.

    Known cells keep their log odds, whatever the prior is now; of a model that counts, the counts stay.
    """
    model = settings.map.made_cell_model()
    cell = max(sum(map(cell_bytes, model.planes)), np.dtype(np.float64).itemsize)
    largest = max(settings.mapper.max_cells * cell, MAX_NPZ_BYTES)
    counted = load_counts(path, PLANES, max_bytes=largest)
    if counted is None and isinstance(model, LogOdds):
        npz = load_npz(path, max_bytes=largest)
        grid = _grid_on_lattice_of(npz, "log odds", settings, epoch, run, path)
        _begin(grid, {PLANE: _cells_of_npz(npz, model, path)}, npz.offset, path)
        return grid
    if counted is None or not isinstance(model, Rate):
        saved = "log_odds" if counted is None else "rate"
        raise BadSetting(
            f"map.cell_model is {settings.map.cell_model}, but mapper.start_map {path} was saved by a map of "
            f"{saved} cells: give --cell-model {saved}"
        )
    grid = _grid_on_lattice_of(counted, "counts", settings, epoch, run, path)
    _begin(grid, counted.planes, counted.offset, path)
    return grid


def _grid_on_lattice_of(
    saved: NpzMap | CountedMap, values: str, settings: Settings, epoch: str, run: str, path: Path
) -> OccupancyGrid:
    """An empty map on the lattice of one that was saved, as the settings say."""
    _check_resolution(settings, saved.resolution, path)
    if "start_confidence" in settings.mapper.model_fields_set:
        raise BadSetting(
            f"mapper.start_confidence: {path} has its cells' {values}, which stay as they are: leave it out"
        )
    grid_settings = replace(settings.grid_settings(), resolution=saved.resolution, anchor=saved.anchor)
    grid = grid_of(grid_settings, epoch, run)
    if grid.lattice.anchor != saved.anchor:
        raise BadSetting(
            f"map.bounds: they begin at {grid.lattice.anchor}, and the cells of mapper.start_map {path} are "
            f"counted from {saved.anchor}: give the bounds of the map that was saved, or none"
        )
    return grid


def _begin(grid: OccupancyGrid, planes: Planes, offset: tuple[int, int], path: Path) -> None:
    try:
        grid.begin_with(planes, offset)
    except OutsideBounds as error:
        raise BadSetting(
            f"map.bounds: {error} (mapper.start_map {path}): widen them, or give none"
        ) from error


def _cells_of_npz(npz: NpzMap, model: LogOdds, path: Path) -> StoredCells:
    """Stored cells that are served again as what the file holds.

    Raises:
        BadSetting: there are none, with this type, prior or clamps.
    """
    saved_as = "float64" if npz.log_odds.dtype == np.float64 else "int16"
    if model.cells != saved_as:
        raise BadSetting(
            f"map.cells is {model.cells}, but mapper.start_map {path} was saved by a map of {saved_as} "
            f"cells: give --cells {saved_as}"
        )
    known = ~np.isnan(npz.log_odds)
    with np.errstate(invalid="ignore"):
        cells = model.store(np.where(known, npz.log_odds, model.l0).astype(np.float64), known)
    served = model.log_odds(cells).astype(npz.log_odds.dtype)
    wrong = np.argwhere(known & (served != npz.log_odds))
    if len(wrong):
        iy, ix = wrong[0].tolist()
        raise BadSetting(
            f"mapper.start_map: {path} was saved with another map.p_prior, map.l_min or map.l_max: the log "
            f"odds {npz.log_odds[iy, ix]:.9g} of its cell ({npz.offset[0] + ix}, {npz.offset[1] + iy}) would "
            f"become {served[iy, ix]:.9g} ({len(wrong)} cells in all): give those that it was saved with"
        )
    return cells


def _log_odds(model: CellModel) -> LogOdds:
    if not isinstance(model, LogOdds):
        raise BadSetting(
            "mapper.start_map: a ROS map starts a map of log odds: leave out map.cell_model, or start with a "
            "map.npz that was saved by a map of the same model"
        )
    return model


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


def start_cells(occupancy: NDArray[np.int8], model: LogOdds, confidence: float) -> StoredCells:
    """Stored cells of a ROS map's occupancy, of the same shape: 0 to 100, or -1 for unknown.

    p = occupancy / 100, limited to [1 - confidence, confidence], and to the model's clamps. Every cell keeps
    its class: occupied (p > 0.65), free (below the model's `free_below`), neither or unknown.

    Raises:
        BadSetting: that confidence, or these clamps, do not allow that.
    """
    said = np.arange(101) / 100.0
    p = np.clip(said, 1.0 - confidence, confidence)
    free_below = model.free_below
    p = np.where(said > OCCUPIED_ABOVE, p, np.minimum(p, OCCUPIED_ABOVE - _AWAY))
    p = np.where(said < free_below, p, np.maximum(p, free_below + _AWAY))
    # One entry more, for unknown: -1 is the last one's index.
    known = np.append(np.ones(101, np.bool_), False)
    table = model.store(np.append(np.log(p / (1.0 - p)), 0.0), known)
    stored = model.probability(table)
    wanted = trinary(np.append(said, 0.0), known, free_below)
    if not np.array_equal(trinary(stored, known, free_below), wanted):
        raise BadSetting(
            f"mapper.start_confidence: with {confidence:g} and the clamps map.l_min and map.l_max, occupied "
            f"cells would start at p = {stored[100]:.4g} and free ones at {stored[0]:.4g}; more than "
            f"{OCCUPIED_ABOVE} and less than {free_below} are needed: raise it, or leave the clamps alone"
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
