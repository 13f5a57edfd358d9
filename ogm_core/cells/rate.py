"""The rate cell model: how often a metre of beam ends in a cell, counted.

A cell's rate is hits / length of beam that passed, the most likely one given the beams (Schaefer, Luft &
Burgard 2017, "An analytical lidar sensor model based on ray path information", doi 10.1109/LRA.2017.2669376).

    plane  side  unit             what it counts
    N      1     1/16 cell        length of passing of beams that met something; it wraps, and C counts that
    C      1     65536 units of N
    F      1     1 beam           passing of beams that met nothing; it stops at 65535
    E      2     1/16 half        length of passing in the last two columns before a hit
    H      2     1/1024 hit       hits, each shared by the four halves around its point

A half is half as wide as a cell. All zero is "never observed". Every number is a sum of whole numbers that
depend on one beam alone: the order of scans does not matter, and the planes of maps of one lattice add up.
One that would not fit stops at the largest that its plane holds, N and C together (see cells.rate_sums).

Two lattices can be served: `Rate` publishes cells, `RateHalves` halves, of which a map tells more.
"""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.halves import HITS, PASSING, PLANES_OF_HALVES, UNANSWERED, Halves, passing_of
from ogm_core.cells.log_odds import PLANE as LOG_ODDS
from ogm_core.cells.log_odds import logit, probability_of
from ogm_core.cells.model import (
    P_EDGE,
    CellEvidence,
    CellModel,
    CellSource,
    Known,
    Plane,
    Planes,
    Probability,
    row_bands,
)
from ogm_core.cells.published import pooled_probabilities
from ogm_core.cells.rate_publishing import (
    HIT_UNIT,
    LENGTH_UNIT,
    OF_CELLS,
    OF_HALVES,
    Counts,
    Publish,
    Publishing,
    Unanswered,
    publish,
)
from ogm_core.cells.rate_sums import add_counts, halved_counts
from ogm_core.cells.thresholds import FREE_BELOW, OCCUPIED_ABOVE, check_free_below

PLANES = (
    Plane("N", np.dtype(np.uint16)),
    Plane("C", np.dtype(np.uint16)),
    Plane("F", np.dtype(np.uint16)),
    Plane("E", np.dtype(np.uint32), 2),
    Plane("H", np.dtype(np.uint32), 2),
)


class _Counted(CellModel):
    """What the two lattices have in common."""

    sensor_models = frozenset({"beam"})
    l0 = 0.0
    rule: Publishing
    """How its counts are published."""
    per_cell: int
    """How many of its cells lie along the side of one in which beams are counted."""

    def __init__(self, publish: Publish = publish, free_below: float = FREE_BELOW) -> None:
        """Cells that are published by NumPy, or by its compiled twin (see cells.rate_kernel).

        Raises:
            BadSetting: `free_below` is not below what is occupied.
        """
        check_free_below(free_below)
        self.publish, self.free_below = publish, free_below

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and other.free_below == self.free_below

    def __hash__(self) -> int:
        return hash((type(self), self.free_below))

    @abstractmethod
    def handed_over(self, planes: Planes) -> tuple[Counts, Counts, Unanswered]:
        """The counts that are published: see `Publish`."""

    def published(self, planes: Planes) -> tuple[Probability, Known]:
        """Probability and whether known."""
        return self.publish(*self.handed_over(planes), self.rule)

    def counted(self, planes: Planes) -> dict[str, NDArray[Any]]:
        """Length of passing, hits, and beams that met nothing."""
        edge = self.rule.margin
        passing, hits, unanswered = (
            cells[edge : cells.shape[0] - edge, edge : cells.shape[1] - edge]
            for cells in self.handed_over(planes)
        )
        return {"passing": passing / LENGTH_UNIT, "hits": hits / HIT_UNIT, "no_returns": unanswered}

    def arrays(self, source: CellSource) -> dict[str, NDArray[Any]]:
        """Log odds of what is published, float32, NaN where unknown; the planes, and `per_cell`.

        The planes are those of the cells that `source` meets.
        """
        served = np.empty(source.shape, np.float32)
        for rows in row_bands(source.shape):
            served[rows] = log_odds_of(
                *self.published(source.planes(rows, margin=self.margin)), self.free_below
            )
        counted = source.cells if isinstance(source, Halves) else source
        return {LOG_ODDS: served, **counted.planes(), "per_cell": np.array(self.per_cell)}

    def pooled(self, source: CellSource, factor: int) -> tuple[CellModel, Planes]:
        """Blocks of what is published."""
        return pooled_probabilities(self, source, factor)


