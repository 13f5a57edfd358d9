"""Coverage tour of a map's free space for one robot: closed, and the same for the same map.

The free cells that keep clear of all others are thinned out to a graph with one node for a block of cells.
Viewpoints are spread over it, each the node farthest from those before (Gonzalez 1985). The tour goes from
each to the nearest one not yet visited, along shortest paths (Dijkstra 1959), straightened where the straight
line keeps clear, too.
"""

from itertools import pairwise
from math import dist
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
SPACING = 0.1
"""Between two poses, m; more on a tour of more than `_MAX_STEPS` of them."""
_MAX_STEPS = 20_000
_MAX_VISITS = 4_000_000
"""Nodes that shortest paths may visit, all in all; bounds the time."""
_CROSSINGS = 2**20
"""Crossings of lines and cells' borders that are looked at in one go, at most; bounds the memory."""
_BESIDE = 1e-6

Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]
Indices = NDArray[np.intp]


def patrol(free: Mask, lattice: Lattice) -> WaypointPath:
    """A closed tour of the largest connected region of `free`, shape (h, w), [iy, ix].

    It keeps 0.3 m clear of all other cells, less if that leaves no room to drive, and never leaves the
    region. Parts of the region behind passages that are too narrow are not visited.

    Raises:
        BadWorld: there is no free space, or too little to drive in.
    """
    region = _largest_part(free)
    # In cells, from a cell's centre to that of the nearest one outside; what surrounds the map is outside.
    gaps = ndimage.distance_transform_edt(np.pad(region, 1))[1:-1, 1:-1]
    for clearance in CLEARANCES:
        safe = region & ((gaps - 0.5) * lattice.resolution >= clearance)
        nodes, graph = _graph(safe, gaps, cells_of_block(lattice.resolution))
        if len(nodes) > 1:
            break
    else:
        raise BadWorld(f"the free space is too small to drive in: {BLOCK:g} m to and fro are needed")
    legs = _legs(graph, lattice.resolution)
    points = [_centre(lattice, cell) for leg in legs for cell in _straightened(safe, nodes[leg])[:-1]]
    length = sum(dist(start, end) for start, end in pairwise([*points, points[0]]))
    return WaypointPath(tuple(points), max(SPACING, length / _MAX_STEPS))


def cells_of_block(resolution: float) -> int:
    """Side of a block in cells of `resolution` m."""
    return max(1, round(BLOCK / resolution))


def _largest_part(free: Mask) -> Mask:
    """The largest part whose cells are joined by their sides."""
    parts, count = ndimage.label(free)
    if not count:
        raise BadWorld("there is no free space to drive in: the map has no free cell")
    largest: Mask = parts == 1 + np.bincount(parts.ravel())[1:].argmax()
    return largest


def _graph(safe: Mask, gaps: Floats, side: int) -> tuple[Indices, Any]:
    """The largest connected graph of blocks of `side` x `side` cells.

    Nodes are cells [iy, ix], shape (n, 2); a sparse symmetric matrix says how far joined ones are apart, in
    cells. Neighbours are joined if the straight line between them meets safe cells only.
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
    start, end = pairs[:, _clear(safe, *nodes[pairs])]
    lengths = np.hypot(*(nodes[end] - nodes[start]).T)
    graph = sparse.coo_array((lengths, (start, end)), shape=(len(nodes), len(nodes))).tocsr()
    if len(nodes):
        _, part = csgraph.connected_components(graph, directed=False)
        kept = np.flatnonzero(part == np.bincount(part).argmax())
        nodes, graph = nodes[kept], graph[kept][:, kept]
    return nodes, graph + graph.T


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


def _legs(graph: Any, resolution: float) -> list[list[int]]:  # noqa: ANN401 (a sparse matrix)
    """A closed tour of viewpoints: the nodes on the way from each to the next, both included."""
    limit = min(MAX_VIEWPOINTS, max(8, _MAX_VISITS // graph.shape[0]))
    views, lengths, before = [0], [], []
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
