"""Judgement of a map by beams that it has not seen: bits a beam over an empty map, and where beams end."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ogm_core.grid_settings import GridSettings
from ogm_core.quality.agreement import BELIEF_FREE, BELIEF_OCCUPIED
from ogm_core.quality.beam_likelihood import (
    ANY_FAR,
    ANY_RANGE,
    FARTHEST,
    INLIERS,
    ends_and_lengths,
    nats_of_ranges,
)
from ogm_core.quality.first_walls import FirstWalls, first_walls
from ogm_core.quality.hazards import fitted_rates, step_edges
from ogm_core.quality.held_out_beams import RANGE, HeldOutBeams, beams_of
from ogm_core.quality.judged_map import UNKNOWN, JudgedMap
from ogm_core.snapshot import MapSnapshot
from ogm_core.types import PlacedScan

FEWEST = 3
"""With fewer held-out scans one half of them is empty, and nothing can be fitted to it."""
BLOCK = 4
"""Held-out scans that are drawn together where it is asked how sure the bits are: neighbours are alike."""
RESAMPLED = 1000
SURE = 0.95
"""The interval holds so many of the resampled means."""


@dataclass(frozen=True, slots=True)
class Judgement:
    """Figures of a map by held-out beams; those that there are no beams for are None.

    `bits`: how many bits a beam the map saves over an empty one, and their `interval` of 95 %, also None of
    fewer than FEWEST scans; `walls`: see there; areas in m2; `beams`: how many returns judged it.
    """

    bits: float | None
    interval: tuple[float, float] | None
    walls: FirstWalls
    free_m2: float
    occupied_m2: float
    known_m2: float
    beams: int


def judge(snapshot: MapSnapshot, settings: GridSettings, scans: Sequence[PlacedScan]) -> Judgement:
    """Judge a map by scans that are not in it."""
    return judge_by(JudgedMap.of(snapshot), beams_of(scans, settings))


def judge_by(judged: JudgedMap, beams: HeldOutBeams) -> Judgement:
    """Judge a map by held-out beams."""
    bits = interval = None
    if len(beams.rays) and len(beams.readings) >= FEWEST:
        saved = (nats_of_empty_map(beams.rays[:, RANGE]) - nats_of_map(judged, beams)) / math.log(2.0)
        bits, interval = float(saved.mean()), _interval(saved, beams)
    return Judgement(
        bits,
        interval,
        first_walls(judged, beams.rays),
        judged.area(BELIEF_FREE),
        judged.area(BELIEF_OCCUPIED),
        judged.classes.size * judged.resolution**2 - judged.area(UNKNOWN),
        len(beams.rays),
    )


def nats_of_map(judged: JudgedMap, beams: HeldOutBeams) -> NDArray[np.float64]:
    """-ln p(r) of every held-out return, by hazards that were fitted to the other half of the scans.

    Scans are dealt in pairs.
    """
    edges = step_edges(judged.known_log_odds())
    bins = judged.bins(edges)
    nats = np.empty(len(beams.rays))
    pairs = np.arange(len(beams.readings)) // 2 % 2
    for half in (0, 1):
        fit, score = beams.part(pairs == half), beams.part(pairs != half)
        rates = fitted_rates(edges, partial(_count, judged, bins, fit), int(fit.readings.sum()))
        nats[pairs[beams.scans] != half] = nats_of_ranges(
            score.rays, judged.in_cells(score.rays), judged.resolution, bins, rates
        )
    return nats


def nats_of_empty_map(ranges: NDArray[np.float64]) -> NDArray[np.float64]:
    """-ln p(r) of ranges, m, in a map that says the same of every place."""
    near = ranges < FARTHEST
    rate = np.count_nonzero(near) / np.minimum(ranges, FARTHEST).sum()
    density = INLIERS * rate * np.exp(-rate * ranges) + ANY_RANGE
    return -np.log(np.where(near, density, INLIERS * math.exp(-rate * FARTHEST) + ANY_FAR))


def _count(
    judged: JudgedMap, bins: NDArray[np.uint8], beams: HeldOutBeams, rates: NDArray[np.float64]
) -> NDArray[np.float64]:
    counted: NDArray[np.float64] = ends_and_lengths(
        beams.rays, judged.in_cells(beams.rays), judged.resolution, bins, rates
    )
    return counted


def _interval(saved: NDArray[np.float64], beams: HeldOutBeams) -> tuple[float, float]:
    """Where the mean of the saved bits lies, by bootstrap over blocks of neighbouring scans."""
    blocks = beams.scans // BLOCK
    count = int(blocks.max()) + 1
    sums, sizes = np.bincount(blocks, saved, count), np.bincount(blocks, minlength=count)
    sums, sizes = sums[sizes > 0], sizes[sizes > 0]
    drawn = np.random.Generator(np.random.PCG64(0)).integers(0, len(sums), (RESAMPLED, len(sums)))
    low, high = np.quantile(
        sums[drawn].sum(axis=1) / sizes[drawn].sum(axis=1), [(1 - SURE) / 2, (1 + SURE) / 2]
    )
    return float(low), float(high)
