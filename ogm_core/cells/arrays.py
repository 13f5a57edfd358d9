"""Dense cells: planes that are arrays already, of a file, of a reply, of a picture that was shrunk."""

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.model import CellModel, CellSource, Planes, StoredCells

_ALL = slice(None)


class CellArrays:
    """Planes in memory, [iy, ix], row 0 south (a `cells.model.CellSource`). Nobody changes them any more."""

    def __init__(
        self, planes: Planes, sides: dict[str, int] | None = None, part: tuple[slice, slice] = (_ALL, _ALL)
    ) -> None:
        """Cells of these planes, `sides` of those that are twice as fine; only rows and columns of `part`."""
        self._planes = planes
        self._sides = dict.fromkeys(planes, 1) | (sides or {})
        name = next(iter(planes))
        height, width = (length // self._sides[name] for length in planes[name].shape)
        self._rows, self._columns = range(height)[part[0]], range(width)[part[1]]
        self.shape = len(self._rows), len(self._columns)
        """Rows and columns of cells."""

    @classmethod
    def of(cls, model: CellModel, cells: StoredCells) -> "CellArrays":
        """Cells of a model that has one plane."""
        (plane,) = model.planes
        return cls({plane.name: cells})

    def planes(self, rows: slice = _ALL, columns: slice = _ALL, margin: int = 0) -> Planes:
        """The planes of some rows and columns, with so many cells more on every side; 0 beyond the arrays."""
        up, along = self._rows[rows], self._columns[columns]
        edges = up.start, up.stop, along.start, along.stop
        return {
            name: _window(cells, edges, margin, self._sides[name]) for name, cells in self._planes.items()
        }

    def part(self, rows: slice, columns: slice) -> CellSource:
        """The rectangle of some rows and columns."""
        up, along = self._rows[rows], self._columns[columns]
        part = slice(up.start, up.stop), slice(along.start, along.stop)
        return CellArrays(self._planes, self._sides, part)

    def any_written(self) -> NDArray[np.bool_]:
        """Cells of which some number, of whatever plane, is not 0, bit for bit: [iy, ix]."""
        height, width = self.shape
        found = np.zeros(self.shape, np.bool_)
        for name, side in self._sides.items():
            numbers = self._bits(name)
            found |= (numbers != 0).reshape(height, side, width, side).any(axis=(1, 3))
        return found

    def written(self, name: str) -> int:
        """How many numbers of a plane are not 0, bit for bit."""
        # As integers: a known zero of float64 cells is stored as -0.0 (see log_odds).
        return int(np.count_nonzero(self._bits(name)))

    def value_counts(self, name: str) -> NDArray[np.int64]:
        """How often each value but 0 occurs in a plane of 16 bits: shape (65536,), by its bits."""
        counts = np.bincount(self._bits(name).view(np.uint16).ravel(), minlength=2**16)
        counts[0] = 0
        return counts

    def _bits(self, name: str) -> NDArray[np.signedinteger]:
        """The numbers of a plane as integers."""
        numbers = np.ascontiguousarray(self.planes()[name])
        return numbers.view(np.dtype(f"i{numbers.itemsize}"))


def _window(cells: StoredCells, edges: tuple[int, int, int, int], margin: int, side: int) -> StoredCells:
    south, north, west, east = (edge * side for edge in edges)
    more = margin * side
    if not more:
        return cells[south:north, west:east]
    bottom, left = max(south - more, 0), max(west - more, 0)
    top, right = min(north + more, cells.shape[0]), min(east + more, cells.shape[1])
    window = np.zeros((north - south + 2 * more, east - west + 2 * more), cells.dtype)
    row, column = bottom - south + more, left - west + more
    window[row : row + top - bottom, column : column + right - left] = cells[bottom:top, left:right]
    return window
