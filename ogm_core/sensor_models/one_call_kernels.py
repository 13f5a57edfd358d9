"""Kernels of common scans: projection, a look at the limits, and the update of cells, in one compiled call.

They do what `evidence` does in several calls, by the same kernels. `beam` are the numbers of a BeamModel and
of LatticeParams, `turned` the `directions` of `beams.project_turned`; x, y and theta the sensor's pose, or
`poses` those at every beam, None if it stood still. Beams that leave the bounds count for nothing if a map
`drops` them. `rects` are those of one_call, which may grow until `max_cells` are known; there is `room` for
so many more tiles. Each returns the number of updates, and of tiles that held 0 before, and whether it has
widened what is known, in `rects`. -1, 0 and no if the scan is no common one: nothing is written then.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.sensor_models import (
    area_fill,
    beams,
    bresenham,
    counted_beams,
    dda,
    passing,
    shared_lines,
    spans,
)
from ogm_core.sensor_models.beams import Plain
from ogm_core.sensor_models.true_line import SUBCELLS
from ogm_core.tiles.store import TILE_BITS

_Rect = tuple[int, int, int, int]
NO_BOUNDS = 2**61
"""Width and height of a rectangle that is everywhere."""


@njit(cache=True, nogil=True, error_model="numpy")
def add_lines(
    ranges: NDArray[np.float32],
    beam: NDArray[np.float64],
    turned: NDArray[np.float64],
    x: float,
    y: float,
    theta: float,
    poses: NDArray[np.float64] | None,
    drops: bool,
    rects: NDArray[np.int64],
    max_cells: int,
    room: int,
    touched: NDArray[np.int64],
    revision: int,
    lines: NDArray[np.float64] | None,
    cells: NDArray[Any],
    column: NDArray[np.int64],
    constants: Plain,
    team: Plain | None,
) -> tuple[int, int, bool]:
    """Update the cells along the beams.

    `lines` is room for those of projection.Beams, None along Bresenham's. `team` is that of
    `shared_lines.update_cells`, or None. The rest is that of `bresenham.update_cells`.
    """
    ends = np.empty((5, ranges.size), np.int64)
    drawn = np.empty((4, 0)) if lines is None else lines
    if not _project(ranges, beam, turned, x, y, theta, poses, ends, drawn):
        return -1, 0, False
    if drops and _all_dropped(ends, rects[0], 1):
        return -1, 0, False
    box = bresenham.extent(ends) if lines is None else dda.extent(ends, drawn)
    fits, kept, wider, grown = _fitted(box, rects, max_cells, room)
    if not fits:
        return -1, 0, False
    updates = fresh = 0
    if kept:
        inside = rects[4, 0], rects[4, 1], rects[4, 2], rects[4, 3]
        if team is not None:
            updates, fresh = shared_lines.update_cells(
                ends, lines, inside, touched, revision, cells, column, constants, team
            )
        elif lines is None:
            updates, fresh = bresenham.update_cells(ends, inside, touched, revision, cells, column, constants)
        else:
            updates, fresh = dda.update_cells(
                ends, drawn, inside, touched, revision, cells, column, constants
            )
    return updates, fresh, _set(rects[1], wider) | _set(rects[3], grown)


@njit(cache=True, nogil=True, error_model="numpy")
def count_beams(
    ranges: NDArray[np.float32],
    beam: NDArray[np.float64],
    turned: NDArray[np.float64],
    x: float,
    y: float,
    theta: float,
    poses: NDArray[np.float64] | None,
    drops: bool,
    rects: NDArray[np.int64],
    max_cells: int,
    room: int,
    touched: NDArray[np.int64],
    revision: int,
    columns: tuple[NDArray[np.int64], NDArray[np.int64]],
    planes: Plain,
) -> tuple[int, int, bool]:
    """Count the beams. The lattice of `beam` is that of SUBCELLS; the rest is `passing.update_planes`'s."""
    ends = np.empty((5, ranges.size), np.int64)
    if not _project(ranges, beam, turned, x, y, theta, poses, ends, np.empty((4, 0))):
        return -1, 0, False
    if drops and _all_dropped(ends, rects[0], SUBCELLS):
        return -1, 0, False
    weights = counted_beams.weigh(ranges, _model(beam), ends)
    fits, kept, wider, grown = _fitted(passing.extent(ends, weights), rects, max_cells, room)
    if not fits:
        return -1, 0, False
    updates = fresh = 0
    if kept:
        inside = rects[4, 0], rects[4, 1], rects[4, 2], rects[4, 3]
        updates, fresh = passing.update_planes(ends, weights, inside, touched, revision, columns, planes)
    return updates, fresh, _set(rects[1], wider) | _set(rects[3], grown)


