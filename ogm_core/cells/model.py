"""The cell model: what a cell keeps, how evidence changes it, and what it means, in one class.

Layout, copies, snapshots, pictures, files and figures know cells by this alone: planes by name, of which a
stored 0 says that nothing was ever written, and the probabilities that a model makes of a window of them.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.thresholds import FREE_BELOW

StoredCells = NDArray[Any]
"""Cells of a plane as a model stores them, any shape; a stored 0 was never updated."""
Planes = Mapping[str, StoredCells]
"""The planes of a rectangle of cells by name, each [iy, ix], row 0 south; of side 2, twice as many a side."""
Probability = NDArray[np.float64]
Known = NDArray[np.bool_]
Encoder = Callable[[Probability, Known, float], NDArray[Any]]
"""From (probability, known, free_below) of cells to what is served of them, element by element."""

MAX_MARGIN = 3
P_EDGE = 1e-9
"""Probabilities are clipped to [1e-9, 1 - 1e-9] before the logit is taken."""
_BAND_CELLS = 2**18


class Plane(NamedTuple):
    """One array of numbers over the map: `side` x `side` of them a cell, 1 or 2."""

    name: str
    dtype: np.dtype[Any]
    side: int = 1


def cell_bytes(plane: Plane) -> int:
    """Memory that a plane takes of each cell of the map."""
    return plane.side**2 * np.dtype(plane.dtype).itemsize


class CellSource(Protocol):
    """The planes of a rectangle of cells that never change, and of what surrounds it."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of cells."""

    def planes(self, rows: slice = ..., columns: slice = ..., margin: int = 0) -> Planes:
        """The planes of some rows and columns, with so many cells more on every side; 0 beyond the map."""

    def part(self, rows: slice, columns: slice) -> "CellSource":
        """The rectangle of some rows and columns."""

    def written(self, name: str) -> int:
        """How many numbers of a plane are not 0, bit for bit."""

    def value_counts(self, name: str) -> NDArray[np.int64]:
        """How often each value but 0 occurs in a plane of 16 bits: shape (65536,), by its bits."""


class CellEvidence(Protocol):
    """What a placed scan says about which cells (ogm_core.sensor_models.evidence)."""

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """Its beams or spans, for models that read them by themselves."""

    def touch(
        self,
        store: Any,  # noqa: ANN401 - a TileStore, which this room does not know
        window: Any,  # noqa: ANN401 - a CellRect
        revision: int,
    ) -> None:
        """Mark every tile of whose cells the scan speaks; who calls `update_cells` need not."""

    def update_cells(
        self,
        store: Any,  # noqa: ANN401 - a TileStore
        window: Any,  # noqa: ANN401 - a CellRect
        revision: int,
        plane: str,
        constants: tuple[Any, ...],
    ) -> int:
        """Let `cells.updates` change every cell that the scan speaks of; return the number of updates.

        The plane's dtype chooses the update: int16 and float64 are those of `log_odds`, and a model with
        another update needs another dtype there. The plane has one number a cell.
        """

    def update_planes(
        self,
        store: Any,  # noqa: ANN401 - a TileStore
        window: Any,  # noqa: ANN401 - a CellRect
        revision: int,
    ) -> int:
        """Count in all planes of the store at once: of evidence for models that take `lengths`."""


