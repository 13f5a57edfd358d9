"""The log-odds cell model: what a cell stores, how an observation changes it, and what it means.

Every observation adds a constant to l = ln(p / (1 - p)), the log odds of "occupied", and the sum is clamped
(Moravec & Elfes 1985; Elfes 1989; Thrun, Burgard & Fox 2005, ch. 9).

Two storage forms, both with a stored 0 for "never updated", so that untouched memory is an unknown map:

- int16: l - l0 in steps of max(l_max - l0, l0 - l_min) / 16383, times two, plus a bit that every hit sets: a
  cell that is brought back to the prior holds 1 and stays known. Without a hit cells only become negative,
  or 1 where the lower clamp rounds to the prior.
- float64: l itself. A known l of exactly zero is stored as -0.0, which adds and compares like 0.0; all bits
  zero (+0.0) is unknown.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.classes import OCCUPIED, trinary
from ogm_core.cells.forgetting import TICKS_OF_LOG_ODDS, decay_table, decayed_log_odds
from ogm_core.cells.int16_encoding import encode_by_steps, encoded_values, steps_of
from ogm_core.cells.model import (
    P_EDGE,
    CellEvidence,
    CellModel,
    CellSource,
    Encoder,
    Known,
    Plane,
    Planes,
    Probability,
    StoredCells,
    row_bands,
)
from ogm_core.cells.published import pooled_extreme
from ogm_core.cells.thresholds import FREE_BELOW, check_free_below
from ogm_core.errors import BadSetting

CellType = Literal["int16", "float64"]

FULL_SCALE = 16383
PLANE = "log_odds"
"""Name of the model's only plane."""


class CellConstants(NamedTuple):
    """What the kernels need of the model, in stored units.

    `free` and `occupied` are the increments, `lower` and `upper` the clamps, `prior` the value that a cell
    without observations starts from. float64: log odds. int16: steps times two; no increment is larger than
    the distance between the clamps, so that no sum leaves int16; a `lower` that rounds to the prior is 1, the
    known prior, because a free update sets no bit.
    """

    free: float | int
    occupied: float | int
    lower: float | int
    upper: float | int
    prior: float | int


def logit(p: float) -> float:
    """Log odds ln(p / (1 - p)) of a probability, clipped to [1e-9, 1 - 1e-9] first."""
    p = min(max(p, P_EDGE), 1.0 - P_EDGE)
    return math.log(p / (1.0 - p))


