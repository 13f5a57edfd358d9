"""Layout of shares: which of them owns a tile of a map that is cut."""

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ogm_core.lattice import CellRect, Lattice
from ogm_core.shares import Cuts, Share
from ogm_core.tiles.store import TILE


@dataclass(frozen=True, slots=True)
class ShareLayout:
    """The shares of a map with these cuts; `x` and `y`: the tiles that each but the first begins at."""

    cuts: Cuts
    x: tuple[int, ...]
    y: tuple[int, ...]

    @classmethod
    def of(cls, cuts: Cuts, lattice: Lattice) -> "ShareLayout":
        """Those of a map on a lattice.

        Raises:
            BadSetting: a cut is no edge of the lattice's tiles.
        """
        columns = (Share(cuts, column).clip(lattice).xmin for column in range(1, len(cuts.x) + 1))
        rows = (Share(cuts, row * (len(cuts.x) + 1)).clip(lattice).ymin for row in range(1, len(cuts.y) + 1))
        return cls(
            cuts, *(tuple(edge // TILE for edge in edges if edge is not None) for edges in (columns, rows))
        )

    @property
    def count(self) -> int:
        """How many shares there are."""
        return self.cuts.count

    def owners(self, places: NDArray[np.int64]) -> NDArray[np.intp]:
        """Which share owns each of some tiles (tx, ty) of the lattice, shape (n, 2)."""
        return self._numbered(
            np.searchsorted(self.x, places[:, 0], "right"), np.searchsorted(self.y, places[:, 1], "right")
        )

    def table(self, rect: CellRect) -> NDArray[np.intp]:
        """Which share owns each of the tiles of a rectangle of whole ones, shape (tiles in x, tiles in y)."""
        left, bottom = rect.ix // TILE, rect.iy // TILE
        columns = np.searchsorted(self.x, np.arange(left, left + rect.width // TILE), "right")
        rows = np.searchsorted(self.y, np.arange(bottom, bottom + rect.height // TILE), "right")
        return self._numbered(columns[:, None], rows[None, :])

    def met(self, rect: CellRect) -> frozenset[int]:
        """Which shares own cells of a rectangle that is not empty."""
        right, top = rect.ix + rect.width - 1, rect.iy + rect.height - 1
        columns, rows = (
            range(bisect_right(edges, first // TILE), bisect_right(edges, last // TILE) + 1)
            for edges, first, last in ((self.x, rect.ix, right), (self.y, rect.iy, top))
        )
        return frozenset(row * (len(self.x) + 1) + column for row in rows for column in columns)

    def bounds(self, share: int) -> tuple[float | None, float | None, float | None, float | None]:
        """xmin, ymin, xmax and ymax of a share's rectangle, m; None where it is open."""
        return Share(self.cuts, share).bounds

    def _numbered(self, columns: NDArray[np.intp], rows: NDArray[np.intp]) -> NDArray[np.intp]:
        return rows * (len(self.x) + 1) + columns
