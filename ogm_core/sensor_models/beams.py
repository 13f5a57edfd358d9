"""Beam end points: which of a scan's ranges count, how far they reach, where on the lattice they end.

Readings follow REP-117; the inverse sensor model is Thrun, Burgard & Fox 2005, table 9.2, along a ray.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.lattice import MAX_INDEX

SKIPPED, NO_RETURN, HIT = 0, 1, 2
"""Kinds of beam: no evidence; saw nothing up to its free length; ended on something."""
IX, IY, KIND, IX0, IY0 = range(5)
"""Rows of a scan's `ends`: the end cell, the kind, the start cell (see projection.Beams)."""
_CLOSE = 4
"""Added to the kind of a beam that ends too close to a cell's edge for quick arithmetic."""
_ROUNDING = 1.0 + 1e-6
"""A float32 may be so much more than the `range_max` that it was rounded from."""
_USEFUL = 1e-3
"""Quick arithmetic pays as long as few beams end so close to an edge, cells."""


Plain = tuple[Any, ...]
"""The contents of a named tuple: to hand that itself to a kernel takes 2 us, these a third of one."""


class BeamModel(NamedTuple):
    """What the kernels need to know of a scan and a map to say what its ranges mean; metres, radians.

    `clear_range` and `reach` are infinite where there is no such limit.
    """

    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    alpha: float
    clear_range: float
    reach: float


class LatticeParams(NamedTuple):
    """A lattice as the kernels know it: its anchor and resolution, m."""

    anchor_x: float
    anchor_y: float
    resolution: float


@njit(cache=True, nogil=True, error_model="numpy")
def classify(r: float, beam: BeamModel) -> tuple[int, float]:
    """Kind of a beam that measured `r`, and the distance of its end point from the sensor, m."""
    if math.isnan(r) or r <= 0.0 or r < beam.range_min or beam.range_max * _ROUNDING < r < math.inf:
        return SKIPPED, 0.0
    if r >= beam.range_max:
        return NO_RETURN, min(beam.range_max, beam.clear_range, beam.reach)
    if r >= beam.range_max - beam.alpha / 2:
        return NO_RETURN, min(r, beam.clear_range, beam.reach)
    if r > beam.reach:
        return NO_RETURN, beam.reach
    return HIT, r


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def reading(r: float, beam: BeamModel) -> tuple[bool, bool, float]:
    """`classify` without a branch, for many beams at once: whether it counts, whether it hit, its length."""
    saw_nothing = beam.range_max - beam.alpha / 2
    counts = (r > 0.0) & (r >= beam.range_min) & ((r <= beam.range_max * _ROUNDING) | (r == math.inf))
    hit = counts & (r < saw_nothing) & (r <= beam.reach)
    farthest = min(beam.range_max, beam.clear_range, beam.reach)
    length = min(r, beam.reach if r < saw_nothing else farthest)
    return counts, hit, length if counts else 0.0


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def end_point(
    k: int, length: float, x: float, y: float, theta: float, beam: BeamModel
) -> tuple[float, float]:
    """Where beam `k` ends that is `length` long, m; not finite if its bearing is not."""
    bearing = theta + (beam.angle_min + k * beam.angle_increment)
    return x + length * math.cos(bearing), y + length * math.sin(bearing)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _end_of(
    k: int, length: float, x: float, y: float, theta: float, beam: BeamModel, lattice: LatticeParams
) -> tuple[bool, float, float]:
    """Whether the end point of beam `k` can be addressed, and where it lies, in cells from the anchor.

    The arithmetic is that of `Lattice.cell_of`, in the same order: the floor of this is the end cell.
    """
    end_x, end_y = end_point(k, length, x, y, theta, beam)
    u = (end_x - lattice.anchor_x) / lattice.resolution
    v = (end_y - lattice.anchor_y) / lattice.resolution
    return abs(u) < MAX_INDEX and abs(v) < MAX_INDEX, u, v


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _addressed(x: float, y: float, lattice: LatticeParams) -> bool:
    """Whether a point, m, lies in a cell that can be addressed."""
    u, v = (x - lattice.anchor_x) / lattice.resolution, (y - lattice.anchor_y) / lattice.resolution
    return abs(u) < MAX_INDEX and abs(v) < MAX_INDEX


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _draw(lines: NDArray[np.float64], k: int, u0: float, v0: float, u: float, v: float) -> None:
    """Write the line of beam `k` from (u0, v0) to (u, v), in cells: see projection.Beams."""
    lines[0, k] = math.floor(u0) + 1 - u0 if u > u0 else u0 - math.floor(u0)
    lines[1, k] = math.floor(v0) + 1 - v0 if v > v0 else v0 - math.floor(v0)
    lines[2, k], lines[3, k] = u - u0, v - v0


