"""Published cells: they keep what a model has published of others, as blocks in pictures that are shrunk."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.model import CellModel, CellSource, Known, Plane, Planes, Probability, row_bands
from ogm_core.cells.thresholds import FREE_BELOW, OCCUPIED_ABOVE


class PublishedCells(CellModel):
    """A model of two planes, probability and known; nothing updates it."""

    sensor_models = frozenset()
    planes = (Plane("probability", np.dtype(np.float64)), Plane("known", np.dtype(np.uint8)))

    def __init__(self, l0: float, free_below: float = FREE_BELOW) -> None:
        """Cells of a model whose prior has the log odds `l0`, and whose cells are free below this."""
        self._l0, self.free_below = l0, free_below

    @property
    def l0(self) -> float:
        """Log odds of the prior."""
        return self._l0

    def update(self, *_: object) -> int:
        """Refuse: there is nothing that a scan could change."""
        raise NotImplementedError("published cells take no evidence")

    def published(self, planes: Planes) -> tuple[Probability, Known]:
        """Just what is kept."""
        return planes["probability"], planes["known"] != 0

    def pooled(self, source: CellSource, factor: int) -> tuple[CellModel, Planes]:
        """Blocks of what is kept, kept in the same way."""
        return pooled_probabilities(self, source, factor)


def pooled_probabilities(model: CellModel, source: CellSource, factor: int) -> tuple[CellModel, Planes]:
    """Blocks of `factor` x `factor` cells: the likeliest if that is occupied, else the least likely known."""
    p, known = np.empty(source.shape), np.empty(source.shape, np.bool_)
    for rows in row_bands(source.shape):
        p[rows], known[rows] = model.published(source.planes(rows, margin=model.margin))
    highest = pooled_extreme(np.maximum, np.where(known, p, -1.0), factor)
    lowest = pooled_extreme(np.minimum, np.where(known, p, 2.0), factor)
    blocks = np.where(highest > OCCUPIED_ABOVE, highest, lowest)
    any_known = highest >= 0.0
    prior = 1.0 / (1.0 + np.exp(-model.l0))
    planes = {"probability": np.where(any_known, blocks, prior), "known": any_known.astype(np.uint8)}
    return PublishedCells(model.l0, model.free_below), planes


def pooled_extreme(extreme: np.ufunc, cells: NDArray[Any], factor: int) -> NDArray[Any]:
    """The `extreme` of every block of `factor` x `factor` cells; the last ones may be smaller."""
    return _pooled_rows(extreme, _pooled_rows(extreme, cells, factor).T, factor).T


def _pooled_rows(extreme: np.ufunc, cells: NDArray[Any], factor: int) -> NDArray[Any]:
    # One pass over whole rows per row of a block: five times faster than reduceat or a 4-D reshape.
    pooled = cells[::factor].copy(order="K")
    for row in range(1, min(factor, len(cells))):
        part = cells[row::factor]
        extreme(pooled[: len(part)], part, out=pooled[: len(part)])
    return pooled
