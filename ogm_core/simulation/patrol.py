"""Coverage tour of a map's free space for one robot: closed, and the same for the same map.

The free cells that keep clear of all others are thinned out to a graph with one node for a block of cells.
Viewpoints are spread over it, each the node farthest from those before (Gonzalez 1985). The tour goes from
each to the nearest one not yet visited, along shortest paths (Dijkstra 1959), straightened where the straight
line keeps clear, too.
"""

from collections.abc import Iterator
from itertools import pairwise
from math import dist, hypot
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from ogm_core.errors import BadWorld
from ogm_core.lattice import Lattice
from ogm_core.simulation.trajectories import Point, WaypointPath

CLEARANCES = (0.3, 0.2, 0.1, 0.0)
"""From the way to the cells that are not free, m; the first that leaves room to drive is kept."""
BLOCK = 0.25
"""Side of the blocks of cells in which the way is planned, m."""
VIEW_EVERY = 4.0
"""Viewpoints are added until every node is this close to one, along the way, m."""
MAX_VIEWPOINTS = 48
BESIDE_START = 0.75
"""A tour from a start begins at most this far from it, m, or one cell."""
SPACING = 0.1
"""Between two poses, m; more on a tour of more than `_MAX_STEPS` of them."""
NICHE = 0.005
"""A free region of less than this share of the largest is a niche; a race track is more."""
_MAX_STEPS = 20_000
_MAX_VISITS = 4_000_000
"""Nodes that shortest paths may visit, all in all; bounds the time."""
_CROSSINGS = 2**20
"""Crossings of lines and cells' borders that are looked at in one go, at most; bounds the memory."""
_BESIDE = 1e-6
_TOO_SMALL = f"is too small to drive in: {BLOCK:g} m to and fro are needed"

Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Cell = tuple[int, int]


def patrol(free: Mask, lattice: Lattice, start: Cell | None = None, home: Cell | None = None) -> WaypointPath:
    """A closed tour of one connected region of `free`, shape (h, w), [iy, ix].

    The region is the one that holds the free cell `start`, [iy, ix], beside which the tour then begins.
    Without one it is that of the cell `home`, if it is free; else the largest that does not touch the map's
    border, so that what lies around a building is not taken for its inside; else the largest. One that is too
    small to drive in is passed over, and so is one inside that is a niche beside the largest.

    It keeps 0.3 m clear of all other cells, less if that leaves no room to drive, and never leaves the
    region. Parts of the region behind passages that are too narrow are not visited.

    Raises:
        BadWorld: there is no free space, or too little to drive in.
    """
    parts, count = ndimage.label(free)  # joined by their sides
    if not count:
        raise BadWorld("there is no free space to drive in: the map has no free cell")
    if start is not None:
        path = _tour(parts == parts[start], lattice, start)
        if path is None:
            raise BadWorld(f"start: the free space there {_TOO_SMALL}")
        return path
    for number in _parts_in_turn(parts, home):
        path = _tour(parts == number, lattice, None)
        if path is not None:
            return path
    raise BadWorld(f"the free space {_TOO_SMALL}")


def _tour(region: Mask, lattice: Lattice, start: Cell | None) -> WaypointPath | None:
    """A tour of a region, from beside a cell of it if one is given; None if there is too little room."""
    # In cells, from a cell's centre to that of the nearest one outside; what surrounds the map is outside.
    gaps = ndimage.distance_transform_edt(np.pad(region, 1))[1:-1, 1:-1]
    for clearance in CLEARANCES:
        safe = region & ((gaps - 0.5) * lattice.resolution >= clearance)
        nodes, graph, first = _graph(safe, gaps, cells_of_block(lattice.resolution), start)
        away = 0.0 if start is None or not len(nodes) else hypot(*(nodes[first] - start)) * lattice.resolution
        if len(nodes) > 1 and away <= max(BESIDE_START, lattice.resolution):
            break
    else:
        return None
    legs = _legs(graph, lattice.resolution, first)
    points = [_centre(lattice, cell) for leg in legs for cell in _straightened(safe, nodes[leg])[:-1]]
    length = sum(dist(start, end) for start, end in pairwise([*points, points[0]]))
    return WaypointPath(tuple(points), max(SPACING, length / _MAX_STEPS))


def cells_of_block(resolution: float) -> int:
    """Side of a block in cells of `resolution` m."""
    return max(1, round(BLOCK / resolution))


def _parts_in_turn(parts: Indices, home: Cell | None) -> Iterator[int]:
    """The numbers of the parts, from 1, that are tried one after the other where no start is given."""
    if home is not None and parts[home]:
        yield int(parts[home])
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    inside = sizes.copy()
    inside[np.concatenate((parts[[0, -1]].ravel(), parts[:, [0, -1]].ravel()))] = 0
    inside[inside < NICHE * sizes.max()] = 0
    for kept in (inside, sizes):
        if kept.any():
            yield int(kept.argmax())


