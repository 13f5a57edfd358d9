"""Quality figures of a map: entropy, areas, consistency with its scans."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.thresholds import OCCUPIED_ABOVE
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Lattice
from ogm_core.placing.clock_hints import ClockHints
from ogm_core.placing.hints import Hints
from ogm_core.quality import agreement
from ogm_core.sensor_models import beams
from ogm_core.sensor_models.projection import project
from ogm_core.snapshot import MapSnapshot
from ogm_core.types import PlacedScan, Pose, Scan

BEAMS_IN_A_ROW = 4096
"""Judged without a look at whether anybody still waits: a fraction of a second, even of the longest beams."""
BAND = 64
"""Rows that are judged together where not all can be."""
JUDGED_HITS = 32
"""Hits of a scan that `agreement_of_hits` looks at."""


def map_figures(snapshot: MapSnapshot) -> dict[str, Any]:
    """Entropy over known cells, in bits and as a mean per cell, and areas by class in m2.

    H = -sum(p log2 p + (1 - p) log2(1 - p)). Free and occupied are those of the trinary map.
    """
    levels = snapshot.model.levels(snapshot.stored)
    return _figures_of_levels(*levels, snapshot.model.free_below, snapshot.lattice.resolution**2)


def map_figures_within(snapshot: MapSnapshot, visits: int) -> tuple[dict[str, Any], float, int]:
    """The same at the cost of so many visits of cells: figures, share of the rows judged, visits spent.

    A map of more cells is judged by bands of rows, evenly spread over it; sums are those of the bands, in
    proportion.
    """
    cells, height = snapshot.width * snapshot.height, snapshot.height
    if cells <= visits:
        return map_figures(snapshot), 1.0, cells
    every = -(-cells // visits)
    rows = max(1, min(BAND, height // every))
    bands = [slice(row, min(row + rows, height)) for row in range(0, height - rows + 1, rows * every)]
    judged = sum(band.stop - band.start for band in bands)
    everywhere = slice(None)
    levels = [snapshot.model.levels(snapshot.stored.part(band, everywhere)) for band in bands]
    values, counts = (np.concatenate(part) for part in zip(*levels, strict=True))
    share = judged / height
    cell = snapshot.lattice.resolution**2
    figures = _figures_of_levels(values, counts, snapshot.model.free_below, cell, share)
    return figures, share, judged * snapshot.width


def _figures_of_levels(
    values: NDArray[np.float64],
    counts: NDArray[np.int64],
    free_below: float,
    cell: float,
    share: float = 1.0,
) -> dict[str, Any]:
    """Figures of cells of so many m2 that have these probabilities, so often; they are `share` of the map."""
    known = int(counts.sum())
    entropy = float((counts * _entropy(values)).sum())
    return {
        "entropy_bits": entropy / share,
        "mean_entropy_bits": entropy / known if known else None,
        "known_m2": known * cell / share,
        "free_m2": int(counts[values < free_below].sum()) * cell / share,
        "occupied_m2": int(counts[values > OCCUPIED_ABOVE].sum()) * cell / share,
    }


def quality_figures(snapshot: MapSnapshot, consistency: "Consistency", cell_updates: int) -> dict[str, Any]:
    """Every figure of a map and the scans in it; `cell_updates` is how many updates its cells have had."""
    return {
        **map_figures(snapshot),
        "consistency": consistency.figures(),
        "scans": snapshot.scans,
        "cell_updates": cell_updates,
    }


class Beliefs(NamedTuple):
    """A map by what is believed of its cells, for who holds scans against it; and what a scan is read by."""

    lattice: Lattice
    window: CellRect
    """Only its cells are judged."""
    sides: NDArray[np.uint8]
    """Of which side of p = 0.5 they are, [iy, ix], as `agreement` has them."""

    def judged(self, placed: PlacedScan, settings: GridSettings) -> NDArray[np.int64]:
        """What a scan that was integrated says of them: what `Consistency.take` takes."""
        return self.judged_beams(ends_in_map(placed, self.lattice, settings))

    def judged_beams(self, ends: NDArray[np.int64]) -> NDArray[np.int64]:
        """The same of some beams of a scan."""
        return np.array(agreement.agreement(ends, self.window, self.sides), np.int64)


class Consistency:
    """Share of hit end cells with p > 0.5, and of traversed cells with p < 0.5, in a finished map."""

    def __init__(
        self, snapshot: MapSnapshot, settings: GridSettings, window: CellRect | None = None, every: int = 1
    ) -> None:
        """Begin with no scan. Only cells in `window`, which lies in the map, are judged, if it is given.

        Of each scan one beam in `every` is judged.
        """
        self._every = every
        self._settings = settings
        sides = (snapshot if window is None else _cut(snapshot, window)).encode(_side_of_half)
        self.beliefs = Beliefs(snapshot.lattice, window or snapshot.rect, sides)
        self._counts = np.zeros(4, np.int64)

    def add(self, placed: PlacedScan, between: Callable[[], None] = lambda: None) -> None:
        """Judge a scan that was integrated.

        Calls `between` every BEAMS_IN_A_ROW beams; what that raises ends it, with the scan judged in part.
        """
        ends = ends_in_map(placed, self.beliefs.lattice, self._settings)[:, :: self._every]
        for first in range(0, ends.shape[1], BEAMS_IN_A_ROW):
            between()
            some = np.ascontiguousarray(ends[:, first : first + BEAMS_IN_A_ROW])
            self.take(self.beliefs.judged_beams(some))

    def take(self, counts: NDArray[np.int64]) -> None:
        """Take what was judged elsewhere (see `Beliefs.judged`): the sum of any number of scans."""
        self._counts += counts

    @property
    def visited(self) -> int:
        """How many cells were looked at."""
        return int(self._counts[0] + self._counts[2])

    def figures(self) -> dict[str, float | None]:
        """The shares, None where nothing was judged."""
        hits, occupied, passed, free = map(int, self._counts)
        return {"hits": occupied / hits if hits else None, "free": free / passed if passed else None}


def ends_in_map(placed: PlacedScan, lattice: Lattice, settings: GridSettings) -> NDArray[np.int64]:
    """The ends of a scan's beams (see sensor_models.beams) on a lattice, without those not in the map."""
    ends = project(placed, lattice, settings).ends
    if settings.outside == "drop" and settings.bounds_rect is not None:
        side = round(settings.resolution / lattice.resolution)
        beams.drop_outside(ends, *(side * edge for edge in settings.bounds_rect))
    return ends