class CellModel(ABC):
    """What every model gives; a new one says its planes, its update, its probabilities and its blocks."""

    sensor_models: frozenset[str] = frozenset({"beam", "sector"})
    """Whose evidence it takes."""
    lengths: bool = False
    """Whether it takes lengths of passing (sensor_models.passing), not cells along a traversal."""
    spread: int = 0
    """How many cells around a written one may be known."""
    finest: int = 1
    """How many cells along a side of one the map can be served in: 2 if it has `halved`."""
    margin: int = 0
    """On how many cells around a cell its probability depends, up to MAX_MARGIN."""
    free_below: float = FREE_BELOW
    """Which probabilities mean "free": it changes what the map shows, never what it keeps."""
    ticks_a_half_life: int = 0
    """How many ticks (see cells.forgetting) it has in a half-life; 0: no `decayed`, it never forgets."""
    adds_up: bool = False
    """Whether it has `add`: what a map that keeps its robots apart needs."""

    @property
    def by_cell(self) -> tuple[str, tuple[Any, ...]] | None:
        """A plane, and constants, with which `cells.updates` alone change its cells; None: it does more."""
        return None

    @property
    @abstractmethod
    def planes(self) -> tuple[Plane, ...]:
        """What a cell keeps."""

    @property
    @abstractmethod
    def l0(self) -> float:
        """Log odds of the prior."""

    @property
    def described(self) -> dict[str, str | float]:
        """What a program that is sent the planes must know to read them: `name`, and constants."""
        return {"name": type(self).__name__}

    @property
    def told(self) -> dict[str, str | float]:
        """`described`, and `free_below` of a map that has one of its own."""
        own = {} if self.free_below == FREE_BELOW else {"free_below": self.free_below}
        return {**self.described, **own}

    @abstractmethod
    def update(
        self,
        evidence: CellEvidence,
        store: Any,  # noqa: ANN401 - a TileStore
        window: tuple[int, int, int, int],
        revision: int,
    ) -> int:
        """Add a scan's evidence to the planes of a tile store; return the number of cell updates.

        `evidence` is of a kind that the model takes; `window` as `evidence.window` gives it: only cells in
        it are updated. Tiles that are written are marked with `revision`.
        """

    @abstractmethod
    def published(self, planes: Planes) -> tuple[Probability, Known]:
        """Probability of "occupied" and whether ever updated, of a window of cells without its `margin`.

        float64 and bool, [iy, ix]; the prior's probability where unknown.
        """

    def decayed(self, planes: Planes, ticks: int) -> Planes:
        """Stored cells, of whatever shape, after some ticks (see cells.forgetting)."""
        raise NotImplementedError(f"{type(self).__name__} cells do not forget, not even by {ticks} ticks")

    def add(self, sums: Mapping[str, StoredCells], planes: Planes) -> None:
        """Add stored cells, of whatever shape, to `sums`, as if one map had taken the evidence of both."""
        raise NotImplementedError(f"{type(self).__name__} cells do not add up: {len(planes)} to {len(sums)}")

    def published_log_odds(self, planes: Planes) -> NDArray[np.float64]:
        """Log odds of the same cells, the prior's where unknown."""
        p = np.clip(self.published(planes)[0], P_EDGE, 1.0 - P_EDGE)
        return np.log(p / (1.0 - p))

    def encoded(self, planes: Planes, encoder: Encoder) -> NDArray[Any]:
        """What an elementwise encoder makes of the same cells."""
        return encoder(*self.published(planes), self.free_below)

    def table_of(self, encoder: Encoder) -> NDArray[Any] | None:
        """What an elementwise encoder makes of every number of 16 bits, shape (65536,), by its bits.

        For models of one plane of these, of side 1 and without a margin; None for others.
        """
        return None

    def counted(self, planes: Planes) -> dict[str, NDArray[Any]] | None:
        """What was counted in a window of cells without its `margin`, by name; None of models that do not.

        `passing` in sides of a cell, `hits`, and `no_returns` in beams.
        """
        return None

    def arrays(self, source: CellSource) -> dict[str, NDArray[Any]]:
        """What /map.npz holds of the cells: the planes as they are."""
        return dict(source.planes())

    def known_cells(self, source: CellSource) -> int:
        """How many cells were ever updated."""
        return sum(
            int(np.count_nonzero(self.published(source.planes(rows, margin=self.margin))[1]))
            for rows in row_bands(source.shape)
        )

    def levels(self, source: CellSource) -> tuple[Probability, NDArray[np.int64]]:
        """Probabilities of the known cells, each once, and how many have it."""
        parts = (self.published(source.planes(rows, margin=self.margin)) for rows in row_bands(source.shape))
        values = np.concatenate([np.empty(0), *(p[known] for p, known in parts)])
        return np.unique(values, return_counts=True)

    def halved(self, source: CellSource) -> "tuple[CellModel, CellSource] | None":
        """The map in cells half as wide, and their model; None if that would tell no more."""
        return None

    @abstractmethod
    def pooled(self, source: CellSource, factor: int) -> "tuple[CellModel, Planes]":
        """Square blocks of `factor` x `factor` cells in place of cells, and the model that reads them.

        A block is its likeliest cell if that one counts as occupied, else its least likely known cell.
        `published.pooled_probabilities` does that for any model; where cells compare, it is cheaper.
        """


def row_bands(shape: tuple[int, ...]) -> Iterator[slice]:
    """Slices of rows, about 2^18 cells each: few enough to stay in the processor's cache."""
    rows = max(1, _BAND_CELLS // max(1, int(np.prod(shape[1:]))))
    for first in range(0, shape[0], rows):
        yield slice(first, first + rows)
