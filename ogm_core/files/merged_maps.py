"""Merged maps: saved maps of counts added up to the map of all of their scans, count for count.

The order in which they are given makes no difference: every count is a sum over beams.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.compiled import compiled
from ogm_core.cells.model import cell_bytes
from ogm_core.cells.rate import PLANES, Rate
from ogm_core.cells.rate_sums import add_counts
from ogm_core.cells.thresholds import OCCUPIED_ABOVE
from ogm_core.errors import BadMapFile
from ogm_core.files.counted_maps import CountedMap, load_counts
from ogm_core.grid_settings import DEFAULT_MAX_CELLS
from ogm_core.lattice import CellRect, Lattice
from ogm_core.snapshot import MapSnapshot

_SIDES = {plane.name: plane.side for plane in PLANES}


def merge_maps(paths: Sequence[Path], *, max_cells: int = DEFAULT_MAX_CELLS) -> MapSnapshot:
    """The map of all scans of these maps, which were saved as NPZ; one is in memory at a time.

    It covers the smallest rectangle that holds them all, and its `free_below` is the smallest of theirs.

    Raises:
        BadMapFile: one cannot be read, keeps no counts or has forgotten some, or is not of the first one's
            lattice; or together they cover more than `max_cells`, as no map may.
    """
    sums, free_below = None, OCCUPIED_ABOVE
    for path in paths:
        found = _counts(path, max_cells)
        free_below = min(free_below, found.free_below)
        if sums is not None:
            _check_lattice(found, sums, path, paths[0])
            sums = _widened(sums, found, path, max_cells)
            _add(sums, found)
        else:
            sums = found
    if sums is None:
        raise BadMapFile("there is no map to merge")
    cells = CellArrays(sums.planes, _SIDES)
    lattice = Lattice(sums.resolution, sums.anchor)
    return MapSnapshot(cells, compiled(Rate(free_below=free_below)), lattice, sums.offset, "", 0, None)


def _counts(path: Path, max_cells: int) -> CountedMap:
    found = load_counts(path, PLANES, max_bytes=max_cells * sum(map(cell_bytes, PLANES)))
    if found is None:
        raise BadMapFile(
            f"{path}: it keeps no counts, and log odds do not add up, as each was clamped on its way: build "
            "the maps to merge with --cell-model rate"
        )
    if found.forgets:
        raise BadMapFile(
            f"{path}: its counts were halved with every half-life that passed, so they are no sums over its "
            "scans, and do not add up: build the maps to merge without --half-life"
        )
    return found


def _check_lattice(found: CountedMap, first: CountedMap, path: Path, first_path: Path) -> None:
    if found.resolution != first.resolution:
        raise BadMapFile(
            f"{path}: its scans were counted in cells of {found.resolution!r} m, those of {first_path} in "
            f"cells of {first.resolution!r} m: maps of one resolution can be merged"
        )
    if found.anchor != first.anchor:
        raise BadMapFile(
            f"{path}: its cells are counted from {found.anchor}, those of {first_path} from {first.anchor}: "
            "maps of one lattice can be merged: build them without --bounds, or with the same"
        )


def _widened(sums: CountedMap, more: CountedMap, path: Path, max_cells: int) -> CountedMap:
    """The same counts over a rectangle that holds `more`, too."""
    known = [rect for rect in (_rect(sums), _rect(more)) if rect.cells]
    whole = known[0].union(known[-1]) if known else _rect(sums)
    if whole == _rect(sums):
        return sums
    if whole.cells > max_cells:
        raise BadMapFile(
            f"{path}: with it the map would be {whole.width} x {whole.height} cells large, and {max_cells} "
            "cells are the most: it lies too far from the others"
        )
    planes = {
        plane.name: np.zeros((whole.height * plane.side, whole.width * plane.side), plane.dtype)
        for plane in PLANES
    }
    wide = CountedMap(planes, sums.resolution, sums.anchor, (whole.ix, whole.iy))
    _add(wide, sums)
    return wide


def _add(sums: CountedMap, more: CountedMap) -> None:
    """Add counts of cells that all lie in `sums`."""
    here, there = _rect(sums), _rect(more)
    if not there.cells:
        return
    row, column = there.iy - here.iy, there.ix - here.ix
    part = {
        name: sums.planes[name][
            row * side : (row + there.height) * side, column * side : (column + there.width) * side
        ]
        for name, side in _SIDES.items()
    }
    add_counts(part, more.planes)


def _rect(counts: CountedMap) -> CellRect:
    height, width = counts.planes["N"].shape
    return CellRect(*counts.offset, width, height)