def _cut(snapshot: MapSnapshot, window: CellRect) -> MapSnapshot:
    """The cells of a window that lies in the map."""
    column, row = window.ix - snapshot.rect.ix, window.iy - snapshot.rect.iy
    part = snapshot.stored.part(slice(row, row + window.height), slice(column, column + window.width))
    return replace(snapshot, stored=part, offset=(window.ix, window.iy))


def agreement_of_hits(snapshot: MapSnapshot, scan: Scan, pose: Pose) -> tuple[int, int]:
    """Of up to 32 hits of a scan: how many end in cells of the map with p > 0.5, and how many were judged.

    `pose` is the sensor's. Hits outside the map are not judged.
    """
    limit = scan.range_max if scan.reach is None else min(scan.range_max, scan.reach)
    hits = np.flatnonzero((scan.ranges > scan.range_min) & (scan.ranges < limit))
    hits = hits[:: max(1, math.ceil(hits.size / JUDGED_HITS))]
    bearings = pose.theta + (scan.angle_min + hits * scan.angle_increment)
    ranges = scan.ranges[hits].astype(np.float64)
    ends = np.stack((pose.x + ranges * np.cos(bearings), pose.y + ranges * np.sin(bearings)), axis=1)
    cells = np.floor(snapshot.lattice.in_cells(ends)).astype(np.int64) - snapshot.offset
    agreeing = judged = 0
    for ix, iy in cells.tolist():
        if 0 <= ix < snapshot.width and 0 <= iy < snapshot.height:
            probability, _ = snapshot.published(slice(iy, iy + 1), slice(ix, ix + 1))
            judged += 1
            agreeing += bool(probability[0, 0] > 0.5)
    return agreeing, judged


def hints_by(
    snapshot: Callable[[], MapSnapshot], settings: GridSettings, time: Callable[[], int | None]
) -> Hints:
    """Hints at sensors, by what the map of this moment says of their hits; `snapshot` takes it.

    `time` is the map's, of this moment, ns: of one that forgets.
    """
    return Hints(
        lambda scan, pose: agreement_of_hits(snapshot(), scan, pose),
        sector=settings.sensor_model == "sector",
        clocks=None if settings.tick is None else ClockHints(time, settings.tick),
    )


def _entropy(p: NDArray[np.float64]) -> NDArray[np.float64]:
    q = 1.0 - p
    # The limit of p log p is 0, where the logarithm has none.
    return -(p * np.log2(np.where(p > 0.0, p, 1.0)) + q * np.log2(np.where(q > 0.0, q, 1.0)))


def _side_of_half(p: NDArray[np.float64], known: NDArray[np.bool_], _free_below: float) -> NDArray[np.uint8]:
    sides = np.where(
        p > 0.5,
        agreement.BELIEF_OCCUPIED,
        np.where(p < 0.5, agreement.BELIEF_FREE, agreement.BELIEF_UNDECIDED),
    )
    return np.where(known, sides, 0).astype(np.uint8)
