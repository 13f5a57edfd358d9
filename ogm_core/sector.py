"""Sensor model `sector`: every cell whose centre a scan sees, once, row by row.

The scan is a star (ogm_core.star): an inner outline, up to which it saw free space, and an outer one, up to
which it saw an obstacle. Both are closed curves of radial edges and arcs. Going round the sensor by angle,
every row of cell centres above the sensor meets the outlines from right to left, and every row below it from
left to right, so nothing need be sorted: a row remembers where it met an outline last and which outlines it
is inside of, and each new meeting closes a span of cells of one class.

         ___ outer                a row, right to left:
       /#####                        meets the outer outline    inside outer only: occupied
      /## ___ inner                  meets the inner one        inside both: free
     |## /  . . . . . <-- row        ...

An edge goes from the row of its one end to that of its other, and edges that meet share that row: every row
enters and leaves each outline equally often, whatever is rounded. Where a row meets an edge is computed in
closed form and kept between the edge's ends, so that a class can only be wrong for cell centres that lie on
an edge to within rounding.

Rows and columns count from the sensor's cell; cells are addressed as in ogm_core.strips.
"""

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.cell_updates import add_free, add_occupied
from ogm_core.lattice import CellRect
from ogm_core.logodds import Update
from ogm_core.strips import TILE_BITS

FREE, OCCUPIED = 1, 2
"""Classes of a span; also the bits of the outlines that a row is inside of: inner, outer."""
_FAR = 2**30
_FLAT = 1e-300


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _height(row: int, fv: float) -> float:
    """How far the cell centres of a row lie above the sensor, cells."""
    return row + 0.5 - fv


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _row(y: float, fv: float) -> int:
    """The lowest row whose height is y or more; by the very heights that meetings are computed from.

    An edge that is almost parallel to a row is met where rounding says; all edges of a ray must agree on it.
    """
    row = math.ceil(y - 0.5 + fv)
    if _height(row - 1, fv) >= y:
        return row - 1
    return row if _height(row, fv) >= y else row + 1


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _radial(
    edges: NDArray[np.float64], n: int, bit: int, c: float, s: float, near: float, far: float, fv: float
) -> int:
    """Add the edge from radius `near` to `far` in direction (c, s); return the new number of edges."""
    first, last = _row(near * s, fv), _row(far * s, fv)
    if first == last:
        return n
    edges[0, n], edges[1, n], edges[2, n] = min(first, last), max(first, last), bit
    # An edge along a row has no slope that a float can hold; where they meet is anywhere between its ends.
    edges[3, n], edges[4, n] = c / s if abs(s) > _FLAT else 0.0, 0.0
    edges[5, n], edges[6, n] = min(near * c, far * c), max(near * c, far * c)
    return n + 1


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _arc(
    edges: NDArray[np.float64],
    n: int,
    bit: int,
    radius: float,
    c: float,
    s: float,
    c_next: float,
    s_next: float,
    fv: float,
) -> int:
    """Add the arc from direction (c, s) to the next one, within a quadrant; return the number of edges."""
    first, last = _row(radius * s, fv), _row(radius * s_next, fv)
    if first == last:
        return n
    edges[0, n], edges[1, n], edges[2, n] = min(first, last), max(first, last), bit
    edges[3, n], edges[4, n] = 0.0, radius if c + c_next >= 0.0 else -radius
    edges[5, n], edges[6, n] = min(radius * c, radius * c_next), max(radius * c, radius * c_next)
    return n + 1


@njit(cache=True, nogil=True, error_model="numpy")
def edges_of(rays: NDArray[np.float64], quadrants: NDArray[np.int64], fv: float) -> NDArray[np.float64]:
    """The star's edges in the order in which the rows meet them, shape (7, n), for a sensor at height fv.

    First row and the row after the last, outline, slope dx/dy of a radial edge (else 0), radius of an arc
    with the sign of x (else 0), least and greatest x.
    """
    edges = np.empty((7, 4 * rays.shape[1]))
    n = 0
    for r in range(rays.shape[1] - 1):
        c, s, inner, outer = rays[0, r], rays[1, r], rays[2, r], rays[3, r]
        if r > 0:
            n = _radial(edges, n, FREE, c, s, rays[2, r - 1], inner, fv)
            n = _radial(edges, n, OCCUPIED, c, s, rays[3, r - 1], outer, fv)
        c_next, s_next = rays[0, r + 1], rays[1, r + 1]
        # In the first and third quadrant a row comes from outside, in the others it goes there.
        inward = quadrants[r] in (0, 2)
        if inward:
            n = _arc(edges, n, OCCUPIED, outer, c, s, c_next, s_next, fv)
        n = _arc(edges, n, FREE, inner, c, s, c_next, s_next, fv)
        if not inward:
            n = _arc(edges, n, OCCUPIED, outer, c, s, c_next, s_next, fv)
    # Copied, for one kind of array: see ogm_core.star.wedges.
    return edges[:, :n].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def box_of(edges: NDArray[np.float64]) -> tuple[int, int, int, int]:
    """A rectangle (ix, iy, width, height) that holds every span: the edges' rows, and columns enough."""
    if edges.shape[1] == 0:
        return 0, 0, 0, 0
    left, right = math.floor(edges[5].min()) - 1, math.ceil(edges[6].max()) + 1
    bottom, top = int(edges[0].min()), int(edges[1].max())
    return left, bottom, right - left, top - bottom


