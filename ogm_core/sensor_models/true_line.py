"""True lines: one cell a column, the one that holds the line where it crosses the column's middle.

A beam runs from one sixteenth of a cell to another; each stands for its middle. Counted in 1/32 cell these
are odd, and the middles of columns, of cells (32 c + 16) and of halves of cells (16 f + 8), are even: no line
begins, ends or turns on an edge. The major axis is the one along which the beam advances more, `columns` are
those of cells along it. All is counted from the lower-left corner of the sensor's cell.

The coordinate along the other axis is kept in fixed point, 42 bits behind the point, as in `bresenham`:
after k columns it is acc + k step, and its whole part is the row. step is rounded up by less than 2^-42, acc
by less than 3 * 2^-42, and no true value lies nearer than 1 / (32 advance) below a whole number without being
one: so it is exact as long as (k + 3) 32 advance < 2^42, which holds for up to MAX_COLUMNS columns.
"""

from typing import NamedTuple

from numba import njit

from ogm_core.sensor_models.bresenham import FRACTION_BITS, slope

SUBCELL_BITS = 4
SUBCELLS = 1 << SUBCELL_BITS
"""End points are told apart by sixteenths of a cell."""
MAX_COLUMNS = 32767
"""Beams that cross more cells are not exact."""
_FAR = 2 * MAX_COLUMNS
"""No row that a beam reaches is so far away."""


class Line(NamedTuple):
    """A beam's line. Lengths count in 1/32 cell from the corner of the sensor's cell, rows in cells."""

    along_i: bool
    """Whether i is the major axis."""
    sign: int
    """Which way it goes along the major axis."""
    start: int
    """The sensor's cell along the major axis, in the map."""
    aside: int
    """The same along the other axis."""
    columns: int
    """How many columns the end's lies beyond the sensor's."""
    advance: int
    """Its length along the major axis."""
    rise: int
    """Its signed length along the other."""
    begin: int
    """Where it begins along the major axis."""
    row: int
    """Where it begins along the other one."""
    end: int
    """Where it ends along the major axis."""
    step: int
    """Rows a column, in fixed point."""


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def line_of(u0: int, v0: int, u1: int, v1: int) -> Line:
    """The line between two points that differ, in sixteenths of a cell of the map."""
    du, dv = 2 * (u1 - u0), 2 * (v1 - v0)
    along_i = abs(du) >= abs(dv)
    along, aside, more, rise = (u0, v0, du, dv) if along_i else (v0, u0, dv, du)
    begin, row = 2 * (along & (SUBCELLS - 1)) + 1, 2 * (aside & (SUBCELLS - 1)) + 1
    end = begin + more
    return Line(
        along_i,
        1 if more > 0 else -1,
        along >> SUBCELL_BITS,
        aside >> SUBCELL_BITS,
        abs(end >> 5),
        abs(more),
        rise,
        begin,
        row,
        end,
        slope(rise, abs(more)),
    )


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def row_at_start(line: Line) -> int:
    """acc: the line's row, in fixed point, at the middle of the sensor's column."""
    ahead = ((16 - line.begin) * line.sign * line.step) >> 5
    return (line.row << (FRACTION_BITS - 5)) + ahead + 2


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def steps_between(first: int, last: int, acc: int, step: int, low: int, high: int) -> tuple[int, int]:
    """Narrow steps `first` ... `last` to those whose row, of acc + k step, lies from `low` to `high`."""
    floor, ceiling = low << FRACTION_BITS, (high + 1) << FRACTION_BITS
    if step > 0:
        return max(first, -((acc - floor) // step)), min(last, (ceiling - 1 - acc) // step)
    if step < 0:
        return max(first, -((ceiling - 1 - acc) // -step)), min(last, (acc - floor) // -step)
    return first, last if floor <= acc < ceiling else first - 1


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def steps_inside(line: Line, last: int, acc: int, width: int, height: int) -> tuple[int, int]:
    """Of the steps 1 ... `last` those whose cells lie in [0, width) x [0, height); first > last if none."""
    long, wide = (width, height) if line.along_i else (height, width)
    start, sign, aside = line.start, line.sign, line.aside
    first = max(1, -start if sign > 0 else start - long + 1)
    last = min(last, long - 1 - start if sign > 0 else start)
    farthest = aside + line.rise // 32
    if min(aside, farthest) >= 2 and max(aside, farthest) < wide - 2:
        return first, last
    if aside < -_FAR or aside >= wide + _FAR:
        return 1, 0
    return steps_between(first, last, acc, line.step, max(-aside, -_FAR), min(wide - 1 - aside, _FAR))


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def half_columns(line: Line) -> tuple[int, int, int]:
    """Columns half as wide before the end's, in the last two columns of cells but not in the sensor's.

    Returns the first one, counted from the corner of the sensor's cell, how many, and acc at the middle of
    the first: the row, counted in halves, in fixed point.
    """
    sign, here, last = line.sign, line.begin >> 4, line.end >> 4
    column = sign if line.columns == 1 else (line.end >> 5) - sign
    first = last if line.columns == 0 else 2 * column + (0 if sign > 0 else 1)
    ahead = ((16 * here + 8 - line.begin) * sign * line.step) >> 4
    acc = (line.row << (FRACTION_BITS - 4)) + ahead + 2 + abs(first - here) * line.step
    return first, abs(last - first), acc


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def entered(line: Line) -> int:
    """How much of its last half column the line has passed, in sixteenths of it."""
    last_half = line.end >> 4
    part = line.end - 16 * last_half if line.sign > 0 else 16 * (last_half + 1) - line.end
    return min(line.advance, part)
