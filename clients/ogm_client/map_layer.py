"""Layer over a map: a value of each cell that was computed of the map, and where it lies."""

import math
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from ogm_core.lattice import Lattice


@dataclass(frozen=True, slots=True, eq=False)
class MapLayer:
    """Values of the cells of a rectangle of the map: metres of `distance`, float32, or states of `inflate`.

    `values` is [iy, ix], row 0 is the south edge; the place in it counts from the cell `offset`, as in a
    `MapGrid`. `resolution` is metres per cell; `anchor` the world position of the lower-left corner of cell
    (0, 0), m; `epoch`, `run` and `revision` name the map's state together; `stamp` is its newest scan's, ns
    since the Unix epoch, or None.
    """

    values: NDArray[Any]
    resolution: float
    anchor: tuple[float, float]
    offset: tuple[int, int]
    epoch: str
    revision: int
    stamp: int | None
    run: str = ""

    @property
    def origin(self) -> tuple[float, float]:
        """World position of the lower-left corner of this layer, m."""
        return Lattice(self.resolution, self.anchor).corner_of(*self.offset)

    def at(self, x: float, y: float) -> float:
        """The value of the cell that holds the point (x, y), m; NaN outside this layer.

        Raises:
            BadParameter: the point is not finite, or too far away for cells to be told apart.
        """
        ix, iy = Lattice(self.resolution, self.anchor).cell_of(x, y)
        height, width = self.values.shape
        column, row = ix - self.offset[0], iy - self.offset[1]
        return float(self.values[row, column]) if 0 <= column < width and 0 <= row < height else math.nan