@njit(cache=True, error_model="numpy")
def project(
    ranges: NDArray[np.float32],
    beam: Plain,
    sensor: NDArray[np.float64],
    lattice: Plain,
    ends: NDArray[np.int64],
    lines: NDArray[np.float64],
) -> bool:
    """Project every beam of a scan onto a lattice: write `ends` and `lines`, see projection.Beams.

    `sensor` holds the sensor's poses in the map frame: shape (1, 3), or (N, 3) with one a beam; `beam` and
    `lattice` are the contents of a BeamModel and of LatticeParams. Lines are written if there is room for
    them. Returns whether the sensor and every end cell can be addressed. A skipped beam's end cell is (0, 0).
    """
    beam, lattice = BeamModel(*beam), LatticeParams(*lattice)
    ends[:] = 0
    lines[:] = 0.0
    if not _addressed(sensor[0, 0], sensor[0, 1], lattice):
        return False
    for k in range(ranges.size):
        kind, length = classify(float(ranges[k]), beam)
        if kind == SKIPPED:
            continue
        p = k if len(sensor) > 1 else 0
        u0 = (sensor[p, 0] - lattice.anchor_x) / lattice.resolution
        v0 = (sensor[p, 1] - lattice.anchor_y) / lattice.resolution
        addressed, u, v = _end_of(k, length, sensor[p, 0], sensor[p, 1], sensor[p, 2], beam, lattice)
        if not (addressed and abs(u0) < MAX_INDEX and abs(v0) < MAX_INDEX):
            return False
        ends[IX, k], ends[IY, k] = math.floor(u), math.floor(v)
        ends[KIND, k] = kind
        ends[IX0, k], ends[IY0, k] = math.floor(u0), math.floor(v0)
        if lines.size:
            _draw(lines, k, u0, v0, u, v)
    return True


