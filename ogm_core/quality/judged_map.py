"""A map as held-out beams judge it: the classes of its cells, and the bins of their log odds.

Any cell model is judged by what it publishes, on the lattice that it is published on.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.model import Known, Probability, row_bands
from ogm_core.cells.thresholds import FREE_BELOW, OCCUPIED_ABOVE
from ogm_core.quality.agreement import BELIEF_FREE, BELIEF_OCCUPIED, BELIEF_UNDECIDED
from ogm_core.snapshot import MapSnapshot

UNKNOWN = 0
"""Class of a cell that was never updated; the others are the beliefs of `agreement`."""
MOST_LOG_ODDS = 30.0
"""Log odds beyond this count as this: a float64 p tells them apart no more."""


@dataclass(frozen=True, slots=True, eq=False)
class JudgedMap:
    """Classes of a map's cells, [iy, ix], row 0 south, and the snapshot that they are of.

    `classes`: UNKNOWN, BELIEF_FREE, BELIEF_UNDECIDED or BELIEF_OCCUPIED, by the trinary map's thresholds.
    """

    snapshot: MapSnapshot
    classes: NDArray[np.uint8]

    @classmethod
    def of(cls, snapshot: MapSnapshot) -> "JudgedMap":
        """The map of a snapshot, in the cells that tell most of it."""
        finest = snapshot.finest()
        return cls(finest, finest.encode(four_classes))

    @property
    def resolution(self) -> float:
        """Side of a published cell, m."""
        return self.snapshot.resolution

    def in_cells(self, rays: NDArray[np.float64]) -> NDArray[np.float64]:
        """Starts of rays (see `held_out_beams`) in cells from the lower-left corner of `classes`."""
        return self.snapshot.lattice.in_cells(rays[:, :2]) - self.snapshot.offset

    def area(self, kind: int) -> float:
        """What the cells of a class fill, m2."""
        return int(np.count_nonzero(self.classes == kind)) * self.resolution**2

    def known_log_odds(self) -> NDArray[np.float64]:
        """Log odds of the known cells, row by row from the south."""
        parts = (
            self._log_odds(rows)[self.classes[rows] != UNKNOWN] for rows in row_bands(self.classes.shape)
        )
        return np.concatenate([np.empty(0), *parts])

    def bins(self, edges: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Bin of every cell: how many of the rising `edges` its log odds reach; one more if unknown."""
        bins = np.full(self.classes.shape, len(edges) + 1, np.uint8)
        for rows in row_bands(bins.shape):
            known = self.classes[rows] != UNKNOWN
            bins[rows][known] = np.searchsorted(edges, self._log_odds(rows)[known], side="right")
        return bins

    def _log_odds(self, rows: slice) -> NDArray[np.float64]:
        return np.clip(self.snapshot.log_odds(rows), -MOST_LOG_ODDS, MOST_LOG_ODDS)


def four_classes(p: Probability, known: Known, free_below: float = FREE_BELOW) -> NDArray[np.uint8]:
    """Class of cells: occupied (p > 0.65), free (p < free_below), undecided, or unknown."""
    decided = np.where(
        p > OCCUPIED_ABOVE, BELIEF_OCCUPIED, np.where(p < free_below, BELIEF_FREE, BELIEF_UNDECIDED)
    )
    return np.where(known, decided, UNKNOWN).astype(np.uint8)
