"""How a map settles: samples while it changes, thinned when there are many, and none that costs too much."""

import math
from itertools import pairwise

import numpy as np
import pytest

from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.quality.figures import map_figures
from ogm_core.types import Pose, Scan
from ogm_services.mapper.live.history import CAPACITY, PERIOD, REST, History, Sample, sample_of

FIELDS = ["stamp", "revision", "mean_entropy_bits", "entropy_bits", "known_m2", "hit"]


class Look:
    """Stands in for a snapshot."""

    def __init__(self, epoch, revision):
        self.epoch, self.revision = epoch, revision


def look(series, revision, now, *, epoch="e", cost=0.0, known=True):
    """Look at a map as a monitor does; whether it was due."""
    due = series.due(epoch, revision, now)
    if due:
        figures = 0.5, revision / 2, revision / 4, None if revision % 3 else 0.75
        sample = Sample(round(now * 1e9), revision, *figures) if known else None
        series.take(Look(epoch, revision), sample, now, now + cost)
    return due


def revisions(series, epoch="e"):
    return series.columns(epoch)["revision"]


def test_a_sample_is_what_its_fields_say():
    series = History()
    assert series.columns("e") == {name: [] for name in FIELDS}
    look(series, 8, 3.0)
    look(series, 12, 4.0)
    assert series.columns("e") == {
        "stamp": [3_000_000_000, 4_000_000_000],
        "revision": [8, 12],
        "mean_entropy_bits": [0.5, 0.5],
        "entropy_bits": [4.0, 6.0],
        "known_m2": [2.0, 3.0],
        "hit": [None, 0.75],
    }


def test_samples_are_a_second_apart_and_of_a_map_that_has_changed():
    assert PERIOD == 1.0
    series = History()
    assert look(series, 1, 10.0)
    assert not look(series, 2, 10.999)
    assert look(series, 2, 11.0)
    assert not look(series, 2, 60.0)
    assert look(series, 3, 60.5)
    assert not look(series, 4, 61.4)
    assert revisions(series) == [1, 2, 3]


def test_when_it_is_full_every_second_one_goes_and_the_period_doubles():
    series = History()
    for second in range(CAPACITY):
        assert look(series, second, float(second))
    assert revisions(series) == list(range(CAPACITY))
    assert look(series, CAPACITY, float(CAPACITY))
    assert revisions(series) == list(range(0, CAPACITY + 1, 2))
    taken = [s for s in range(CAPACITY + 1, 2 * CAPACITY + 1) if look(series, s, float(s))]
    assert taken == list(range(CAPACITY + 2, 2 * CAPACITY + 1, 2))
    assert revisions(series) == list(range(0, 2 * CAPACITY + 1, 4))


def test_in_a_day_it_stays_bounded_even_and_complete():
    series = History()
    lengths = set()
    for second in range(86_400):
        look(series, second, float(second))
        lengths.add(len(series._samples))
    assert max(lengths) == CAPACITY == 256
    kept = revisions(series)
    assert {b - a for a, b in pairwise(kept)} == {512}
    assert kept[0] == 0
    assert 86_400 - kept[-1] <= 512


def test_a_look_that_took_long_is_followed_by_a_long_rest():
    assert REST == 50.0
    series = History()
    assert look(series, 1, 10.0, cost=0.1)
    assert not look(series, 2, 10.1 + 4.99)
    assert look(series, 2, 10.1 + 5.01)
    assert not look(series, 3, 16.0)
    assert look(series, 3, 16.2)


def test_a_look_at_a_map_without_a_known_cell_costs_and_keeps_nothing():
    series = History()
    assert look(series, 1, 10.0, cost=0.1, known=False)
    assert not look(series, 2, 15.0, known=False)
    assert look(series, 2, 16.0, known=False)
    assert revisions(series) == []
    assert look(series, 3, 17.0)
    assert revisions(series) == [3]


def test_a_new_epoch_is_a_new_series_at_once():
    series = History()
    for second in range(CAPACITY + 2):
        look(series, second, float(second), cost=0.001)
    look(series, 999, 999.0, cost=10.0)
    assert revisions(series, "other") == []
    assert look(series, 0, 999.1, epoch="other", known=False)
    assert revisions(series, "e") == revisions(series, "other") == []
    assert look(series, 1, 1000.2, epoch="other")
    assert look(series, 2, 1001.2, epoch="other")
    assert revisions(series, "other") == [1, 2]
    assert revisions(series, "e") == []


def test_a_map_that_was_reset_between_two_looks_at_its_revision_is_looked_at():
    series = History()
    assert look(series, 5, 10.0)
    assert look(series, 5, 10.1, epoch="other")
    assert (revisions(series), revisions(series, "other")) == ([], [5])


@pytest.mark.parametrize("bounds", [None, Region(-1.0, -1.0, 3.0, 1.0)])
def test_the_sample_of_a_map(bounds):
    grid = OccupancyGrid(GridSettings(resolution=0.5, bounds=bounds), "e")
    assert sample_of(grid.snapshot()) is None
    nothing, beam = (
        Scan(stamp, 0.0, 0.1, 0.0, 8.0, np.array([r], np.float32)) for stamp, r in ((7, math.nan), (5, 2.0))
    )
    grid.integrate(nothing, Pose(0.25, 0.25, 0.0))
    assert sample_of(grid.snapshot()) is None
    grid.integrate(beam, Pose(0.25, 0.25, 0.0))
    figures = map_figures(grid.snapshot())
    entropy = -(0.7 * math.log2(0.7) + 0.3 * math.log2(0.3))
    assert figures["mean_entropy_bits"] == pytest.approx(entropy, rel=1e-3)
    entropies = figures["mean_entropy_bits"], figures["entropy_bits"]
    assert sample_of(grid.snapshot(), 0.75) == (7, 2, *entropies, 1.0, 0.75)
