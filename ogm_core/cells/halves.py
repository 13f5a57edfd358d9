"""Halves of counted cells: what is counted in cells and in halves of them, on the lattice of the halves.

What passed through a cell is spread evenly over its four halves: N / 16 sides of a cell are N / 32 sides of a
half, for each of them.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.model import CellSource, Plane, Planes

PASSING, HITS, UNANSWERED = "passing", "hits", "unanswered"
PLANES_OF_HALVES = (
    Plane(PASSING, np.dtype(np.float64)),
    Plane(HITS, np.dtype(np.uint32)),
    Plane(UNANSWERED, np.dtype(np.uint16)),
)
"""Length of passing in 1/32 half, whole numbers; hits in 1/1024; beams that met nothing."""
_ALL = slice(None)
_MARGIN = 2
"""Cells around some of which the halves are laid out; any margin up to twice as many halves is had."""


class Halves:
    """The halves of a rectangle of cells (a `cells.model.CellSource`). Any thread."""

    def __init__(self, source: CellSource, part: tuple[slice, slice] = (_ALL, _ALL)) -> None:
        """Halves of the cells of `source`, planes of `cells.rate`; only the rows and columns of `part`."""
        self.source = source
        height, width = source.shape
        self._rows, self._columns = range(2 * height)[part[0]], range(2 * width)[part[1]]
        self.shape = len(self._rows), len(self._columns)
        """Rows and columns of halves."""

    def planes(self, rows: slice = _ALL, columns: slice = _ALL, margin: int = 0) -> Planes:
        """The planes of some rows and columns, with so many halves more on every side; 0 beyond the map."""
        up, along = self._rows[rows], self._columns[columns]
        inner = slice(up.start // 2, -(-up.stop // 2)), slice(along.start // 2, -(-along.stop // 2))
        return halved(
            self.source.planes(*inner, _MARGIN), *(_cut(wanted, _MARGIN, margin) for wanted in (up, along))
        )

    @property
    def cells(self) -> CellSource:
        """The cells that the halves lie in."""
        up, along = self._rows, self._columns
        return self.source.part(*(slice(part.start // 2, -(-part.stop // 2)) for part in (up, along)))

    def part(self, rows: slice, columns: slice) -> "Halves":
        """The rectangle of some rows and columns."""
        up, along = self._rows[rows], self._columns[columns]
        return Halves(self.source, (slice(up.start, up.stop), slice(along.start, along.stop)))

    def written(self, name: str) -> int:
        """How many numbers of a plane are not 0."""
        return CellArrays(self.planes()).written(name)

    def value_counts(self, name: str) -> NDArray[np.int64]:
        """How often each value but 0 occurs in a plane of 16 bits: shape (65536,)."""
        return CellArrays(self.planes()).value_counts(name)


def _cut(wanted: range, cells: int, margin: int) -> slice:
    """Where the halves `wanted`, and `margin` more at both ends, lie among those of `cells` more at both."""
    first = wanted.start - margin - 2 * (wanted.start // 2 - cells)
    return slice(first, first + len(wanted) + 2 * margin)


def halved(planes: Planes, rows: slice, columns: slice) -> Planes:
    """Some rows and columns of the halves of these cells."""
    passing = _doubled(passing_of(planes))[rows, columns]
    passing += 2.0 * planes["E"][rows, columns]
    return {
        PASSING: passing,
        HITS: planes["H"][rows, columns],
        UNANSWERED: _doubled(planes["F"])[rows, columns],
    }


def passing_of(planes: Planes) -> NDArray[np.float64]:
    """Length of passing of whole cells, N and C together, in 1/16 cell; whole numbers below 2^32."""
    passing: NDArray[np.float64] = planes["N"].astype(np.float64)
    if planes["C"].any():
        passing += 65536.0 * planes["C"]
    return passing


def _doubled(cells: NDArray[Any]) -> NDArray[Any]:
    """Every number in four places: two rows, two columns; twice as fast as np.repeat."""
    found = np.empty((2 * cells.shape[0], 2 * cells.shape[1]), cells.dtype)
    found[::2, ::2] = found[::2, 1::2] = cells
    found[1::2] = found[::2]
    return found