class Rate(_Counted):
    """Counts, as the map keeps them; published are its cells, of the counts of all that lies in them."""

    lengths = True
    rule = OF_CELLS
    per_cell = 1
    margin = OF_CELLS.margin
    spread = 2
    finest = 2
    adds_up = True
    planes = PLANES
    ticks_a_half_life = 1

    @property
    def described(self) -> dict[str, str | float]:
        """Its name: it has no constants."""
        return {"name": "rate"}

    def update(
        self, evidence: CellEvidence, store: object, window: tuple[int, int, int, int], revision: int
    ) -> int:
        """Count a scan's beams (see sensor_models.passing)."""
        return evidence.update_planes(store, window, revision)

    def add(self, sums: Mapping[str, NDArray[Any]], planes: Planes) -> None:
        """Add counts to others, in place."""
        add_counts(sums, planes)

    def decayed(self, planes: Planes, ticks: int) -> Planes:
        """Counts after some ticks, each of which halves them; what nothing is left of is unknown again."""
        return halved_counts(planes, ticks)

    def handed_over(self, planes: Planes) -> tuple[Counts, Counts, Unanswered]:
        """The counts of the cells: of all that lies in them."""
        cells = planes["F"]
        passing = 2.0 * passing_of(planes) + _put_together(planes["E"], cells.shape)
        return passing, _put_together(planes["H"], cells.shape), cells

    def halved(self, source: CellSource) -> tuple[CellModel, CellSource]:
        """The halves, which tell more than the cells."""
        return RateHalves(self.publish, self.free_below), Halves(source)


class RateHalves(_Counted):
    """Halves of counted cells, as `cells.halves.Halves` lays them out; nothing updates them."""

    sensor_models = frozenset()
    rule = OF_HALVES
    per_cell = 2
    margin = OF_HALVES.margin
    planes = PLANES_OF_HALVES

    def update(self, *_: object) -> int:
        """Refuse: there is nothing that a scan could change."""
        raise NotImplementedError("halves are made of cells that take evidence, and take none")

    def handed_over(self, planes: Planes) -> tuple[Counts, Counts, Unanswered]:
        """The counts of the halves, as they are laid out."""
        return planes[PASSING], planes[HITS], planes[UNANSWERED]


def log_odds_of(p: Probability, known: Known, free_below: float = FREE_BELOW) -> NDArray[np.float32]:
    """Log odds that read back as p, up to rounding, and as the very same class; NaN where unknown."""
    within = np.clip(p, P_EDGE, 1.0 - P_EDGE)
    served = np.log(within / (1.0 - within)).astype(np.float32)
    read = probability_of(served)
    for threshold in (OCCUPIED_ABOVE, free_below):  # many cells are just as likely as CEILING
        served[(p <= threshold) & (read > threshold)] = np.nextafter(np.float32(logit(threshold)), -np.inf)
        served[(p >= threshold) & (read < threshold)] = np.nextafter(np.float32(logit(threshold)), np.inf)
    served[~known] = np.nan
    return served


def _put_together(halves: NDArray[Any], shape: tuple[int, ...]) -> NDArray[np.int64]:
    """The sum of the four halves of every cell."""
    height, width = shape
    wide: NDArray[np.int64] = halves.reshape(height, 2, width, 2).astype(np.int64).sum(axis=(1, 3))
    return wide