@njit(cache=True, nogil=True, error_model="numpy")
def spans(edges: NDArray[np.float64], fu: float, fv: float, window: CellRect) -> NDArray[np.int32]:
    """Cells of each class as spans of rows, for a sensor at (fu, fv) within its cell; no cell twice.

    Returns shape (4, n): row, first column, column after the last, class. Only spans that meet `window` are
    kept; what lies outside costs neither memory nor, above and below it, time. A cell whose centre is the
    sensor has no bearing and is left out.
    """
    _, bottom, _, height = box_of(edges)
    lowest, highest = max(bottom, window.iy), min(bottom + height, window.iy + window.height)
    rows = max(highest - lowest, 0)
    inside = np.zeros(rows, np.int8)
    met = np.empty(rows, np.int32)
    upper = _row(0.0, fv)  # the lowest row at or above the sensor
    for row in range(rows):
        met[row] = _FAR if row + lowest >= upper else -_FAR
    found = np.empty((4, 1024), np.int32)
    n = 0
    for e in range(edges.shape[1]):
        bit, slope, radius = int(edges[2, e]), edges[3, e], edges[4, e]
        for row in range(max(int(edges[0, e]), lowest), min(int(edges[1, e]), highest)):
            v = _height(row, fv)
            x = slope * v
            if radius != 0.0:
                x = math.copysign(math.sqrt(max(radius * radius - v * v, 0.0)), radius)
            x = min(max(x, edges[5, e]), edges[6, e])
            here = math.ceil(x - 0.5 + fu)
            before = met[row - lowest]
            here = min(here, before) if row >= upper else max(here, before)
            state = inside[row - lowest]
            first, end = min(here, before), max(here, before)
            inside[row - lowest] = state ^ bit
            met[row - lowest] = here
            if not state or first >= end or end <= window.ix or first >= window.ix + window.width:
                continue
            if n + 2 > found.shape[1]:
                found = np.concatenate((found, np.empty_like(found)), axis=1)
            kind = FREE if state & FREE else OCCUPIED
            if row == 0 and first <= 0 < end and fu == 0.5 and fv == 0.5:
                if first < 0:
                    found[0, n], found[1, n], found[2, n], found[3, n] = row, first, 0, kind
                    n += 1
                first = 1
            if first < end:
                found[0, n], found[1, n], found[2, n], found[3, n] = row, first, end, kind
                n += 1
    return found[:, :n].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def extent(spans: NDArray[np.int32]) -> tuple[int, int, int, int]:
    """Smallest rectangle (ix, iy, width, height) that holds every span; width is 0 if there is none."""
    if spans.shape[1] == 0:
        return 0, 0, 0, 0
    left, right = spans[1].min(), spans[2].max()
    bottom, top = spans[0].min(), spans[0].max()
    return left, bottom, right - left, top - bottom + 1


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _clipped(spans: NDArray[np.int32], n: int, window: CellRect) -> tuple[int, int, int]:
    """Row, first column and the one after the last of a span inside the window, counted from its corner.

    A span with nothing inside ends where it begins, at a tile's edge.
    """
    j = spans[0, n] - window.iy
    first, end = max(spans[1, n] - window.ix, 0), min(spans[2, n] - window.ix, window.width)
    return (j, first, end) if first < end and 0 <= j < window.height else (0, 0, 0)


@njit(cache=True, nogil=True, error_model="numpy")
def touch_tiles(spans: NDArray[np.int32], window: CellRect, touched: NDArray[np.int64], revision: int) -> int:
    """Write `revision` into every tile with a cell of a span, and return how many held 0 before.

    Only cells in `window` count; `touched`, shape (tiles in x, tiles in y), begins in its corner.
    """
    fresh = 0
    for n in range(spans.shape[1]):
        j, first, end = _clipped(spans, n, window)
        for tx in range(first >> TILE_BITS, ((end - 1) >> TILE_BITS) + 1):
            if touched[tx, j >> TILE_BITS] == 0:
                fresh += 1
            touched[tx, j >> TILE_BITS] = revision
    return fresh


@njit(cache=True, nogil=True, error_model="numpy")
def update_cells(
    spans: NDArray[np.int32],
    window: CellRect,
    cells: NDArray[Any],
    column: NDArray[np.int64],
    update: Update,
) -> int:
    """Add the evidence of the spans to their cells; return the number of cell updates.

    Only cells in `window` are touched; the store of `cells` begins in its corner. Within a strip the cells
    of a row lie side by side.
    """
    updates = 0
    for n in range(spans.shape[1]):
        j, first, end = _clipped(spans, n, window)
        updates += end - first
        while first < end:
            next_strip = min(end, ((first >> TILE_BITS) + 1) << TILE_BITS)
            address = np.uint64(column[first] + (j << TILE_BITS))
            after = address + np.uint64(next_strip - first)
            if spans[3, n] == FREE:
                for a in range(address, after):
                    cells[a] = add_free(cells[a], update)
            else:
                for a in range(address, after):
                    cells[a] = add_occupied(cells[a], update)
            first = next_strip
    return updates
