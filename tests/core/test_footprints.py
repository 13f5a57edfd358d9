"""Footprints on a map: exact geometry says which cells they meet; closed forms, limits and mistakes."""

import math
import tracemalloc
from fractions import Fraction

import numpy as np
import pytest

import naive
from ogm_core.cells.classes import FREE, OCCUPIED, UNKNOWN
from ogm_core.errors import BadParameter
from ogm_core.lattice import CellRect, Lattice
from ogm_core.queries import footprints as module
from ogm_core.queries.footprints import SLACK, Footprints

CELLS = Lattice(1.0)
SIDE = 9


def met_by(footprint, margin=0.0, lattice=CELLS):
    """The cells (ix, iy) that it meets, found one by one: of each alone it is told that it is occupied."""
    asked = Footprints([footprint], margin, lattice)
    rect, found = asked.rect, set()
    for ix in range(rect.ix - 1, rect.ix + rect.width + 1):
        column = CellRect(ix, rect.iy - 1, 1, rect.height + 2)
        if asked.states(np.full((column.height, 1), OCCUPIED, np.int8), column)[0] == OCCUPIED:
            for iy in range(column.iy, column.iy + column.height):
                if asked.states(np.full((1, 1), OCCUPIED, np.int8), CellRect(ix, iy, 1, 1))[0] == OCCUPIED:
                    found.add((ix, iy))
    return found


def corners_of(rng, number, grain):
    """Corners in 2 to 7, on multiples of the grain: on edges and corners of cells, in line, on each other."""
    corners = rng.integers(0, int(5 / grain) + 1, (number, 2)) * grain + 2.0
    return [tuple(corner) for corner in corners.tolist()]


@pytest.mark.parametrize("grain", [1.0, 0.5, 1 / 64])
@pytest.mark.parametrize("number", [1, 3, 4, 7])
def test_a_footprint_meets_what_exact_geometry_says(grain, number):
    rng = np.random.default_rng(int(64 * grain) * 100 + number)
    near, met, not_met = 0, 0, 0
    for margin in (0.0, 0.5, 1.0, math.sqrt(2.0), 2.3):
        for _ in range(2 if number < 7 else 1):
            corners = corners_of(rng, number, grain)
            found = met_by(corners, margin)
            for cell in np.ndindex(SIDE, SIDE):
                squared = naive.footprint_distance_squared(corners, cell)
                if squared <= Fraction(margin) ** 2:
                    assert cell in found, (corners, margin, cell)
                    met += 1
                elif squared > Fraction(margin + 2 * SLACK) ** 2:
                    assert cell not in found, (corners, margin, cell)
                    not_met += 1
                else:
                    near += 1
    assert met > 10
    assert not_met > 100
    assert near < 100


def test_a_footprint_anywhere_on_any_lattice():
    lattice = Lattice(0.05, (0.013, -7.77))
    for ix, iy in ((0, 0), (-3_000_000, 2_000_000), (123_456_789, -987_654_321)):
        x, y = lattice.corner_of(ix, iy)
        corners = [(x + 0.11, y + 0.11), (x + 0.34, y + 0.11), (x + 0.34, y + 0.24), (x + 0.11, y + 0.24)]
        found = met_by(corners, 0.0, lattice)
        assert found == {(ix + i, iy + j) for i in range(2, 7) for j in range(2, 5)}


@pytest.mark.parametrize(
    ("point", "margin", "met"),
    [
        ((5.5, 5.5), 0.0, {(5, 5)}),
        ((5.0, 5.5), 0.0, {(4, 5), (5, 5)}),  # on an edge it meets both sides
        ((5.0, 5.0), 0.0, {(4, 4), (4, 5), (5, 4), (5, 5)}),
        ((5.0 + 2 * SLACK, 5.5), 0.0, {(5, 5)}),
        ((5.5, 5.5), 0.5, {(5, 5), (4, 5), (6, 5), (5, 4), (5, 6)}),  # it touches them
        ((5.5, 5.5), 0.499, {(5, 5)}),
        ((5.5, 5.5), math.sqrt(0.5), {(i, j) for i in (4, 5, 6) for j in (4, 5, 6)}),
        ((5.5, 5.5), 0.7, {(5, 5), (4, 5), (6, 5), (5, 4), (5, 6)}),
    ],
)
def test_a_point(point, margin, met):
    assert met_by([point], margin) == met


