"""A ROS map as a simulated world: its occupied cells stand in it, its free cells are driven through."""

import math

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import BadWorld
from ogm_core.files.ros_map_reader import RosMap
from ogm_core.lattice import Lattice
from ogm_core.simulation.patrol import Cell, cells_of_block, patrol
from ogm_core.simulation.trajectories import Point, WaypointPath
from ogm_core.simulation.worlds import MAX_COORDINATE, World

MAX_CELLS = 25_000_000
MAX_BLOCKS = 1_000_000
"""In a map of more cells, or more of the blocks that a way is planned in, planning takes too long."""


def world_of_map(ros_map: RosMap, name: str, start: Point | None = None) -> World:
    """The world whose obstacles are the outlines of the map's occupied cells, with a tour of its free space.

    The tour is that of `patrol`: it begins beside `start`, m, or else in the part that holds (0, 0), where
    most robots begin their maps. All of it is turned as the map is.

    Raises:
        BadWorld: there is nothing to see, no room to drive, or none at the start; or the map is too large.
    """
    height, width = ros_map.occupancy.shape
    limit = min(MAX_CELLS, MAX_BLOCKS * cells_of_block(ros_map.resolution) ** 2)
    if width * height > limit:
        raise BadWorld(
            f"{width} x {height} cells are more than the {limit} that can be simulated: cut the map"
        )
    # A turned map is drawn up from (0, 0), and then turned about that corner and moved to its place.
    lattice = Lattice(ros_map.resolution) if ros_map.yaw else ros_map.lattice
    corners = [lattice.corner_of(ix, iy) for ix in (0, width) for iy in (0, height)]
    if np.abs(_placed(np.array(corners), ros_map)).max() > MAX_COORDINATE:
        raise BadWorld(f"the map reaches farther than {MAX_COORDINATE:g} m from (0, 0): move its origin")
    segments = outlines(ros_map.occupied, lattice)
    if not len(segments):
        raise BadWorld("the map has no occupied cell: there is nothing for a LiDAR to see")
    begin = None if start is None else _free_cell(ros_map, lattice, start)
    path = patrol(ros_map.free, lattice, begin, _cell(ros_map, lattice, (0.0, 0.0)))
    if ros_map.yaw:
        segments = _placed(segments.reshape(-1, 2), ros_map).reshape(-1, 4)
        segments.setflags(write=False)
        points = _placed(np.array(path.points), ros_map).tolist()
        path = WaypointPath(tuple((x, y) for x, y in points), path.spacing)
    return World(name, np.empty((0, 3)), segments, path)


def _placed(points: NDArray[np.float64], ros_map: RosMap) -> NDArray[np.float64]:
    """Points, m, shape (n, 2), on a map's lattice, in the world; on that of a turned map from its corner."""
    if not ros_map.yaw:
        return points
    c, s = math.cos(ros_map.yaw), math.sin(ros_map.yaw)
    turned: NDArray[np.float64] = points @ np.array([[c, s], [-s, c]]) + ros_map.origin
    return turned


def _free_cell(ros_map: RosMap, lattice: Lattice, start: Point) -> Cell:
    """The cell of a start, which must be free."""
    cell, where = _cell(ros_map, lattice, start), "start: ({:g}, {:g}) m".format(*start)
    if cell is None:
        height, width = ros_map.occupancy.shape
        corners = np.array([lattice.corner_of(ix, iy) for ix in (0, width) for iy in (0, height)])
        (x0, y0), (x1, y1) = (end(_placed(corners, ros_map), axis=0) for end in (np.min, np.max))
        raise BadWorld(f"{where} is not on the map, which is x {x0:g} to {x1:g}, y {y0:g} to {y1:g}")
    if not ros_map.free[cell]:
        raise BadWorld(f"{where} is not free in the map: give a place that is white in its picture")
    return cell


def _cell(ros_map: RosMap, lattice: Lattice, point: Point) -> Cell | None:
    """The map's cell [iy, ix] that holds a point of the world, m; None if none does."""
    height, width = ros_map.occupancy.shape
    if max(map(abs, point)) > MAX_COORDINATE:
        return None
    if ros_map.yaw:  # the inverse of _placed
        c, s = math.cos(ros_map.yaw), math.sin(ros_map.yaw)
        dx, dy = point[0] - ros_map.origin[0], point[1] - ros_map.origin[1]
        point = c * dx + s * dy, c * dy - s * dx
    ix, iy = lattice.cell_of(*point)
    return (iy, ix) if 0 <= ix < width and 0 <= iy < height else None


def outlines(occupied: NDArray[np.bool_], lattice: Lattice) -> NDArray[np.float64]:
    """Segments [x1, y1, x2, y2], shape (n, 4), m: every border of an occupied cell with one that is not.

    Borders in a row are one segment; those that meet at a corner share it bit for bit. What surrounds the
    map is not occupied. Read-only.
    """
    height, width = occupied.shape
    padded = np.pad(occupied, 1)
    x = np.array([lattice.corner_of(ix, 0)[0] for ix in range(width + 1)])
    y = np.array([lattice.corner_of(0, iy)[1] for iy in range(height + 1)])
    rows, left, right = _runs(padded[1:, 1:-1] != padded[:-1, 1:-1])
    columns, bottom, top = _runs((padded[1:-1, 1:] != padded[1:-1, :-1]).T)
    horizontal = np.stack((x[left], y[rows], x[right], y[rows]), axis=1)
    vertical = np.stack((x[columns], y[bottom], x[columns], y[top]), axis=1)
    segments = np.concatenate((horizontal, vertical))
    segments.setflags(write=False)
    return segments


def _runs(marked: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Runs of marked items along the rows: each one's row, first column, and the column after its last."""
    padded = np.pad(marked, ((0, 0), (1, 1)))
    rows, first = np.nonzero(padded[:, 1:] & ~padded[:, :-1])
    _, after = np.nonzero(padded[:, :-1] & ~padded[:, 1:])
    return rows, first, after