@njit(cache=True, error_model="numpy")
def project_turned(
    ranges: NDArray[np.float32],
    beam: Plain,
    sensor: Plain,
    lattice: Plain,
    ends: NDArray[np.int64],
    lines: NDArray[np.float64],
    directions: NDArray[np.float64],
) -> bool:
    """The same as `project`, cell for cell, of a sensor that stood still: many times faster.

    Returns whether it can tell; if not, as far away from the frame's origin, `project` has to.

    `sensor` is its x, y, theta; `directions`, shape (2, N), are cosine and sine of the beams' bearings in the
    sensor's frame. Turned by the heading they give the end points up to rounding, with simple arithmetic on
    many beams at once. How far rounding can move a point is known; where that could reach another cell,
    `_end_of` decides.
    """
    model, onto = BeamModel(*beam), LatticeParams(*lattice)
    n, exact = ranges.size, lines.size > 0
    x, y, theta = sensor
    u0, v0 = (x - onto.anchor_x) / onto.resolution, (y - onto.anchor_y) / onto.resolution
    slack = _rounding(n, abs(x) + abs(y), theta, model, onto)
    if not slack < _USEFUL:
        return False
    i0, j0 = math.floor(u0), math.floor(v0)
    fu, fv = u0 - i0, v0 - j0
    c, s = math.cos(theta) / onto.resolution, math.sin(theta) / onto.resolution
    close_calls = 0
    for k in range(n):
        counts, hit, length = reading(float(ranges[k]), model)
        u = fu + length * (c * directions[0, k] - s * directions[1, k])
        v = fv + length * (s * directions[0, k] + c * directions[1, k])
        iu, iv = np.floor(u), np.floor(v)
        edge = min(min(u - iu, iu + 1.0 - u), min(v - iv, iv + 1.0 - v))
        close = counts & (edge < slack)
        close_calls += int(close)
        ends[IX, k] = i0 + np.int32(iu) if counts else 0
        ends[IY, k] = j0 + np.int32(iv) if counts else 0
        ends[KIND, k] = int(counts) + int(hit) + (_CLOSE if close else 0)
        ends[IX0, k] = i0 if counts else 0
        ends[IY0, k] = j0 if counts else 0
    if exact:
        _draw_turned(lines, ranges, model, directions, fu, fv, c, s)
    if close_calls:
        for k in range(n):
            if ends[KIND, k] & _CLOSE:
                kind, length = classify(float(ranges[k]), model)
                _, u, v = _end_of(k, length, x, y, theta, model, onto)
                ends[IX, k], ends[IY, k], ends[KIND, k] = math.floor(u), math.floor(v), kind
                if exact:  # a line must lead to its beam's end cell, be that beyond an edge by rounding only
                    _draw(lines, k, u0, v0, u, v)
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _draw_turned(
    lines: NDArray[np.float64],
    ranges: NDArray[np.float32],
    beam: BeamModel,
    directions: NDArray[np.float64],
    fu: float,
    fv: float,
    c: float,
    s: float,
) -> None:
    """Write the lines of all beams from (fu, fv) in the sensor's cell, by the arithmetic of `project_turned`.

    In a loop of its own, because few need them: the other one takes half the time without.
    """
    for k in range(ranges.size):
        _, _, length = reading(float(ranges[k]), beam)
        u = fu + length * (c * directions[0, k] - s * directions[1, k])
        v = fv + length * (s * directions[0, k] + c * directions[1, k])
        lines[0, k] = 1.0 - fu if u > fu else fu
        lines[1, k] = 1.0 - fv if v > fv else fv
        lines[2, k], lines[3, k] = u - fu, v - fv


@njit(cache=True, nogil=True, error_model="numpy")
def _rounding(n: int, away: float, theta: float, beam: BeamModel, lattice: LatticeParams) -> float:
    """By how many cells rounding moves an end point at most, in `project` and `project_turned` together.

    A sum of angles or coordinates is off by its largest part times 2^-53; there are fewer than 16 such steps.
    `away` is how far the sensor is from the frame's origin, m.
    """
    longest = min(beam.range_max, beam.reach)
    turned = abs(theta) + abs(beam.angle_min) + n * abs(beam.angle_increment)
    span = away + max(abs(lattice.anchor_x), abs(lattice.anchor_y)) + longest
    return (longest * (turned + 1.0) + span) / lattice.resolution * 2.0**-49


@njit(cache=True, error_model="numpy")
def count_cells(ends: NDArray[np.int64], exact: bool) -> int:
    """How many cells the beams in `ends`, shape (5, N), speak of, as Bresenham's lines or `exact` ones."""
    cells = 0
    for k in range(ends.shape[1]):
        if ends[KIND, k] != SKIPPED:
            di, dj = abs(ends[IX, k] - ends[IX0, k]), abs(ends[IY, k] - ends[IY0, k])
            cells += di + dj if exact else max(di, dj)
    return cells


@njit(cache=True, error_model="numpy")
def drop_outside(ends: NDArray[np.int64], ix: int, iy: int, width: int, height: int) -> tuple[int, int]:
    """Skip the beams whose start or end cell lies outside a rectangle of cells.

    Changes the kinds in `ends`, shape (5, N). Returns how many counted before, and how many were dropped.
    """
    counted = 0
    dropped = 0
    for k in range(ends.shape[1]):
        if ends[KIND, k] == SKIPPED:
            continue
        counted += 1
        starts_inside = ix <= ends[IX0, k] < ix + width and iy <= ends[IY0, k] < iy + height
        if not (starts_inside and ix <= ends[IX, k] < ix + width and iy <= ends[IY, k] < iy + height):
            ends[KIND, k] = SKIPPED
            dropped += 1
    return counted, dropped
