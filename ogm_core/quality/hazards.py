"""Hazard of a map's cells: how often a metre of beam ends in a cell of these log odds, as beams tell it.

The best monotone step function is fitted to each map, so that scale, clamps and thresholds of its log odds
cannot win: only what it knows does.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

DRAWN = 40_000
"""So many known cells are drawn to place the steps, at most, and as many of the likeliest."""
LIKELIEST = 0.85
"""Quantile of the log odds above which cells are drawn once more."""
STEPS = 30
ROUNDS = 5
LOWEST, HIGHEST, UNKNOWN = 0.02, 20.0, 0.3
"""Rates that the fit begins with, 1/m: of the lowest log odds, of the highest, of unknown cells."""
SCALE = 1e4
"""The evidence counts as if so many beams were held out."""
PRIOR, PRIOR_UNKNOWN = (1e-3, 1e-2), (0.01, 0.1)
"""Ends and metres that every bin has beforehand."""


class CountEnds(Protocol):
    """What counts ends and metres by bin under given rates: shape (2, bins + 1), unknown cells last."""

    def __call__(self, rates: NDArray[np.float64]) -> NDArray[np.float64]:
        """Count."""


def step_edges(known: NDArray[np.float64]) -> NDArray[np.float64]:
    """Log odds at which the step function may rise: distinct quantiles of cells drawn from the `known`."""
    if not known.size:
        return np.empty(0)
    random = np.random.Generator(np.random.PCG64(0))
    drawn = min(DRAWN, known.size)
    pool = [random.choice(known, drawn)]
    likeliest = known[known > np.quantile(known, LIKELIEST)]
    if likeliest.size:
        pool.append(random.choice(likeliest, drawn))
    edges: NDArray[np.float64] = np.unique(np.quantile(np.concatenate(pool), np.arange(1, STEPS) / STEPS))
    return edges


def fitted_rates(edges: NDArray[np.float64], count: CountEnds, readings: int) -> NDArray[np.float64]:
    """Rates, 1/m, of the bins between `edges`, rising, and of unknown cells, last; by maximum likelihood.

    `count` tells what held-out beams, of so many `readings`, say of each bin. (EM, with the rates kept in
    order by pooling adjacent violators.)
    """
    rates = np.append(np.geomspace(LOWEST, HIGHEST, len(edges) + 1), UNKNOWN)
    for _ in range(ROUNDS):
        ends, metres = count(rates) * (SCALE / readings)
        ends[:-1] += PRIOR[0]
        metres[:-1] += PRIOR[1]
        rates[:-1] = isotonic_regression(ends[:-1] / metres[:-1], weights=metres[:-1]).x
        rates[-1] = (ends[-1] + PRIOR_UNKNOWN[0]) / (metres[-1] + PRIOR_UNKNOWN[1])
    return rates
