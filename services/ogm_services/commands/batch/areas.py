"""Areas of a map, one for each worker: rectangles of tiles with about as much work in each."""

import numpy as np
from numpy.typing import NDArray

from ogm_core.lattice import TILE, Clip

Numbers = NDArray[np.int64]
Costs = NDArray[np.float64]


def areas_of(extents: Numbers, costs: Costs, count: int, within: Clip | None = None) -> list[Clip]:
    """At most `count` rectangles that meet edge to edge and fill the plane, or `within`.

    `extents` are rectangles of cells, rows of ix, iy, width, height, in which scans that cost so much write;
    what a scan costs is taken to lie evenly in its rectangle.
    """
    within = within or Clip()
    if count < 2 or not len(extents):
        return [within]
    # Cut across the longer side of what there is to do.
    low = extents[:, :2] // TILE
    high = (extents[:, :2] + extents[:, 2:] - 1) // TILE
    sides = high.max(axis=0) - low.min(axis=0)
    axis = int(sides[1] > sides[0])
    first = count // 2
    cut = _cut(low[:, axis], high[:, axis], costs, first / count)
    if cut is None:
        return [within]
    lower, upper = _halves(within, axis, cut * TILE)
    parts = (_part_of(extents, costs, half, axis) for half in (lower, upper))
    return [
        area
        for half, part, number in zip((lower, upper), parts, (first, count - first), strict=True)
        for area in areas_of(*part, number, half)
    ]


def _cut(low: Numbers, high: Numbers, costs: Costs, share: float) -> int | None:
    """The edge of tiles below which nearest to that share of the costs lies; None if no edge divides them."""
    first, tiles = int(low.min()), int(high.max() - low.min()) + 1
    if tiles < 2:
        return None
    density = costs / (high - low + 1)
    steps = np.zeros(tiles + 1)
    np.add.at(steps, low - first, density)
    np.add.at(steps, high - first + 1, -density)
    below = np.cumsum(np.cumsum(steps[:-1]))
    return first + 1 + int(np.abs(below[:-1] - share * below[-1]).argmin())


def _halves(clip: Clip, axis: int, edge: int) -> tuple[Clip, Clip]:
    """The parts of a rectangle below and from an edge on."""
    xmin, ymin, xmax, ymax = clip.xmin, clip.ymin, clip.xmax, clip.ymax
    if axis == 0:
        return Clip(xmin, ymin, edge, ymax), Clip(edge, ymin, xmax, ymax)
    return Clip(xmin, ymin, xmax, edge), Clip(xmin, edge, xmax, ymax)


def _part_of(extents: Numbers, costs: Costs, half: Clip, axis: int) -> tuple[Numbers, Costs]:
    """The rectangles cut off at a half, without those outside, and what of their costs lies inside."""
    rect = half.rect
    begin, size = rect[axis], rect[2 + axis]
    low = np.maximum(extents[:, axis], begin)
    high = np.minimum(extents[:, axis] + extents[:, 2 + axis], begin + size)
    inside = high > low
    part = extents[inside].copy()
    part[:, axis], part[:, 2 + axis] = low[inside], (high - low)[inside]
    return part, costs[inside] * part[:, 2 + axis] / extents[inside, 2 + axis]