def test_a_polygon_that_crosses_itself_is_even_odd():
    star = [
        (6 + 5 * math.sin(math.tau * 2 * k / 5), 6 + 5 * math.cos(math.tau * 2 * k / 5)) for k in range(5)
    ]
    found = met_by(star)
    assert (6, 6) not in found  # what it goes around twice is outside
    assert (6, 8) in found
    bow_tie = met_by([(1.5, 1.5), (9.5, 9.5), (9.5, 1.5), (1.5, 9.5)])
    assert {(2, 5), (8, 5)} <= bow_tie
    assert (5, 2) not in bow_tie


def test_a_large_polygon_holds_what_no_edge_comes_near():
    assert len(met_by([(1.5, 1.5), (10.5, 1.5), (10.5, 10.5), (1.5, 10.5)])) == 100
    asked = Footprints([[(-1e3, -1e3), (1e3, -1e3), (1e3, 1e3), (-1e3, 1e3)]], 0.0, CELLS)
    cells = np.zeros((2100, 2100), np.int8)
    cells[1050, 1050] = OCCUPIED
    assert asked.states(cells, CellRect(-1050, -1050, 2100, 2100)).tolist() == [OCCUPIED]
    cells[1050, 1050] = FREE
    assert asked.states(cells, CellRect(-1050, -1050, 2100, 2100)).tolist() == [FREE]


def test_occupied_comes_before_unknown_and_unknown_before_free():
    cells = np.zeros((3, 3), np.int8)
    cells[0, 0], cells[2, 2] = OCCUPIED, UNKNOWN
    points = [[(0.5, 0.5)], [(2.5, 2.5)], [(1.5, 1.5)], [(9.0, 9.0)], [(2.5, 0.5)], [(-0.5, 0.5)]]
    rect = CellRect(0, 0, 3, 3)
    assert Footprints(points, 0.0, CELLS).states(cells, rect).tolist() == [
        *(OCCUPIED, UNKNOWN, FREE, UNKNOWN, FREE, UNKNOWN)
    ]
    # Beyond the cells is unknown, too: (2.5, 0.5) touches it.
    assert Footprints(points, 0.5, CELLS).states(cells, rect).tolist() == [
        *(OCCUPIED, UNKNOWN, FREE, UNKNOWN, UNKNOWN, OCCUPIED)
    ]
    assert Footprints([[(1.5, 1.5)]], 1.0, CELLS).states(cells, rect).tolist() == [OCCUPIED]
    assert Footprints([[(1.5, 1.5)]], 1.0, CELLS).states(cells[:0], CellRect(0, 0, 0, 0)).tolist() == [
        UNKNOWN
    ]


def test_many_at_once_are_as_each_alone():
    rng = np.random.default_rng(5)
    cells = rng.choice([FREE, OCCUPIED, UNKNOWN], (40, 50), p=[0.96, 0.02, 0.02]).astype(np.int8)
    rect = CellRect(-3, 7, 50, 40)
    shapes = []
    for _ in range(300):
        corners = rng.uniform((-5, 5), (49, 49)) + rng.uniform(-2, 2, (rng.choice([1, 3, 4, 5]), 2))
        shapes.append([tuple(corner) for corner in corners.tolist()])
    together = Footprints(shapes, 0.4, CELLS).states(cells, rect).tolist()
    assert together == [Footprints([shape], 0.4, CELLS).states(cells, rect)[0] for shape in shapes]
    assert {OCCUPIED, UNKNOWN, FREE} == set(together)


