"""A peer's rule: hits and passes of every cell are counted, as in the maps of Karto.

Its cells are hit where beams end, and passed on Bresenham's line before that; the sensor's own is neither.
"""

from collections.abc import Iterable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.published import PublishedCells
from ogm_core.grid_settings import GridSettings
from ogm_core.quality.agreement import BELIEF_FREE, BELIEF_OCCUPIED
from ogm_core.quality.judged_map import UNKNOWN, JudgedMap
from ogm_core.sensor_models.beams import HIT, IX, IX0, IY, IY0, KIND, SKIPPED
from ogm_core.sensor_models.projection import project
from ogm_core.snapshot import MapSnapshot
from ogm_core.types import PlacedScan

OCCUPIED_ABOVE = 0.1
"""Share of hits from which on its maps show a cell as occupied."""
PRIOR = 1e-3


def karto_map(scans: Iterable[PlacedScan], settings: GridSettings) -> JudgedMap:
    """The map that the rule makes of some scans, to be judged."""
    ends = [project(placed, settings.lattice, settings).ends for placed in scans]
    counting = np.concatenate([beams[:, beams[KIND] != SKIPPED] for beams in ends], axis=1)
    columns, rows = counting[[IX, IX0]], counting[[IY, IY0]]
    corner = int(columns.min()), int(rows.min())
    counts = np.zeros((2, int(rows.max()) - corner[1] + 1, int(columns.max()) - corner[0] + 1), np.int64)
    _count(counting, corner[0], corner[1], counts)
    passes, hits = counts
    known = hits + passes > 0
    odds = (hits + PRIOR) / (passes + PRIOR)
    probability = odds / (1.0 + odds)
    cells = CellArrays({"probability": probability, "known": known.astype(np.uint8)})
    snapshot = MapSnapshot(cells, PublishedCells(0.0), settings.lattice, corner, "", 0, None)
    shown = np.where(probability > OCCUPIED_ABOVE, BELIEF_OCCUPIED, BELIEF_FREE)
    return JudgedMap(snapshot, np.where(known, shown, UNKNOWN).astype(np.uint8))


@njit(cache=True, nogil=True, error_model="numpy")
def _count(ends: NDArray[np.int64], west: int, south: int, counts: NDArray[np.int64]) -> None:
    """Add beams to passes and hits, shape (2, h, w)."""
    for b in range(ends.shape[1]):
        i, j, last_i, last_j = (
            ends[IX0, b] - west,
            ends[IY0, b] - south,
            ends[IX, b] - west,
            ends[IY, b] - south,
        )
        di, dj = abs(last_i - i), abs(last_j - j)
        si, sj = 1 if i < last_i else -1, 1 if j < last_j else -1
        error = di - dj
        while i != last_i or j != last_j:
            doubled = 2 * error
            if doubled > -dj:
                error -= dj
                i += si
            if doubled < di:
                error += di
                j += sj
            ended = i == last_i and j == last_j and ends[KIND, b] == HIT
            counts[1 if ended else 0, j, i] += 1
