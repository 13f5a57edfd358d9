"""Maps as classes of cells: occupied, free, undecided or unknown, whatever file they were saved in."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.compiled import compiled
from ogm_core.cells.log_odds import probability_of
from ogm_core.cells.rate import PLANES, Rate
from ogm_core.errors import BadMapFile
from ogm_core.files.counted_maps import CountedMap, load_counts
from ogm_core.files.map_files import MAX_NPZ_BYTES, Place, load_npz
from ogm_core.lattice import SAME_RESOLUTION, Lattice
from ogm_core.quality.judged_map import four_classes
from ogm_core.snapshot import MapSnapshot

CLASSES = ("unknown", "free", "undecided", "occupied")
"""Names of the classes, by their number (`judged_map.four_classes`)."""


@dataclass(frozen=True, slots=True, eq=False)
class ClassMap:
    """Classes of a map's cells, [iy, ix], row 0 south, where they lie, and what the map is called.

    Free is what the map itself calls so. `coarse`: the same map, if it counts, in the cells in which
    beams were counted, twice as wide.
    """

    classes: NDArray[np.uint8]
    place: Place
    name: str
    coarse: "ClassMap | None" = None


def read_class_map(path: Path, tell: Callable[[str], None] = lambda _: None) -> ClassMap:
    """Read a map.npz that was saved here, or else the YAML file of a ROS map.

    `tell` as in `read_ros_map`.

    Raises:
        BadMapFile: it cannot be read, is something else, or is a ROS map that is turned.
    """
    if path.suffix.lower() == ".npz":
        counted = load_counts(path, PLANES, max_bytes=MAX_NPZ_BYTES)
        return _of_log_odds(path) if counted is None else _of_counts(counted, path)
    # Here, because what reads pictures loads slowly.
    from ogm_core.files.ros_map_reader import read_ros_map

    ros_map = read_ros_map(path, tell)
    if ros_map.yaw:
        raise BadMapFile(
            f"{path}: origin: the map is turned by {ros_map.yaw:g} rad; maps along the axes are compared"
        )
    known = ros_map.occupancy >= 0
    classes = four_classes(ros_map.occupancy / 100.0, known)
    return ClassMap(classes, Place(ros_map.resolution, ros_map.origin, (0, 0)), str(path))


def _of_log_odds(path: Path) -> ClassMap:
    npz = load_npz(path)
    classes = four_classes(probability_of(npz.log_odds), ~np.isnan(npz.log_odds), npz.free_below)
    return ClassMap(classes, Place(npz.resolution, npz.anchor, npz.offset), str(path))


def _of_counts(counted: CountedMap, path: Path) -> ClassMap:
    """Classes of the cells that counts tell of: exact, as log odds that are rounded are not."""
    cells = CellArrays(counted.planes, {plane.name: plane.side for plane in PLANES})
    lattice = Lattice(counted.resolution, counted.anchor)
    model = compiled(Rate(free_below=counted.free_below))
    coarse = MapSnapshot(cells, model, lattice, counted.offset, "", 0, None)
    return _of_snapshot(coarse.finest(), str(path), _of_snapshot(coarse, str(path)))


def _of_snapshot(snapshot: MapSnapshot, name: str, coarse: ClassMap | None = None) -> ClassMap:
    place = Place(snapshot.resolution, snapshot.lattice.anchor, snapshot.offset)
    return ClassMap(snapshot.encode(four_classes), place, name, coarse)


def in_cells_of_one_size(first: ClassMap, second: ClassMap) -> tuple[ClassMap, ClassMap]:
    """Both maps, one that counts in its wider cells, if these are as wide as the other's."""
    if first.coarse is not None and _as_wide(first.coarse, second):
        return first.coarse, second
    if second.coarse is not None and _as_wide(second.coarse, first):
        return first, second.coarse
    return first, second


def _as_wide(one: ClassMap, other: ClassMap) -> bool:
    return math.isclose(one.place.resolution, other.place.resolution, rel_tol=SAME_RESOLUTION)
