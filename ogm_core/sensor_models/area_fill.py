"""Scanline fill of the visible area: every cell whose centre a scan sees, once (sensor model `sector`).

The scan has two outlines (area_outline): an inner one, up to which it saw free space, and an outer one, up to
which it saw an obstacle. Both are closed curves of radial edges and arcs. Going round the sensor by angle,
every row of cell centres above the sensor meets the outlines from right to left, and every row below it from
left to right, so nothing need be sorted: a row remembers where it met an outline last and which outlines it
is inside of, and each new meeting closes a span of cells of one class. It never goes back, though rays may
be in disorder where bearings are so large that rounding disturbs their order.

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

from ogm_core.lattice import CellRect
from ogm_core.sensor_models.area_outline import Fan, Rays, turned
from ogm_core.sensor_models.beams import BeamModel, Plain
from ogm_core.sensor_models.spans import SPAN_FREE, SPAN_OCCUPIED

# The classes of a span are also the bits of the outlines that a row is inside of: inner and outer.
assert (SPAN_FREE, SPAN_OCCUPIED) == (1, 2)
_FLAT = 1e-300
_FAR = 2**30
_ROOM = 4096
"""Spans for which there is room at first."""


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
def box_of(rays: Rays) -> CellRect:
    """A rectangle around the sensor that holds every span."""
    far = int(np.ceil(rays[3].max())) + 1
    return CellRect(-far, -far, 2 * far + 1, 2 * far + 1)


@njit(cache=True, nogil=True, error_model="numpy")
def see(
    ranges: NDArray[np.float32],
    beam: Plain,
    kinds: NDArray[np.int64],
    fan: Plain,
    place: Plain,
    resolution: float,
    window: Plain,
    max_cells: int,
) -> tuple[bool, NDArray[np.int32]]:
    """The spans of a scan's outlines in the `window`, or, if that has no width, in a rectangle around them.

    The latter is not looked at if it has more than `max_cells`; returns whether it was, too. `beam`, `fan`
    and `window` are the contents of a BeamModel, a Fan and a CellRect; `place` is the sensor's heading and
    where it is within its cell.
    """
    heading, fu, fv = place
    rays, quarters = turned(ranges, BeamModel(*beam), kinds, Fan(*fan), heading, resolution)
    box, kept = box_of(rays), CellRect(*window)
    if kept.width == 0:
        if box.width * box.height > max_cells:
            return False, np.empty((0, 4), np.int32)
        kept = box
    lowest, end = max(kept.iy, box.iy), min(kept.iy + kept.height, box.iy + box.height)
    return True, spans(rays, quarters, fu, fv, CellRect(kept.ix, lowest, kept.width, max(end - lowest, 0)))


@njit(cache=True, nogil=True, error_model="numpy")
def _ends_of(rays: Rays, fv: float) -> NDArray[np.float64]:
    """Rows where inner and outer outline leave ray r, and where they come to ray r + 1; shape (4, n)."""
    n = rays.shape[1] - 1
    rows = np.empty((4, n))
    for r in range(n):
        s, s_next, inner, outer = rays[1, r], rays[1, r + 1], rays[2, r], rays[3, r]
        rows[0, r], rows[1, r] = _row(inner * s, fv), _row(outer * s, fv)
        rows[2, r], rows[3, r] = _row(inner * s_next, fv), _row(outer * s_next, fv)
    return rows


@njit(cache=True, nogil=True, error_model="numpy")
def _edges(rows: NDArray[np.float64], quarters: NDArray[np.int64]) -> NDArray[np.int64]:
    """Edges of the outlines that some row meets, in the order in which rows meet them; `rows` of `_ends_of`.

    At every ray both outlines step to the radii from there on, then they follow their arcs to the next one.
    An edge is 4 r + 2 outline + (1 if it is such a step, along the ray). It is written in any case and kept
    if it begins and ends in different rows: what a branch would decide is hard to foresee.
    """
    edges = np.empty(4 * rows.shape[1] + 1, np.int64)
    n = 0
    for quadrant in range(4):
        # In the first and third quadrant a row comes from outside, in the others it goes there.
        first = 1 - quadrant % 2
        for r in range(quarters[quadrant], quarters[quadrant + 1]):
            if r > 0:
                edges[n] = 4 * r + 1
                n += int(rows[2, r - 1] != rows[0, r])
                edges[n] = 4 * r + 3
                n += int(rows[3, r - 1] != rows[1, r])
            edges[n] = 4 * r + 2 * first
            n += int(rows[first, r] != rows[2 + first, r])
            edges[n] = 4 * r + 2 * (1 - first)
            n += int(rows[1 - first, r] != rows[3 - first, r])
    return edges[:n]


@njit(cache=True, nogil=True, error_model="numpy")
def spans(
    rays: Rays, quarters: NDArray[np.int64], fu: float, fv: float, window: CellRect
) -> NDArray[np.int32]:
    """Cells of each class as spans of rows, for a sensor at (fu, fv) within its cell; no cell twice.

    Returns the rows of spans, cut off at the `window`: what lies outside costs no memory and, above
    and below it, no time. A row of the window costs some memory, be it seen or not. A cell whose centre is
    the sensor has no bearing and is left out.
    """
    rows = _ends_of(rays, fv)
    edges = _edges(rows, quarters)
    inside = np.zeros(window.height, np.int32)
    met = np.full(window.height, _FAR, np.int32)
    met[: min(max(int(_row(0.0, fv)) - window.iy, 0), window.height)] = -_FAR
    found = np.empty((_ROOM, 4), np.int32)
    k = n = 0
    while True:
        k, n = _sweep(rays, rows, edges, k, fu, fv, window, inside, met, found, n)
        if k == edges.size:
            break
        found = np.concatenate((found, np.empty_like(found)))
    return _without_origin(found[:n]) if fu == 0.5 and fv == 0.5 else found[:n]


@njit(cache=True, nogil=True, error_model="numpy")
def _sweep(
    rays: Rays,
    rows: NDArray[np.float64],
    edges: NDArray[np.int64],
    k: int,
    fu: float,
    fv: float,
    window: CellRect,
    inside: NDArray[np.int32],
    met: NDArray[np.int32],
    found: NDArray[np.int32],
    n: int,
) -> tuple[int, int]:
    """Let rows meet edges from edge `k` on, and write spans from found[n] on, while there is room for them.

    A row's entries in `inside` and `met` say which outlines it is inside of, and where it met one last; at
    first it has met them farther out than any column.
    Returns the next edge and the next span.
    """
    upper = int(_row(0.0, fv))  # the lowest row at or above the sensor
    # Meetings outside the window are moved to its edges, a quarter of a cell beyond which rounding up leads.
    left, right = window.ix + 0.25 - fu, window.ix + window.width + 0.25 - fu
    for edge in edges[k:]:
        r, outline, step = np.uint64(edge >> 2), np.uint64((edge >> 1) & 1), np.uint64(edge & 1)
        first, last = rows[outline + 2 * step, r - step], rows[outline + 2 - 2 * step, r]
        begin = max(int(min(first, last)), window.iy)
        end = min(int(max(first, last)), window.iy + window.height)
        if n + end - begin > found.shape[0]:
            break
        c, s, radius = rays[0, r], rays[1, r], rays[2 + outline, r]
        c_end = rays[0, r + 1 - step]
        # An edge along a row has no slope that a float can hold; they meet anywhere between its ends.
        slope = c / s if abs(s) > _FLAT else 0.0
        side = math.copysign(1.0, c + c_end)
        a, b = rays[2 + outline, r - step] * c, radius * c_end
        least, greatest = min(max(min(a, b), left), right), min(max(max(a, b), left), right)
        above = begin >= upper
        toggled = np.int32(outline + 1)
        for row in range(begin, end):
            v = _height(row, fv)
            x = slope * v if step else side * math.sqrt(max(radius * radius - v * v, 0.0))
            here = np.int32(np.ceil(min(max(x, least), greatest) - 0.5 + fu))
            at = np.uint64(row - window.iy)
            state, before = inside[at], met[at]
            here = min(here, before) if above else max(here, before)
            inside[at] = state ^ toggled
            met[at] = here
            if state:  # not whether the span has any cells: to foresee that, x would have to be there
                found[n, 0], found[n, 3] = row, 2 - (state & SPAN_FREE)
                found[n, 1], found[n, 2] = min(here, before), max(here, before)
                n += int(here != before)
        k += 1
    return k, n


@njit(cache=True, nogil=True, error_model="numpy")
def _without_origin(found: NDArray[np.int32]) -> NDArray[np.int32]:
    """The same spans without column 0 of row 0."""
    parts = np.empty((found.shape[0] + 1, 4), np.int32)
    n = 0
    for span in found:
        parts[n] = span
        if span[0] == 0 and span[1] <= 0 < span[2]:
            parts[n, 2] = 0
            n += int(span[1] < 0)
            parts[n] = span
            parts[n, 1] = 1
            n += int(span[2] > 1)
        else:
            n += 1
    return parts[:n]
