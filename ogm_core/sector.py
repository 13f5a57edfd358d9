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
def box_of(rays: NDArray[np.float64]) -> CellRect:
    """A rectangle around the sensor that holds every span."""
    far = int(np.ceil(rays[3].max())) + 1
    return CellRect(-far, -far, 2 * far + 1, 2 * far + 1)


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
) -> tuple[NDArray[np.float64], NDArray[np.int64], CellRect, NDArray[np.int32]]:
    """A scan's star, the rectangle that was looked at, and the spans in it (see `spans`).

    That is the `window`, or, if it has no width, a rectangle around the star; one of more than `max_cells`
    is not looked at, and there are no spans. For a sensor of this `heading` at (fu, fv) within its cell.
    """
    rays, quadrants = turned(ranges, beam, kinds, fan, heading, resolution)
    if window.width == 0:
        window = box_of(rays)
        if window.width * window.height > max_cells:
            return rays, quadrants, window, np.empty((4, 0), np.int32)
    return rays, quadrants, window, spans(rays, quadrants, fu, fv, window)


@njit(cache=True, nogil=True, error_model="numpy")
def _edges(rows: NDArray[np.float64], quadrants: NDArray[np.int64]) -> NDArray[np.int64]:
    """The star's edges that some row meets, in the order in which the rows meet them; `rows` of `_ends_of`.

    At every ray both outlines step to the radii from there on, then they follow their arcs to the next one.
    An edge is 4 r + 2 outline + (1 if it is such a step, along the ray). It is written in any case and kept
    if it begins and ends in different rows: what a branch would decide is hard to foresee.
    """
    edges = np.empty(4 * rows.shape[1] + 1, np.int64)
    n = 0
    for r in range(rows.shape[1]):
        if r > 0:
            edges[n] = 4 * r + 1
            n += int(rows[2, r - 1] != rows[0, r])
            edges[n] = 4 * r + 3
            n += int(rows[3, r - 1] != rows[1, r])
        # In the first and third quadrant a row comes from outside, in the others it goes there.
        first = int(quadrants[r] in (0, 2))
        edges[n] = 4 * r + 2 * first
        n += int(rows[first, r] != rows[2 + first, r])
        edges[n] = 4 * r + 2 * (1 - first)
        n += int(rows[1 - first, r] != rows[3 - first, r])
    return edges[:n]


@njit(cache=True, nogil=True, error_model="numpy")
def spans(
    rays: NDArray[np.float64], quadrants: NDArray[np.int64], fu: float, fv: float, window: CellRect
) -> NDArray[np.int32]:
    """Cells of each class as spans of rows, for a sensor at (fu, fv) within its cell; no cell twice.

    Returns shape (4, n): row, first column, column after the last, class. Only spans that meet `window` are
    kept; what lies outside costs neither memory nor, above and below it, time. A cell whose centre is the
    sensor has no bearing and is left out.
    """
    rows = _ends_of(rays, fv)
    edges = _edges(rows, quadrants)
    lowest = max(int(rows.min()), window.iy)
    highest = min(int(rows.max()), window.iy + window.height)
    upper = int(_row(0.0, fv))  # the lowest row at or above the sensor
    inside = np.zeros(max(highest - lowest, 0), np.int64)
    met = np.empty(inside.size, np.int64)
    for row in range(inside.size):
        met[row] = _FAR if row + lowest >= upper else -_FAR
    found = np.empty((4, 2 * edges.size + 1000), np.int32)
    n = 0
    left, right = window.ix, window.ix + window.width
    pole = fu == 0.5 and fv == 0.5  # the sensor is the centre of its cell
    for edge in edges:
        r, outline, step = edge >> 2, (edge >> 1) & 1, edge & 1
        first, last = rows[outline + 2 * step, r - step], rows[outline + 2 - 2 * step, r]
        begin, end = max(int(min(first, last)), lowest), min(int(max(first, last)), highest)
        c, s, radius = rays[0, r], rays[1, r], rays[2 + outline, r]
        # An edge along a row has no slope that a float can hold; they meet anywhere between its ends.
        slope = c / s if abs(s) > _FLAT else 0.0
        side = math.copysign(1.0, c + rays[0, r + 1])
        a, b = rays[2 + outline, r - step] * c, radius * rays[0, r + 1 - step]
        least, greatest = min(a, b), max(a, b)
        above = begin >= upper
        if n + 2 * (end - begin) > found.shape[1]:
            more = np.empty((4, found.shape[1] + 2 * (end - begin)), np.int32)
            found = np.concatenate((found, more), axis=1)
        for row in range(begin, end):
            v = _height(row, fv)
            arc = side * math.sqrt(max(radius * radius - v * v, 0.0))
            x = slope * v if step else arc
            here = int(np.ceil(min(max(x, least), greatest) - 0.5 + fu))
            at = np.uint64(row - lowest)
            state, before = inside[at], met[at]
            inside[at] = state ^ (outline + 1)
            here = min(here, before) if above else max(here, before)
            met[at] = here
            start, stop = (here, before) if above else (before, here)
            if state == 0 or start >= stop or stop <= left or start >= right:
                continue
            if pole and row == 0 and start <= 0 < stop:
                found[0, n], found[1, n], found[2, n], found[3, n] = row, start, 0, 2 - (state & FREE)
                n += int(start < 0 and left < 0)
                start = 1
            found[0, n], found[1, n], found[2, n], found[3, n] = row, start, stop, 2 - (state & FREE)
            n += int(start < stop and start < right)
    # Copied: numba takes a part for another kind of array than a whole, and would compile for each.
    return found[:, :n].copy()