@dataclass(frozen=True)
class LogOdds(CellModel):
    """A log-odds model: probabilities of the prior and of the two observations, clamps, storage form.

    `free_below` is what the map shows as free.

    Raises:
        BadSetting: not p_free < p_prior < p_occ, not l_min < l0 < l_max, an observation is too weak to be
            stored as int16, or `free_below` is not below what is occupied.
    """

    ticks_a_half_life = TICKS_OF_LOG_ODDS

    cells: CellType = "int16"
    p_prior: float = 0.5
    p_occ: float = 0.7
    p_free: float = 0.3
    l_min: float = -8.0
    l_max: float = 8.0
    free_below: float = FREE_BELOW

    def __post_init__(self) -> None:
        check_free_below(self.free_below)
        values = (self.p_prior, self.p_occ, self.p_free, self.l_min, self.l_max)
        if not all(map(math.isfinite, values)):
            raise BadSetting("p_prior, p_occ, p_free, l_min, l_max: finite numbers are needed")
        if not all(0.0 <= p <= 1.0 for p in values[:3]):
            raise BadSetting("p_prior, p_occ, p_free: probabilities from 0 to 1 are needed")
        if not logit(self.p_free) < self.l0 < logit(self.p_occ):
            raise BadSetting(
                f"p_free < p_prior < p_occ is needed, got {self.p_free:g}, {self.p_prior:g}, {self.p_occ:g}"
            )
        if not self.l_min < self.l0 < self.l_max:
            raise BadSetting(
                f"l_min < logit(p_prior) < l_max is needed, got {self.l_min:g}, {self.l0:g}, {self.l_max:g}"
            )
        if self.cells == "int16" and not (round(self.d_free / self.step) and round(self.d_occ / self.step)):
            raise BadSetting(
                f"an observation changes the log odds by less than the int16 step of {self.step:.3g}: "
                "widen p_free and p_occ, narrow the clamps, or use float64 cells"
            )

    @property
    def l0(self) -> float:
        """Log odds of the prior."""
        return logit(self.p_prior)

    @property
    def d_occ(self) -> float:
        """Increment of an observation "occupied"."""
        return logit(self.p_occ) - self.l0

    @property
    def d_free(self) -> float:
        """Increment of an observation "free", negative."""
        return logit(self.p_free) - self.l0

    @property
    def step(self) -> float:
        """Log odds per step of an int16 cell."""
        return max(self.l_max - self.l0, self.l0 - self.l_min) / FULL_SCALE

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of a stored cell."""
        return np.dtype(self.cells)

    @property
    def planes(self) -> tuple[Plane, ...]:
        """One plane of log odds."""
        return (Plane(PLANE, self.dtype),)

    @property
    def described(self) -> dict[str, str | float]:
        """Its name, the prior's log odds, and those of a step of int16 cells."""
        return {"name": PLANE, "l0": self.l0, "step": self.step}

    def update(
        self, evidence: CellEvidence, store: object, window: tuple[int, int, int, int], revision: int
    ) -> int:
        """Add a constant to every cell that a scan speaks of (see cells.updates)."""
        return evidence.update_cells(store, window, revision, *self.by_cell)

    @cached_property
    def by_cell(self) -> tuple[str, tuple[Any, ...]]:
        """Its plane and its constants: an update does nothing else. Of float64 cells no prior that is 0."""
        constants = tuple(self.constants)
        return PLANE, constants[:-1] if self.cells == "float64" and self.l0 == 0.0 else constants

    @cached_property
    def constants(self) -> CellConstants:
        """Increments, clamps and prior in stored units."""
        if self.cells == "float64":
            return CellConstants(self.d_free, self.d_occ, float(self.l_min), float(self.l_max), self.l0)
        lower, upper = self._clamps_in_steps
        span = upper - lower
        free = max(round(self.d_free / self.step), -span)
        occupied = min(round(self.d_occ / self.step), span)
        return CellConstants(2 * free, 2 * occupied, 2 * lower or 1, 2 * upper, 0)

    @property
    def _clamps_in_steps(self) -> tuple[int, int]:
        return round((self.l_min - self.l0) / self.step), round((self.l_max - self.l0) / self.step)

    def known(self, cells: StoredCells) -> NDArray[np.bool_]:
        """Which cells were ever updated."""
        if cells.dtype == np.float64:
            return np.not_equal(cells.view(np.int64), 0)
        return np.not_equal(cells, 0)

    def log_odds(self, cells: StoredCells) -> NDArray[np.float64]:
        """Log odds of the cells, the prior's where unknown; float64."""
        if cells.dtype == np.float64:
            return np.where(self.known(cells), cells + 0.0, self.l0)
        return self.l0 + (cells >> 1).astype(np.float64) * self.step

    def probability(self, cells: StoredCells) -> NDArray[np.float64]:
        """Probability of "occupied", the prior's where unknown; float64."""
        return probability_of(self.log_odds(cells))

    def store(self, log_odds: NDArray[np.float64], known: NDArray[np.bool_]) -> StoredCells:
        """Cells of these log odds, cut off at the clamps, 0 where not known; shapes as given."""
        if self.cells == "float64":
            clamped = np.clip(log_odds, self.l_min, self.l_max)
            return np.where(known, np.where(clamped == 0.0, -0.0, clamped), 0.0)
        steps = np.clip(np.rint((log_odds - self.l0) / self.step), *self._clamps_in_steps)
        return np.where(known, 2.0 * steps + 1.0, 0.0).astype(np.int16)

    def encode(self, cells: StoredCells, encoder: Encoder) -> NDArray[Any]:
        """Apply an elementwise `encoder`; to int16 by what it makes of each value."""
        encoded = np.empty(cells.shape, encoder(np.empty(0), np.empty(0, np.bool_), self.free_below).dtype)
        for band in row_bands(cells.shape):
            part = cells[band]
            if cells.dtype == np.float64:
                encoded[band] = encoder(self.probability(part), self.known(part), self.free_below)
            elif steps := steps_of(self, encoder):
                encode_by_steps(part, steps, encoded[band].view(np.uint8))
            else:
                np.take(encoded_values(self, encoder), part.view(np.uint16), out=encoded[band], mode="clip")
        return encoded

    def decayed(self, planes: Planes, ticks: int) -> Planes:
        """Cells after some ticks, each of which brings them nearer to the prior; known ones stay known."""
        cells = planes[PLANE]
        if cells.dtype != np.float64:
            return {PLANE: np.take(decay_table(ticks), cells.view(np.uint16), mode="clip")}
        left = decayed_log_odds(cells, self.l0, self.step, ticks)
        return {PLANE: np.where(self.known(cells), np.where(left == 0.0, -0.0, left), 0.0)}

    def published(self, planes: Planes) -> tuple[Probability, Known]:
        """Probability, the prior's where unknown, and whether ever updated."""
        return self.probability(planes[PLANE]), self.known(planes[PLANE])

    def published_log_odds(self, planes: Planes) -> NDArray[np.float64]:
        """Log odds as they are stored, the prior's where unknown."""
        return self.log_odds(planes[PLANE])

    def encoded(self, planes: Planes, encoder: Encoder) -> NDArray[Any]:
        """What an elementwise encoder makes of the cells."""
        return self.encode(planes[PLANE], encoder)

    def table_of(self, encoder: Encoder) -> NDArray[Any] | None:
        """What an encoder makes of every int16 cell; None of float64 cells."""
        return encoded_values(self, encoder) if self.cells == "int16" else None

    def arrays(self, source: CellSource) -> dict[str, NDArray[Any]]:
        """Log odds, NaN where unknown; float64 of float64 cells, else float32."""
        cells = source.planes()[PLANE]
        served = np.empty(cells.shape, np.float64 if cells.dtype == np.float64 else np.float32)
        for band in row_bands(cells.shape):
            served[band] = np.where(self.known(cells[band]), self.log_odds(cells[band]), np.nan)
        return {PLANE: served}

    def known_cells(self, source: CellSource) -> int:
        """How many cells were ever updated: every one of them is stored as something else than 0."""
        return source.written(PLANE)

    def levels(self, source: CellSource) -> tuple[Probability, NDArray[np.int64]]:
        """Probabilities of the known cells, each once, and how many have it; of int16, all there can be."""
        if self.cells == "int16":
            every = np.arange(2**16, dtype=np.uint16).view(np.int16)
            return self.probability(every), source.value_counts(PLANE)
        cells = source.planes()[PLANE]
        values, counts = np.unique(cells[self.known(cells)], return_counts=True)
        return self.probability(values), counts

    def pooled(self, source: CellSource, factor: int) -> tuple[CellModel, Planes]:
        """Blocks as one stored cell each: stored cells grow with their probability, so they are compared."""
        cells = source.planes()[PLANE]
        least, most = _ends(cells.dtype)
        known = self.known(cells)
        highest = pooled_extreme(np.maximum, np.where(known, cells, least), factor)
        lowest = pooled_extreme(np.minimum, np.where(known, cells, most), factor)
        blocks = np.where(self.encode(highest, trinary) == OCCUPIED, highest, lowest)
        blocks[highest == least] = 0
        return self, {PLANE: blocks}


def _ends(dtype: np.dtype[Any]) -> tuple[Any, Any]:
    """The ends of a type's range; the lower one is never stored."""
    if dtype.kind == "f":
        return dtype.type(-np.inf), dtype.type(np.inf)
    limits = np.iinfo(dtype)
    return dtype.type(limits.min), dtype.type(limits.max)


def probability_of(log_odds: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Probability p = 1 / (1 + exp(-l)), float64; 0 where l is too small for float64 to tell."""
    with np.errstate(over="ignore"):
        return 1.0 / (1.0 + np.exp(-log_odds.astype(np.float64)))