@njit(cache=True, nogil=True, error_model="numpy")
def fill_area(
    ranges: NDArray[np.float32],
    beam: NDArray[np.float64],
    fan: Plain,
    fu: float,
    fv: float,
    heading: float,
    cell: tuple[int, int],
    drops: bool,
    rects: NDArray[np.int64],
    max_cells: int,
    room: int,
    touched: NDArray[np.int64],
    revision: int,
    lines: None,
    cells: NDArray[np.int16],
    column: NDArray[np.int64],
    constants: Plain,
    team: None,
) -> tuple[int, int, bool]:
    """Update the cells of the area that a scan sees, of a sensor at (fu, fv) in its `cell`.

    `fan` are the contents of area_outline.Fan; the map drops no beams, there are no lines and no team. The
    rest is that of `spans.update_blocks`.
    """
    ix, iy = cell
    window = 0, 0, 0, 0
    if rects[0, 2] < NO_BOUNDS:
        window = rects[0, 0] - ix, rects[0, 1] - iy, rects[0, 2], rects[0, 3]
    kinds, place = np.empty(0, np.int64), (heading, fu, fv)
    looked, seen = area_fill.see(ranges, _model(beam), kinds, fan, place, beam[9], window, max_cells)
    if not looked:
        return -1, 0, False
    west, south, width, height = spans.extent(seen)
    fits, kept, wider, grown = _fitted((west + ix, south + iy, width, height), rects, max_cells, room)
    if not fits:
        return -1, 0, False
    updates = fresh = 0
    if kept:
        inside = rects[4, 0] - ix, rects[4, 1] - iy, rects[4, 2], rects[4, 3]
        updates, fresh = spans.update_blocks(seen, inside, touched, revision, cells, column, constants)
    return updates, fresh, _set(rects[1], wider) | _set(rects[3], grown)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _model(beam: NDArray[np.float64]) -> tuple[float, float, float, float, float, float, float]:
    """The contents of a BeamModel."""
    return beam[0], beam[1], beam[2], beam[3], beam[4], beam[5], beam[6]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _project(
    ranges: NDArray[np.float32],
    beam: NDArray[np.float64],
    turned: NDArray[np.float64],
    x: float,
    y: float,
    theta: float,
    poses: NDArray[np.float64] | None,
    ends: NDArray[np.int64],
    drawn: NDArray[np.float64],
) -> bool:
    """Write the beams' ends, and their lines; whether that was possible."""
    lattice = beam[7], beam[8], beam[9]
    if poses is None:
        return beams.project_turned(ranges, _model(beam), (x, y, theta), lattice, ends, drawn, turned)
    return beams.project(ranges, _model(beam), poses, lattice, ends, drawn)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _all_dropped(ends: NDArray[np.int64], bounds: NDArray[np.int64], parts: int) -> bool:
    """Skip the beams that leave the bounds, in so many parts of a cell; whether these were all that count."""
    counted, dropped = beams.drop_outside(
        ends, parts * bounds[0], parts * bounds[1], parts * bounds[2], parts * bounds[3]
    )
    return counted > 0 and dropped == counted


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _fitted(
    box: _Rect, rects: NDArray[np.int64], max_cells: int, room: int
) -> tuple[bool, bool, _Rect, _Rect]:
    """Whether a scan that speaks of the cells of `box` may be added, and whether any of them are kept.

    Also what limits count then, and what is known.
    """
    bounds, stretched, clip, known, window = rects[0], rects[1], rects[2], rects[3], rects[4]
    updated = _shared(box, bounds)
    kept = _shared(updated, clip)
    wider, grown = _union(stretched, updated), _union(known, kept)
    # In float64: of a pose far away, which a clip leaves alone, the product of integers would overflow.
    allowed = float(wider[2]) * float(wider[3]) <= max_cells
    fits = allowed and _within(kept, window) and _tiles(kept) <= room
    return fits, kept[2] > 0 and kept[3] > 0, wider, grown


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _shared(rect: _Rect, other: NDArray[np.int64]) -> _Rect:
    """The cells that two rectangles (ix, iy, width, height) share; none if width or height is below 1."""
    ix, iy = max(rect[0], other[0]), max(rect[1], other[1])
    right, top = min(rect[0] + rect[2], other[0] + other[2]), min(rect[1] + rect[3], other[1] + other[3])
    return ix, iy, right - ix, top - iy


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _union(rect: NDArray[np.int64], other: _Rect) -> _Rect:
    """The smallest rectangle that holds all cells of both, if they have any."""
    if other[2] < 1 or other[3] < 1:
        return rect[0], rect[1], rect[2], rect[3]
    if rect[2] < 1 or rect[3] < 1:
        return other
    ix, iy = min(rect[0], other[0]), min(rect[1], other[1])
    right, top = max(rect[0] + rect[2], other[0] + other[2]), max(rect[1] + rect[3], other[1] + other[3])
    return ix, iy, right - ix, top - iy


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _set(rect: NDArray[np.int64], other: _Rect) -> bool:
    """Make a rectangle the other one, and return whether it was not before."""
    changed = False
    for n in range(4):
        changed |= rect[n] != other[n]
        rect[n] = other[n]
    return changed


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _within(rect: _Rect, other: NDArray[np.int64]) -> bool:
    """Whether all cells of a rectangle, if there are any, lie in another."""
    shared = _shared(rect, other)
    return rect[2] < 1 or rect[3] < 1 or shared == rect


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _tiles(rect: _Rect) -> int:
    """How many tiles a rectangle meets."""
    if rect[2] < 1 or rect[3] < 1:
        return 0
    wide = ((rect[0] + rect[2] - 1) >> TILE_BITS) - (rect[0] >> TILE_BITS) + 1
    high = ((rect[1] + rect[3] - 1) >> TILE_BITS) - (rect[1] >> TILE_BITS) + 1
    return wide * high