def _graph(safe: Mask, gaps: Floats, side: int, start: Cell | None) -> tuple[Indices, Any, int]:
    """The largest connected graph of blocks of `side` x `side` cells, or the one nearest to a start.

    Nodes are cells [iy, ix], shape (n, 2); a sparse symmetric matrix says how far joined ones are apart, in
    cells. Neighbours are joined if the straight line between them meets safe cells only. Last comes the node
    nearest to the start, 0 without one.
    """
    nodes, number = _nodes(safe, gaps, side)
    neighbours = (
        (number[:, :-1], number[:, 1:]),
        (number[:-1], number[1:]),
        (number[:-1, :-1], number[1:, 1:]),
        (number[:-1, 1:], number[1:, :-1]),
    )
    pairs = np.concatenate([np.stack((a.ravel(), b.ravel())) for a, b in neighbours], axis=1)
    pairs = pairs[:, (pairs >= 0).all(axis=0)]
    a, b = pairs[:, _clear(safe, *nodes[pairs])]
    lengths = np.hypot(*(nodes[b] - nodes[a]).T)
    graph = sparse.coo_array((lengths, (a, b)), shape=(len(nodes), len(nodes))).tocsr()
    first = 0
    if len(nodes):
        _, part = csgraph.connected_components(graph, directed=False)
        chosen = np.bincount(part).argmax() if start is None else part[_nearest(nodes, start)]
        kept = np.flatnonzero(part == chosen)
        nodes, graph = nodes[kept], graph[kept][:, kept]
        first = 0 if start is None else _nearest(nodes, start)
    return nodes, graph + graph.T, first


def _nearest(nodes: Indices, cell: Cell) -> int:
    return int(np.hypot(*(nodes - cell).T).argmin())


def _nodes(safe: Mask, gaps: Floats, side: int) -> tuple[Indices, Indices]:
    """Each block's safe cell with the widest gap, shape (n, 2); every block's number, -1 if it has none."""
    height, width = (-(-size // side) for size in safe.shape)
    cells = np.zeros((height * side, width * side))
    cells[: safe.shape[0], : safe.shape[1]] = np.where(safe, gaps, 0.0)
    blocks = cells.reshape(height, side, width, side).swapaxes(1, 2).reshape(height, width, side * side)
    there = blocks.any(axis=2)
    number = np.where(there, np.cumsum(there).reshape(there.shape) - 1, -1)
    row, column = np.divmod(blocks[there].argmax(axis=1), side)
    return np.argwhere(there) * side + np.stack((row, column), axis=1), number


def _legs(graph: Any, resolution: float, first: int) -> list[list[int]]:  # noqa: ANN401 (a sparse matrix)
    """A closed tour of viewpoints, from node `first`: the nodes on the way from each to the next."""
    limit = min(MAX_VIEWPOINTS, max(8, _MAX_VISITS // graph.shape[0]))
    views, lengths, before = [first], [], []
    nearest = np.full(graph.shape[0], np.inf)
    while True:
        away, previous = csgraph.dijkstra(graph, indices=views[-1], return_predecessors=True)
        lengths.append(away)
        before.append(previous)
        np.minimum(nearest, away, out=nearest)
        # A small room has a few viewpoints, too.
        near_enough = min(VIEW_EVERY / resolution, lengths[0].max() / 3.0)
        if len(views) == limit or nearest.max() <= near_enough:
            break
        views.append(int(nearest.argmax()))
    order = _nearest_first(np.array(lengths)[:, views])
    return [_way(before[a], views[b]) for a, b in pairwise([*order, order[0]])]


def _nearest_first(lengths: Floats) -> list[int]:
    """An order of all viewpoints from 0 on: the next is the nearest of those left."""
    order, left = [0], set(range(1, len(lengths)))
    while left:
        order.append(min(left, key=lambda k: (lengths[order[-1], k], k)))
        left.remove(order[-1])
    return order


def _way(before: Indices, node: int) -> list[int]:
    """The nodes on the way to `node`; `before` leads back along it, and is negative at its start."""
    way = [node]
    while before[way[-1]] >= 0:
        way.append(int(before[way[-1]]))
    return way[::-1]


def _straightened(safe: Mask, cells: Indices) -> list[Indices]:
    """The cells of a way, shape (n, 2), without those that straight lines over safe cells make needless."""
    kept = [cells[0]]
    for last_seen, cell in pairwise(cells[1:]):
        if not _clear(safe, kept[-1:], [cell])[0]:
            kept.append(last_seen)
    return [*kept, cells[-1]]


def _clear(safe: Mask, start: Any, end: Any) -> Mask:  # noqa: ANN401 (whatever makes an array)
    """Whether straight lines between centres of cells, both shape (n, 2), meet safe cells only.

    A line through a corner meets the four cells around it.
    """
    start, along = np.asarray(start), np.subtract(end, start)
    crossings = int(np.abs(along).sum(axis=1).max(initial=0))
    size = max(1, _CROSSINGS // max(1, crossings))
    parts = [slice(first, first + size) for first in range(0, len(start), size)]
    return np.concatenate([np.empty(0, np.bool_), *(_part_clear(safe, start[k], along[k]) for k in parts)])


def _part_clear(safe: Mask, start: Indices, along: Indices) -> Mask:
    # How far along, 0 to 1, each line crosses the borders of rows and of columns.
    crossed = [
        np.minimum((np.arange(steps.max()) + 0.5) / np.maximum(steps, 1)[:, None], 1.0)
        for steps in np.abs(along).T
    ]
    t = np.concatenate(crossed, axis=1)
    y, x = (start[:, k, None] + 0.5 + t * along[:, k, None] for k in (0, 1))
    clear = np.ones(t.shape, np.bool_)
    for up in (-_BESIDE, _BESIDE):
        for right in (-_BESIDE, _BESIDE):
            clear &= safe[np.floor(y + up).astype(np.intp), np.floor(x + right).astype(np.intp)]
    return np.asarray(clear.all(axis=1))


def _centre(lattice: Lattice, cell: Indices) -> Point:
    x, y = lattice.corner_of(int(cell[1]), int(cell[0]))
    return x + lattice.resolution / 2.0, y + lattice.resolution / 2.0
