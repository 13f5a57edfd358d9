"""The one binary file that every peer reads: see peers/workload.hpp."""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.workloads import Workload, settings_of
from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import BadParameter
from ogm_core.lattice import CellRect, Lattice
from ogm_core.types import PlacedScan


def write_workload(work: Workload, path: Path) -> CellRect:
    """Write a workload for the peers; return the cells that they map.

    Raises:
        BadParameter: the scans are not all of one kind, as the file wants it.
    """
    first = work.scans[0].scan
    if any(kind_of(placed) != kind_of(work.scans[0]) for placed in work.scans):
        raise BadParameter(f"workload {work.name}: its scans differ in beams, angles or limits")
    settings = settings_of(work, cells="float64")
    lattice, bounds = settings.lattice, settings.bounds_rect
    rect = bounds or cells_in_reach(work, lattice)
    model = LogOdds("float64")
    clear_range = math.inf if work.clear_range is None else work.clear_range
    header = [work.resolution, first.range_min, first.range_max, work.alpha, clear_range]
    header += [first.angle_min, first.angle_increment, *lattice.anchor, *rect, work.outside == "drop"]
    header += [model.d_free, model.d_occ, model.l_min, model.l_max, model.p_free, model.p_occ]
    header += [first.ranges.size, len(work.scans)]
    with path.open("wb") as file:
        file.write(np.array(header, "<f8").tobytes())
        for placed in work.scans:
            file.write(np.array(placed.pose, "<f8").tobytes())
            file.write(placed.scan.ranges.astype("<f4").tobytes())
    return rect


def kind_of(placed: PlacedScan) -> tuple[float, ...]:
    """What all scans of a workload file have in common."""
    scan = placed.scan
    return scan.ranges.size, scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max


def cells_in_reach(work: Workload, lattice: Lattice) -> CellRect:
    """A rectangle that holds every cell that the scans can touch, with room for rounding."""
    corners = []
    for scan, pose, _ in work.scans:
        lengths = np.clip(np.nan_to_num(scan.ranges.astype(np.float64)), 0.0, scan.range_max)
        bearings = pose.theta + scan.angle_min + scan.angle_increment * np.arange(lengths.size)
        x, y = pose.x + lengths * np.cos(bearings), pose.y + lengths * np.sin(bearings)
        corners.append(
            (min(pose.x, x.min()), min(pose.y, y.min()), max(pose.x, x.max()), max(pose.y, y.max()))
        )
    extremes = np.array(corners)
    ix, iy = lattice.cell_of(*extremes[:, :2].min(axis=0).tolist())
    right, top = lattice.cell_of(*extremes[:, 2:].max(axis=0).tolist())
    return CellRect(ix - 2, iy - 2, right - ix + 5, top - iy + 5)


def read_map(path: Path) -> tuple[CellRect, NDArray[np.float64]]:
    """The map that a peer dumped: its cells, and their log odds, [iy, ix], NaN where unknown."""
    values = np.fromfile(path, "<f8")
    rect = CellRect(*(int(value) for value in values[:4]))
    return rect, values[4:].reshape(rect.height, rect.width)
