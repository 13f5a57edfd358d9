"""Forgetting: with the time of a map its cells lose half of what they know in a half-life.

Time passes with scans alone: T = max(T, min(stamp, T + 1 s)) at each that is integrated, so that no clock
that jumps ages a map at once. A cell model says how many ticks there are in a half-life; one passes whenever
T comes to another of these parts, counted from the Unix epoch. Log odds have four, at each of which what a
cell keeps beside the prior is multiplied by 2^(-1/4). Counts have one, which halves them (see rate_sums).
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import BadSetting

TICKS_OF_LOG_ODDS = 4
TICK_FACTOR = 2.0 ** (-1 / TICKS_OF_LOG_ODDS)
"""What a tick leaves of log odds."""
MOST_TICKS = 56
"""After so many ticks 16383 steps, the most that a cell is away from the prior, are less than one: 2^-14.

Counts of 32 bits are 0 after 32."""
MIN_HALF_LIFE = 1.0
"""The shortest half-life, s: a scan moves the time of a map by that at most."""
MAX_HALF_LIFE = 1e9
"""The longest, s: thirty years."""
LONGEST_STEP = 1_000_000_000
"""By so much a scan moves the time of a map at most, ns."""


def tick_length(half_life: float, ticks: int) -> int:
    """How long one of so many ticks in a half-life (s) is, ns.

    Raises:
        BadSetting: no map can have that half-life.
    """
    if not MIN_HALF_LIFE <= half_life <= MAX_HALF_LIFE:
        raise BadSetting(f"half_life: {MIN_HALF_LIFE:g} to {MAX_HALF_LIFE:g} s are needed, got {half_life:g}")
    return round(half_life * 1e9 / ticks)


class MapTime(NamedTuple):
    """How far a map's time has come, and when ticks passed."""

    time: int | None = None
    """ns since the Unix epoch; None before the first scan."""
    ticks: tuple[int, ...] = ()
    """The revisions at which they passed, rising, one that passed several as often: the newest MOST_TICKS."""

    def after(self, stamp: int, revision: int, tick: int) -> "MapTime":
        """The time after a scan of this stamp, with which the map comes to `revision`; `tick` is in ns."""
        if self.time is None:
            return MapTime(stamp, self.ticks)
        time = max(self.time, min(stamp, self.time + LONGEST_STEP))
        passed = time // tick - self.time // tick
        if not passed:
            return MapTime(time, self.ticks)
        return MapTime(time, (*self.ticks, *(revision,) * passed)[-MOST_TICKS:])


def decayed_steps(steps: int) -> int:
    """trunc(steps * 2^(-1/4)), exactly: the largest whole number whose fourth power is not above."""
    left = math.isqrt(math.isqrt(abs(steps) ** 4 // 2))
    return left if steps >= 0 else -left


@lru_cache(maxsize=MOST_TICKS)
def decay_table(ticks: int) -> NDArray[np.int16]:
    """What every int16 cell of log odds (see log_odds) is after some ticks, shape (65536,), by its bits.

    A cell is steps times two and a bit, which stays; what is known and would be stored as 0 becomes 1.
    """
    if ticks > 1:
        before, once = decay_table(ticks - 1), decay_table(1)
        table = once[before.view(np.uint16)]
    else:
        every = np.arange(2**16, dtype=np.uint16).view(np.int16)
        left = np.array([decayed_steps(steps) for steps in range(2**14 + 1)], np.int16)
        steps = (every >> 1).astype(np.int32)
        table = (np.sign(steps) * left[np.abs(steps)] * 2 + (every & 1)).astype(np.int16)
        table[(table == 0) & (every != 0)] = 1
    table.flags.writeable = False
    return table


def decayed_log_odds(
    log_odds: NDArray[np.float64], l0: float, step: float, ticks: int
) -> NDArray[np.float64]:
    """Log odds after some ticks; `l0` is the prior's, and what comes within a `step` of it becomes that."""
    for _ in range(ticks):
        away = (log_odds - l0) * TICK_FACTOR
        away[np.abs(away) < step] = 0.0
        log_odds = l0 + away
    return log_odds
