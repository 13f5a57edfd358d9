"""The peer's rule, held against counting by hand, as the benchmark of maps' quality has it."""

import math
from collections import Counter

import numpy as np
import pytest

import naive
from benchmarks import map_quality
from benchmarks.karto_rule import karto_map
from ogm_core.grid_settings import GridSettings
from ogm_core.types import PlacedScan, Pose, Scan


def test_hits_and_passes_are_those_of_bresenhams_lines():
    settings, rng = GridSettings(resolution=0.5, clear_range=5.0), np.random.default_rng(2)
    placed = []
    for _ in range(20):
        ranges = rng.uniform(0.2, 9.0, 30).astype(np.float32)
        ranges[rng.integers(0, 30, 4)] = [math.nan, math.inf, 0.0, 12.0]
        scan = Scan(0, -3.0, 0.2, 0.0, 10.0, ranges)
        placed.append(PlacedScan(scan, Pose(*rng.uniform(-3, 3, 2), rng.uniform(-3, 3))))
    hits, passes = Counter(), Counter()
    for scan, pose, _ in placed:
        for start, end, hit, _ in naive.observed(scan, pose, settings):
            *passed, last = naive.bresenham(*start, *end)[1:] or [None]
            if last is not None:
                passes.update(passed)
                (hits if hit else passes)[last] += 1
    judged = karto_map(placed, settings)
    west, south = judged.snapshot.offset
    p, known = judged.snapshot.published()
    for (j, i), value in np.ndenumerate(p):
        cell = west + i, south + j
        assert known[j, i] == bool(hits[cell] + passes[cell])
        if known[j, i]:
            assert value == pytest.approx((hits[cell] + 1e-3) / (hits[cell] + passes[cell] + 2e-3))
    assert np.array_equal(judged.classes == 3, known & (p > 0.1))
    assert (judged.classes == 1).any()


def test_without_recorded_buildings_nothing_is_measured(monkeypatch, capsys):
    monkeypatch.delenv("OGM_DATASETS", raising=False)
    assert map_quality.run(quick=True) == []
    assert "left out: map_quality" in capsys.readouterr().out
