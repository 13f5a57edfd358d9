"""Footprints on the map: whether a point, or what a robot stands on, is free, in NumPy.

A footprint is closed, its edges belong to it, and grown by a margin: it is all that lies no farther from it.
It meets a cell if it has a point in common with the cell's closed square. Along each row of cells the part of
an edge that is grown, a strip with round ends, is one interval; so is what lies between two edges.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.classes import FREE, OCCUPIED, UNKNOWN
from ogm_core.errors import BadParameter
from ogm_core.lattice import MAX_INDEX, CellRect, Lattice
from ogm_core.queries.cell_runs import Ints, counted
from ogm_core.queries.replies import FootprintState

MAX_FOOTPRINTS = 4096
"""So many points or footprints may be asked about at once."""
MAX_CORNERS = 64
"""Corners of a footprint."""
MAX_MARGIN = 100.0
"""The largest margin, m."""
MAX_MET = 10_000_000
"""So many cells they may meet together at most, those that several edges meet counted for each."""
MAX_ROWS = 100_000
"""So many rows of cells their edges may reach over together: what a question holds grows with them."""
_PIECE = 2**15
SLACK = 1e-6
"""So many cells more count as within the margin: sums of decimals seldom meet an edge exactly."""
WORDS: dict[int, FootprintState] = {OCCUPIED: "occupied", UNKNOWN: "unknown", FREE: "free"}
"""What is told of a footprint."""
_ROUNDED = 1e-8

Floats = NDArray[np.float64]


class _Runs(NamedTuple):
    """Cells side by side: of which footprint, their row, first column and last column."""

    footprint: Ints
    row: Ints
    first: Ints
    last: Ints


class Footprints:
    """Points and polygons on a lattice, grown by a margin. Nobody changes them."""

    def __init__(
        self, footprints: Sequence[Sequence[tuple[float, float]]], margin: float, lattice: Lattice
    ) -> None:
        """Each has one corner, a point, or 3 and more in order, m, the last of them joined to the first.

        Where a polygon crosses itself it is read even-odd. `margin` in m.

        Raises:
            BadParameter: there are none or too many, one has 2 or too many corners, a corner is not finite or
                has no cell, the margin is out of its range, or they meet too many cells.
        """
        _check(footprints, margin)
        self._number = len(footprints)
        with np.errstate(over="ignore"):  # what is infinite in cells is refused below
            corners = [lattice.in_cells(np.array(footprint, np.float64)) for footprint in footprints]
        every = np.concatenate(corners)
        if not np.all(np.abs(every) < MAX_INDEX):
            raise BadParameter("footprints: finite numbers are needed, of places that have cells")
        reach = margin / lattice.resolution + SLACK
        west, south = np.floor(every.min(axis=0) - reach - 1.0).astype(np.int64).tolist()
        east, north = np.floor(every.max(axis=0) + reach + 1.0).astype(np.int64).tolist()
        self.rect = CellRect(west, south, east - west + 1, north - south + 1)
        """A rectangle that holds all cells that they meet."""
        # Counted from a cell near each, they keep their decimals wherever it is.
        self._near: Ints = np.array([np.floor(each.min(axis=0)) for each in corners]).astype(np.int64)
        of = np.repeat(np.arange(self._number), [len(each) for each in corners])
        begins = every - self._near[of]
        ends: Floats = np.concatenate([np.roll(each, -1, axis=0) for each in corners]) - self._near[of]
        self._runs = [_along_edges(begins, ends, of, reach), _between_edges(begins, ends, of)]
        met = sum(float(np.sum(runs.last - runs.first + 1.0)) for runs in self._runs)
        if met > MAX_MET:
            raise BadParameter(
                f"points, footprints: with their margin they meet {met:.0f} cells or more, at most {MAX_MET} "
                "are looked at: ask about fewer, or smaller ones"
            )

    def states(self, cells: NDArray[np.int8], rect: CellRect) -> NDArray[np.int8]:
        """The state of each: OCCUPIED if it meets an occupied cell, else UNKNOWN if one that is not free.

        `cells` are the trinary ones of `rect`; all others are unknown.
        """
        occupied, unknown = np.zeros((2, self._number), np.bool_)
        for runs in self._runs:
            for k, column in counted(runs.first, runs.last, _PIECE):
                met = self._met(runs.footprint[k], runs.row[k], column, cells, rect)
                occupied[runs.footprint[k[met == OCCUPIED]]] = True
                unknown[runs.footprint[k[met == UNKNOWN]]] = True
        return np.where(occupied, OCCUPIED, np.where(unknown, UNKNOWN, FREE)).astype(np.int8)

    def _met(
        self, footprint: Ints, row: Ints, column: Ints, cells: NDArray[np.int8], rect: CellRect
    ) -> NDArray[np.int8]:
        """The states of cells that are counted from the one near their footprint."""
        east, north = (self._near[footprint] - (rect.ix, rect.iy)).T
        columns, rows = column + east, row + north
        inside = (rows >= 0) & (rows < rect.height) & (columns >= 0) & (columns < rect.width)
        met = np.full(len(row), UNKNOWN, np.int8)
        met[inside] = cells[rows[inside], columns[inside]]
        return met


def _check(footprints: Sequence[Sequence[tuple[float, float]]], margin: float) -> None:
    if not 0.0 <= margin <= MAX_MARGIN:
        raise BadParameter(f"margin: 0 to {MAX_MARGIN:g} m is needed, got {margin:g}")
    if not 1 <= len(footprints) <= MAX_FOOTPRINTS:
        raise BadParameter(f"points, footprints: 1 to {MAX_FOOTPRINTS} are needed, got {len(footprints)}")
    for number, footprint in enumerate(footprints):
        if len(footprint) == 2 or not 1 <= len(footprint) <= MAX_CORNERS:
            raise BadParameter(
                f"footprints: number {number}: 3 to {MAX_CORNERS} corners are needed, got {len(footprint)}"
            )


def _along_edges(begins: Floats, ends: Floats, of: Ints, reach: float) -> _Runs:
    """The cells that are no farther than `reach` from an edge; all in cells."""
    low, high = np.minimum(begins[:, 1], ends[:, 1]) - reach, np.maximum(begins[:, 1], ends[:, 1]) + reach
    mirrored, parts = np.array([-1.0, 1.0]), []
    for edge, row in _rows(np.ceil(low - 1.0).astype(np.int64), np.floor(high).astype(np.int64)):
        # The part of each row that the grown edge is in.
        bottom, top = np.maximum(row, low[edge]), np.minimum(row + 1.0, high[edge])
        a, b = begins[edge], ends[edge]
        right = _farthest_right(a, b, bottom, top, reach)
        left = -_farthest_right(a * mirrored, b * mirrored, bottom, top, reach)
        first, last = np.ceil(left - 1.0).astype(np.int64), np.floor(right).astype(np.int64)
        parts.append((of[edge], row, first, last))
    return _Runs(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _farthest_right(a: Floats, b: Floats, bottom: Floats, top: Floats, reach: float) -> Floats:
    """The greatest u of what lies no farther than `reach` from the edges a to b, and has v in bottom to top.

    The right boundary of a grown edge is concave: the best v is the one nearest to that of its right end, or,
    of a vertical edge, to any of its own.
    """
    a_first = (a[:, 0] > b[:, 0]) | ((a[:, 0] == b[:, 0]) & (a[:, 1] < b[:, 1]))
    right, other = np.where(a_first[:, None], a, b), np.where(a_first[:, None], b, a)
    highest = np.where(right[:, 0] == other[:, 0], other[:, 1], right[:, 1])
    v = np.clip(np.clip(bottom, right[:, 1], highest), bottom, top)
    best = np.full(len(v), -np.inf)
    for end in (a, b):
        away = np.abs(v - end[:, 1])
        bow = end[:, 0] + np.sqrt(np.maximum(0.0, (reach - away) * (reach + away)))
        best = np.where(away <= reach + _ROUNDED, np.maximum(best, bow), best)
    # The side, between the round ends: the edge moved by `reach` along its normal to the right.
    along = b - a
    length = np.hypot(along[:, 0], along[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        turned = np.sign(along[:, 1])[:, None] * np.stack((along[:, 1], -along[:, 0]), axis=1)
        moved = a + reach * turned / length[:, None]
        share = (v - moved[:, 1]) / along[:, 1]
        side = moved[:, 0] + share * along[:, 0]
    beside = (along[:, 1] != 0.0) & (share >= 0.0) & (share <= 1.0)
    return np.where(beside, np.maximum(best, side), best)


def _between_edges(begins: Floats, ends: Floats, of: Ints) -> _Runs:
    """The cells whose centre lies inside, by the even-odd rule, whichever side one on an edge is on."""
    up = begins[:, 1] <= ends[:, 1]
    (u0, v0), (u1, v1) = np.where(up[:, None], begins, ends).T, np.where(up[:, None], ends, begins).T
    parts = [(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))]
    for edge, row in _rows(np.ceil(v0 - 0.5).astype(np.int64), np.ceil(v1 - 0.5).astype(np.int64) - 1):
        share = (row + 0.5 - v0[edge]) / (v1 - v0)[edge]
        parts.append((of[edge], row, u0[edge] + share * (u1 - u0)[edge]))
    footprint, row, crossed = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.lexsort((crossed, row, footprint))
    footprint, row = footprint[order], row[order]
    column = np.ceil(crossed[order] - 0.5).astype(np.int64)
    # A closed outline crosses the line of centres an even number of times.
    return _Runs(footprint[::2], row[::2], column[::2], column[1::2] - 1)


def _rows(first: Ints, last: Ints) -> Iterator[tuple[Ints, Ints]]:
    """Every edge with every row that it is in, in pieces."""
    rows = float(np.sum(np.maximum(last - first + 1.0, 0.0)))
    if rows > MAX_ROWS:
        raise BadParameter(
            f"points, footprints: with their margin their edges reach over {rows:.0f} rows of cells, at most "
            f"{MAX_ROWS} are looked at: ask about fewer, or smaller ones"
        )
    return counted(first, last, _PIECE)
