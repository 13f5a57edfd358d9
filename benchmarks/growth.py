"""How the cost of a scan grows: with its beams, its range, the resolution, the map, and with the fleet.

Everything but one factor stays as in `Case()`. CPU time is measured; cell updates are
counted, and are the same on every machine.
"""

import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.log_odds import PLANE, LogOdds
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.types import PlacedScan, Pose, Scan

Floats = NDArray[np.float64]
Costs = dict[str, dict[str, Floats]]
"""By factor and variant: one number for every value of the factor."""

VARIANTS: dict[str, dict[str, Any]] = {
    "bresenham": {"traversal": "bresenham"},
    "dda": {"traversal": "dda"},
    "sector": {"sensor_model": "sector"},
}
"""Settings of a map by what the tables call it; cells are int16."""
NOISE = 0.02
"""Standard deviation of ranges, m."""
NEAR, SCATTERED = 16, 128
"""Scans around one place, and all over a map that is known beforehand."""
WARM = 4
"""Scans that are integrated before the clock is looked at."""


@dataclass(frozen=True)
class Case:
    """A round room, seen from its middle by `beams` beams over 360 degrees that all end at `reach`, m.

    `side`: cells on each side of a square that is known beforehand, and in which the scans are scattered; 0:
    the scans know what they have seen, and are taken within half a metre.
    """

    beams: int = 720
    reach: float = 10.0
    resolution: float = 0.05
    side: int = 0

    def grid(self, variant: str) -> OccupancyGrid:
        """The map before the first scan."""
        grid = OccupancyGrid(GridSettings(resolution=self.resolution, **VARIANTS[variant]))
        if self.side:
            known = LogOdds().store(np.zeros(1), np.ones(1, np.bool_))
            grid.begin_with({PLANE: np.full((self.side, self.side), known[0])})
        return grid

    def scans(self) -> list[PlacedScan]:
        """Seeded scans; those of a map that is known stay inside it."""
        rng = np.random.default_rng(1)
        count, low, high = NEAR, -0.5, 0.5
        if self.side:
            count, margin = SCATTERED, self.reach + 8 * NOISE + 2 * self.resolution
            low, high = margin, self.side * self.resolution - margin
        return [
            place(
                self.beams, self.reach, Pose(*rng.uniform((low, low, -math.pi), (high, high, math.pi))), rng
            )
            for _ in range(count)
        ]


def place(beams: int, reach: float, pose: Pose, rng: np.random.Generator, stamp: int = 0) -> PlacedScan:
    """A scan of a round room."""
    ranges = rng.normal(reach, NOISE, beams).astype(np.float32)
    step = 2.0 * math.pi / beams
    return PlacedScan(Scan(stamp, -math.pi, step, 0.0, 1.5 * reach, ranges), pose)


@dataclass(frozen=True)
class Factor:
    """What is varied: the field of `Case` of that name, its `values`, and where a line is `fitted`: from, to.

    `textbook` is its exponent in O(T K r_max / resolution) for T scans of K beams (Thrun, Burgard & Fox
    2005).
    """

    name: str
    values: tuple[float, ...]
    fitted: tuple[float, float]
    textbook: int

    def cases(self) -> list[Case]:
        """One case for every value."""
        fields = [{self.name: value} for value in self.values]
        return [replace(Case(), **field) for field in fields]  # type: ignore[arg-type]  # int where it is

    def exponent(self, costs: Floats) -> float:
        """Exponent of costs, one for every value, over the values that are fitted."""
        low, high = self.fitted
        at = np.array(self.values)
        chosen = (at >= low) & (at <= high)
        return power_law(at[chosen], costs[chosen])[0]


FACTORS = {
    factor.name: factor
    for factor in (
        Factor("beams", (45, 90, 180, 360, 720, 1440, 2880, 5760), (720, 5760), 1),
        Factor("reach", (1.25, 2.5, 5.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0, 80.0), (10.0, 40.0), 1),
        Factor(
            "resolution",
            (0.4, 0.2, 0.1, 0.07, 0.05, 0.035, 0.025, 0.018, 0.0125, 0.00625),
            (0.0125, 0.05),
            -1,
        ),
        Factor("side", (512, 1024, 2048, 4096, 8192), (512, 8192), 0),
    )
}


def power_law(x: Floats, y: Floats) -> tuple[float, float]:
    """(exponent, coefficient) of y = coefficient * x^exponent, by least squares of the logarithms."""
    exponent, level = np.polyfit(np.log(x), np.log(y), 1)
    return float(exponent), float(np.exp(level))


def updates(case: Case, variant: str) -> float:
    """Cell updates of a scan, on average."""
    grid = case.grid(variant)
    return float(np.mean([grid.integrate(scan, pose) for scan, pose, _ in case.scans()]))


class Timed:
    """One case in one variant, again and again: its map is known after a first round that nobody times."""

    def __init__(self, case: Case, variant: str) -> None:
        self._grid, self._scans = case.grid(variant), case.scans()
        self.round()

    def round(self) -> Floats:
        """CPU time of every scan, s; the last few go first untimed, so that caches hold this map."""
        seconds = np.empty(len(self._scans))
        for n in range(-WARM, seconds.size):
            scan, pose, _ = self._scans[n]
            begin = time.thread_time()
            self._grid.integrate(scan, pose)
            seconds[n] = time.thread_time() - begin
        return seconds


def measured(factors: Iterable[Factor], rounds: int) -> Costs:
    """CPU time of a scan, s."""
    jobs = {
        (factor.name, variant, n): Timed(case, variant).round
        for factor in factors
        for n, case in enumerate(factor.cases())
        for variant in VARIANTS
    }
    return best_of(jobs, rounds)


def best_of(jobs: Mapping[tuple[str, str, int], Callable[[], Floats]], rounds: int) -> Costs:
    """Mean of the least that each job returned, number by number, by (factor, variant, place in its values).

    All take turns: a slow minute of the machine is everybody's.
    """
    best = {key: job() for key, job in jobs.items()}
    for _ in range(rounds - 1):
        for key, job in jobs.items():
            best[key] = np.minimum(best[key], job())
    rows: dict[str, dict[str, list[float]]] = {}
    for (factor, variant, _n), found in best.items():
        rows.setdefault(factor, {}).setdefault(variant, []).append(float(found.mean()))
    return {factor: {name: np.array(row) for name, row in of.items()} for factor, of in rows.items()}
