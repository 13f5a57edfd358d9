"""Maps for ROS 2: a snapshot as an OccupancyGrid, and what has changed since as an OccupancyGridUpdate."""

from typing import Literal

import numpy as np

from ogm_core.cells.classes import percent, trinary
from ogm_core.errors import MapEmpty
from ogm_core.ros2.cdr import OccupancyGrid, OccupancyGridUpdate
from ogm_core.snapshot import MapSnapshot

Values = Literal["trinary", "percent"]
_ENCODERS = {"trinary": trinary, "percent": percent}


def occupancy_grid(snap: MapSnapshot, values: Values = "trinary", *, frame: str = "map") -> OccupancyGrid:
    """A snapshot in ROS 2's terms; its origin is the lower-left corner of a cell of the map's lattice.

    With "trinary" a cell is 0, 100 or -1 by the thresholds of /map.pgm; with "percent" it is its probability
    of being occupied, 0 to 100, or -1 where unknown.

    Raises:
        MapEmpty: there is no known cell.
    """
    if snap.empty:
        raise MapEmpty("the map has no known cell yet")
    return OccupancyGrid(snap.stamp or 0, frame, snap.resolution, snap.origin, snap.encode(_ENCODERS[values]))


def same_extents(one: OccupancyGrid, other: OccupancyGrid) -> bool:
    """Whether two grids have the same cells, so that the one can be told as an update of the other."""
    return (one.frame, one.resolution, one.origin, one.data.shape) == (
        *(other.frame, other.resolution, other.origin),
        other.data.shape,
    )


def update_of(before: OccupancyGrid, after: OccupancyGrid) -> OccupancyGridUpdate | None:
    """The smallest rectangle of cells that holds all that differ, as they are after; None if none does.

    Raises:
        ValueError: the two have different extents.
    """
    if not same_extents(before, after):
        raise ValueError("an update is of a grid of the same extents")
    differ = before.data != after.data
    rows = np.flatnonzero(differ.any(axis=1))
    if rows.size == 0:
        return None
    south, north = int(rows[0]), int(rows[-1]) + 1
    columns = np.flatnonzero(differ[south:north].any(axis=0))
    west, east = int(columns[0]), int(columns[-1]) + 1
    return OccupancyGridUpdate(after.stamp, after.frame, west, south, after.data[south:north, west:east])