@pytest.mark.parametrize(
    ("footprints", "margin", "message"),
    [
        ([], 0.0, "points, footprints: 1 to 4096 are needed, got 0"),
        ([[(0.0, 0.0)]] * 4097, 0.0, "points, footprints: 1 to 4096 are needed, got 4097"),
        ([[(0.0, 0.0)], [(0.0, 0.0), (1.0, 1.0)]], 0.0, "number 1: 3 to 64 corners are needed, got 2"),
        ([[]], 0.0, "number 0: 3 to 64 corners are needed, got 0"),
        ([[(0.0, 0.0)] * 65], 0.0, "number 0: 3 to 64 corners are needed, got 65"),
        ([[(0.0, math.nan)]], 0.0, "finite numbers are needed, of places that have cells"),
        ([[(1e300, 0.0)]], 0.0, "finite numbers are needed"),
        ([[(0.0, 0.0)]], -0.1, "margin: 0 to 100 m is needed, got -0.1"),
        ([[(0.0, 0.0)]], math.nan, "margin: 0 to 100 m is needed, got nan"),
        ([[(0.0, 0.0)]], 100.5, "margin: 0 to 100 m is needed, got 100.5"),
        ([[(0.0, 0.0), (1e4, 0.0), (1e4, 1e4)]], 0.0, r"they meet \d+ cells or more, at most 10000000 are"),
        (
            [[(0.0, 0.0), (1.0, 0.0), (1.0, 1e9)]],
            0.0,
            r"their edges reach over 2\d+ rows of cells, at most 100000 are looked at: ask about fewer, or",
        ),
        ([[(0.0, 0.0), (1e15, 0.0), (1e15, 1.0)]], 0.0, r"they meet \d+ cells or more"),
        ([[(0.0, 0.0)]] * 400, 100.0, r"they meet \d+ cells or more"),
        ([[(0.0, 0.0)]] * 2000, 100.0, r"their edges reach over 40\d+ rows of cells"),
    ],
)
def test_what_cannot_be_asked_is_named(footprints, margin, message):
    with pytest.raises(BadParameter, match=message):
        Footprints(footprints, margin, CELLS)


def test_places_without_end_in_cells_are_refused():
    with pytest.raises(BadParameter, match="finite numbers are needed"):
        Footprints([[(0.0, -1.7e308)]], 0.0, Lattice(0.05))


def test_no_question_takes_much_memory():
    tall = [(0.0, 0.0), (3.0, 0.0), (40.0, 30_000.0), (20.0, 30_000.0)]
    wide = [(0.0, 0.0), (30_000.0, 3.0), (30_000.0, 40.0), (0.0, 20.0)]
    cells = np.zeros((100, 100), np.int8)
    for asked, margin in (([tall], 3.0), ([wide] * 8, 0.0), ([[(0.5, 0.5)]] * 4096, 9.0)):
        tracemalloc.start()
        try:
            Footprints(asked, margin, CELLS).states(cells, CellRect(0, 0, 100, 100))
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert peak < 24 * 2**20, (margin, peak)


def test_the_rectangle_holds_what_is_met():
    rng = np.random.default_rng(9)
    for margin in (0.0, 1.7):
        for _ in range(20):
            corners = corners_of(rng, 4, 0.5)
            rect = Footprints([corners], margin, CELLS).rect
            assert all(rect.contains(CellRect(*cell, 1, 1)) for cell in met_by(corners, margin))


def test_far_apart_ones_keep_their_decimals():
    asked = Footprints([[(0.25, 0.25)], [(2.0**49, 2.0**49 + 3.0)]], 0.0, CELLS)
    cells = np.zeros((1, 1), np.int8)
    assert asked.states(cells, CellRect(0, 0, 1, 1)).tolist() == [FREE, UNKNOWN]
    assert module.MAX_MET == 10_000_000
