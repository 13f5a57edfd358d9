"""Reliability of a map's probabilities: how often beams that it has not seen end in cells of each."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.cells.classes import percent
from ogm_core.quality.beam_likelihood import FARTHEST, crossed_cells, most_cells
from ogm_core.quality.held_out_beams import RANGE
from ogm_core.quality.judged_map import JudgedMap

CLASSES = 10
"""Probabilities are judged by so many classes of equal width."""
_PERCENT = 101
_UNKNOWN = 255


class Reliability(NamedTuple):
    """Of each class of probabilities: visits of its cells by beams, their mean p, share that ended there.

    Shape (CLASSES,) each; NaN where no beam was. What is reliable has `ended` = `predicted`.
    """

    visits: NDArray[np.int64]
    predicted: NDArray[np.float64]
    ended: NDArray[np.float64]


def reliability(judged: JudgedMap, rays: NDArray[np.float64]) -> Reliability:
    """How often held-out returns end in the known cells that they visit, by the cells' probability.

    Beams are followed up to 20 m; probabilities count in whole percent, as in /map.json.
    """
    percents = judged.snapshot.encode(percent).view(np.uint8)  # -1 becomes _UNKNOWN
    counts = count_visits(rays, judged.in_cells(rays), judged.resolution, percents)
    classes = np.minimum(np.arange(_PERCENT) * CLASSES // (_PERCENT - 1), CLASSES - 1)
    visits, ended = (np.bincount(classes, row, CLASSES) for row in (counts.sum(axis=0), counts[1]))
    sums = np.bincount(classes, counts.sum(axis=0) * np.arange(_PERCENT) / 100.0, CLASSES)
    with np.errstate(invalid="ignore"):
        return Reliability(visits.astype(np.int64), sums / visits, ended / visits)


@njit(cache=True, nogil=True, error_model="numpy")
def count_visits(
    rays: NDArray[np.float64],
    starts: NDArray[np.float64],
    resolution: float,
    percents: NDArray[np.uint8],
) -> NDArray[np.int64]:
    """How often rays passed cells of each percent, and how often they ended in them: shape (2, 101)."""
    room = most_cells(resolution)
    found, ends = np.empty(room, np.int64), np.empty(room)
    counts = np.zeros((2, _PERCENT), np.int64)
    for k in range(len(rays)):
        longest = min(rays[k, RANGE], FARTHEST)
        n = crossed_cells(
            rays[k], starts[k, 0], starts[k, 1], longest / resolution, percents, _UNKNOWN, found, ends
        )
        for i in range(n):
            if found[i] != _UNKNOWN:
                counts[int(i == n - 1 and rays[k, RANGE] < FARTHEST), found[i]] += 1
    return counts
