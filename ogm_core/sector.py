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

Rows and columns count from the sensor's cell.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.beams import BeamModel
from ogm_core.lattice import CellRect
from ogm_core.spans import FREE, OCCUPIED
from ogm_core.star import Fan, turned

# The classes of a span are also the bits of the outlines that a row is inside of: inner and outer.
assert (FREE, OCCUPIED) == (1, 2)
_FAR = 2**30
_FLAT = 1e-300


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _height(row: float, fv: float) -> float:
    """How far the cell centres of a row lie above the sensor, cells."""
    return row + 0.5 - fv


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _row(y: float, fv: float) -> float:
    """The lowest row whose height is y or more; by the very heights that meetings are computed from.

    An edge that is almost parallel to a row is met where rounding says; all edges of a ray must agree on it.
    """
    row: float = np.ceil(y - 0.5 + fv)
    return row + 1.0 - int(_height(row, fv) >= y) - int(_height(row - 1.0, fv) >= y)


@njit(cache=True, nogil=True, error_model="numpy")
def _ends_of(rays: NDArray[np.float64], fv: float) -> NDArray[np.float64]:
    """Rows where inner and outer outline leave ray r, and where they come to ray r + 1; shape (4, n)."""
    n = rays.shape[1] - 1
    rows = np.empty((4, n))
    for r in range(n):
        s, s_next, inner, outer = rays[1, r], rays[1, r + 1], rays[2, r], rays[3, r]
        rows[0, r], rows[1, r] = _row(inner * s, fv), _row(outer * s, fv)
        rows[2, r], rows[3, r] = _row(inner * s_next, fv), _row(outer * s_next, fv)
    return rows


@njit(cache=True, nogil=True, error_model="numpy")
def edges_of(rays: NDArray[np.float64], quadrants: NDArray[np.int64], fv: float) -> NDArray[np.float64]:
    """The star's edges in the order in which the rows meet them, shape (7, n), for a sensor at height fv.

    First row and the row after the last, outline, slope dx/dy of a radial edge (else 0), radius of an arc
    with the sign of x (else 0), least and greatest x. An edge that no row meets is left out.
    """
    rows = _ends_of(rays, fv)
    edges = np.empty((7, 4 * rays.shape[1]))
    n = 0
    for r in range(rays.shape[1] - 1):
        c, s = rays[0, r], rays[1, r]
        for outline in range(2 if r > 0 else 0):  # radial edges
            first, last = rows[2 + outline, r - 1], rows[outline, r]
            if first == last:
                continue
            near, far = rays[2 + outline, r - 1] * c, rays[2 + outline, r] * c
            edges[0, n], edges[1, n], edges[2, n] = min(first, last), max(first, last), outline + 1
            # An edge along a row has no slope that a float can hold; they meet anywhere between its ends.
            edges[3, n], edges[4, n] = c / s if abs(s) > _FLAT else 0.0, 0.0
            edges[5, n], edges[6, n] = min(near, far), max(near, far)
            n += 1
        # In the first and third quadrant a row comes from outside, in the others it goes there.
        inward = quadrants[r] in (0, 2)
        for k in range(2):  # arcs
            outline = 1 - k if inward else k
            first, last = rows[outline, r], rows[2 + outline, r]
            if first == last:
                continue
            radius, c_next = rays[2 + outline, r], rays[0, r + 1]
            edges[0, n], edges[1, n], edges[2, n] = min(first, last), max(first, last), outline + 1
            edges[3, n], edges[4, n] = 0.0, radius if c + c_next >= 0.0 else -radius
            edges[5, n], edges[6, n] = min(radius * c, radius * c_next), max(radius * c, radius * c_next)
            n += 1
    # Copied, for one kind of array: see ogm_core.star.turned.
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
def see(
    ranges: NDArray[np.float32],
    beam: BeamModel,
    kinds: NDArray[np.int64],
    fan: Fan,
    heading: float,
    resolution: float,
    fu: float,
    fv: float,
    window: CellRect,
    max_cells: int,
) -> tuple[NDArray[np.float64], CellRect, NDArray[np.int32]]:
    """Edges of a scan's star, the rectangle that was looked at, and the spans in it (see `spans`).

    That is the `window`, or, if it has no width, a rectangle around the star; one of more than `max_cells`
    is not looked at, and there are no spans. For a sensor of this `heading` at (fu, fv) within its cell.
    """
    rays, quadrants = turned(ranges, beam, kinds, fan, heading, resolution)
    edges = edges_of(rays, quadrants, fv)
    if window.width == 0:
        window = CellRect(*box_of(edges))
        if window.width * window.height > max_cells:
            return edges, window, np.empty((4, 0), np.int32)
    return edges, window, spans(edges, fu, fv, window)


@njit(cache=True, nogil=True, error_model="numpy")
def spans(edges: NDArray[np.float64], fu: float, fv: float, window: CellRect) -> NDArray[np.int32]:
    """Cells of each class as spans of rows, for a sensor at (fu, fv) within its cell; no cell twice.

    Returns shape (4, n): row, first column, column after the last, class. Only spans that meet `window` are
    kept; what lies outside costs neither memory nor, above and below it, time. A cell whose centre is the
    sensor has no bearing and is left out.
    """
    bottom, top = (int(edges[0].min()), int(edges[1].max())) if edges.size else (0, 0)
    lowest, highest = max(bottom, window.iy), min(top, window.iy + window.height)
    rows = max(highest - lowest, 0)
    inside = np.zeros(rows, np.int64)
    met = np.empty(rows, np.int64)
    upper = int(_row(0.0, fv))  # the lowest row at or above the sensor
    for row in range(rows):
        met[row] = _FAR if row + lowest >= upper else -_FAR
    found = np.empty((4, 2 * edges.shape[1] + 1000), np.int32)
    n = 0
    left, right = window.ix, window.ix + window.width
    pole = fu == 0.5 and fv == 0.5  # the sensor is the centre of its cell
    for e in range(edges.shape[1]):
        bit, slope, radius = int(edges[2, e]), edges[3, e], edges[4, e]
        least, greatest, square = edges[5, e], edges[6, e], edges[4, e] ** 2
        begin, end = max(int(edges[0, e]), lowest), min(int(edges[1, e]), highest)
        above = begin >= upper
        if n + 2 * (end - begin) > found.shape[1]:
            found = np.concatenate(
                (found, np.empty((4, found.shape[1] + 2 * (end - begin)), np.int32)), axis=1
            )
        for row in range(begin, end):
            v = _height(row, fv)
            x = slope * v if radius == 0.0 else math.copysign(math.sqrt(max(square - v * v, 0.0)), radius)
            here = int(np.ceil(min(max(x, least), greatest) - 0.5 + fu))
            r = np.uint64(row - lowest)
            state, before = inside[r], met[r]
            inside[r] = state ^ bit
            here = min(here, before) if above else max(here, before)
            met[r] = here
            first, last = (here, before) if above else (before, here)
            if pole and state != 0 and row == 0 and first <= 0 < last:
                found[0, n], found[1, n], found[2, n], found[3, n] = row, first, 0, 2 - (state & FREE)
                n += int(first < 0 and left < 0)
                first = 1
            found[0, n], found[1, n], found[2, n], found[3, n] = row, first, last, 2 - (state & FREE)
            # Written in any case, kept if it is one: what a branch would decide is hard to foresee.
            n += int((state != 0) & (first < last) & (last > left) & (first < right))
    return found[:, :n].copy()
