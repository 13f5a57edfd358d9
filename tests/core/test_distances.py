"""Distances to occupied cells and inflation: the slow twin, windows, radii, SciPy missing."""

import math
import sys
import tracemalloc

import numpy as np
import pytest

from ogm_core.cells.classes import FREE, OCCUPIED, UNKNOWN
from ogm_core.errors import BadParameter, MissingExtra
from ogm_core.lattice import CellRect
from ogm_core.queries.distances import BYTES_A_CELL, around, distances, inflated


def random_states(rng, shape=(17, 23), occupied=0.03):
    return rng.choice([OCCUPIED, FREE, UNKNOWN], shape, p=[occupied, 0.6, 0.4 - occupied]).astype(np.int8)


def whole(states):
    return CellRect(0, 0, states.shape[1], states.shape[0])


def naive_squared(states):
    """Squared distance of each cell to every occupied one, in cells; the least."""
    there = np.argwhere(states == OCCUPIED)
    squared = np.full(states.shape, np.inf)
    for row, column in np.ndindex(states.shape):
        squared[row, column] = min(((row - y) ** 2 + (column - x) ** 2 for y, x in there), default=math.inf)
    return squared


@pytest.mark.parametrize("resolution", [1.0, 0.05])
def test_distances_are_those_to_the_nearest_of_all(resolution):
    rng = np.random.default_rng(1)
    for occupied in (0.0, 0.005, 0.05, 0.4):
        states = random_states(rng, occupied=occupied)
        squared = naive_squared(states)
        found = distances(states, whole(states), resolution)
        assert found.dtype == np.float32
        assert np.array_equal(found, (np.sqrt(squared) * resolution).astype(np.float32))
        assert np.array_equal(found == 0.0, states == OCCUPIED)
        short = distances(states, whole(states), resolution, 3.2 * resolution)
        assert np.array_equal(short, np.minimum(found, np.float32(3.2 * resolution)))
        for radius in (0.0, 1.0, 2.3, 5.0, 100.0 / resolution):
            grown = inflated(states, whole(states), resolution, radius * resolution)
            assert grown.dtype == np.int8
            assert np.array_equal(grown, np.where(squared <= radius**2, OCCUPIED, states))


def test_one_that_is_alone():
    states = np.full((5, 9), UNKNOWN, np.int8)
    states[1, 2] = OCCUPIED
    assert distances(states, whole(states), 0.5)[4, 6] == 2.5
    assert distances(states, whole(states), 0.5)[1].tolist() == [1.0, 0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0]
    assert (inflated(states, whole(states), 0.5, 0.5) == OCCUPIED).sum() == 5
    assert (inflated(states, whole(states), 0.5, 0.75) == OCCUPIED).sum() == 9


def test_without_an_occupied_cell_distances_have_no_end():
    states = np.full((3, 4), FREE, np.int8)
    assert np.isposinf(distances(states, whole(states), 0.1)).all()
    assert (distances(states, whole(states), 0.1, 2.0) == 2.0).all()
    assert np.array_equal(inflated(states, whole(states), 0.1, 1.0), states)
    none = np.empty((0, 0), np.int8)
    assert distances(none, whole(none), 0.1).shape == inflated(none, whole(none), 0.1, 1.0).shape == (0, 0)


@pytest.mark.parametrize(("radius", "cells"), [(0.15, 3), (0.3, 6), (0.35, 7), (0.6, 12), (1.15, 23)])
def test_a_radius_of_whole_cells_holds_the_last_of_them(radius, cells):
    """0.15 / 0.05 is 2.9999999999999996."""
    states = np.zeros((1, 60), np.int8)
    states[0, 0] = OCCUPIED
    assert (inflated(states, whole(states), 0.05, radius)[0] == OCCUPIED).sum() == cells + 1


@pytest.mark.parametrize("reach", [0.4, 1.0, 3.7, 12.0, math.inf])
def test_a_part_with_what_is_around_it_is_cut_from_the_whole(reach):
    rng = np.random.default_rng(2)
    states = random_states(rng, (40, 50), 0.01)
    everything = CellRect(7, -9, 50, 40)
    all_metres = distances(states, whole(states), 0.1, reach * 0.1)
    all_grown = inflated(states, whole(states), 0.1, min(reach * 0.1, 100.0))
    for _ in range(20):
        west, south = rng.integers(0, 49), rng.integers(0, 39)
        part = CellRect(7 + west, -9 + south, rng.integers(1, 51 - west), rng.integers(1, 41 - south))
        window = around(part, reach, everything)
        assert everything.contains(window)
        assert window.contains(part)
        cut = states[
            window.iy + 9 : window.iy + 9 + window.height, window.ix - 7 : window.ix - 7 + window.width
        ]
        here = CellRect(part.ix - window.ix, part.iy - window.iy, part.width, part.height)
        rows, columns = slice(south, south + part.height), slice(west, west + part.width)
        assert np.array_equal(distances(cut, here, 0.1, reach * 0.1), all_metres[rows, columns])
        assert np.array_equal(inflated(cut, here, 0.1, min(reach * 0.1, 100.0)), all_grown[rows, columns])


def test_states_stay_as_they_are():
    states = random_states(np.random.default_rng(3))
    before = states.copy()
    inflated(states, whole(states), 1.0, 3.0)
    assert np.array_equal(states, before)


def test_what_it_takes_is_what_is_held_for_it():
    states = random_states(np.random.default_rng(4), (1500, 2000), 0.001)
    distances(states[:9, :9], CellRect(0, 0, 9, 9), 1.0)  # SciPy is loaded
    tracemalloc.start()
    try:
        metres = distances(states, whole(states), 0.05)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak <= BYTES_A_CELL * states.size + metres.nbytes + 8 * 2**20


@pytest.mark.parametrize("radius", [-0.1, 100.1, math.nan, math.inf])
def test_a_radius_out_of_its_range(radius):
    with pytest.raises(BadParameter, match="radius: 0 to 100 m is needed, got"):
        inflated(np.zeros((2, 2), np.int8), CellRect(0, 0, 2, 2), 1.0, radius)


@pytest.mark.parametrize("longest", [0.0, -1.0, 0.0009, 1e-50, math.nan])
def test_a_longest_distance_that_is_none(longest):
    with pytest.raises(BadParameter, match=r"max_distance: 0\.001 m or more is needed, got"):
        distances(np.zeros((2, 2), np.int8), CellRect(0, 0, 2, 2), 1.0, longest)


def test_who_has_no_scipy_is_told_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "scipy.ndimage", None)
    states = np.array([[OCCUPIED, FREE]], np.int8)
    for compute in (distances, inflated):
        with pytest.raises(MissingExtra, match="SciPy, which is not installed: pip install scipy"):
            compute(states, whole(states), 1.0, 1.0)
