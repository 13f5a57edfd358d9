"""World <-> cell arithmetic."""

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ogm_core.errors import BadParameter, BadSetting
from ogm_core.lattice import MAX_INDEX, MIN_RESOLUTION, CellRect, Lattice, Region, bounded

NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("x", "resolution", "anchor", "ix"),
    [
        (0.0, 0.1, 0.0, 0),
        (-0.0, 0.1, 0.0, 0),
        (0.3, 0.1, 0.0, 2),  # 0.3 / 0.1 is just below 3: neither rounded up nor 0.3 * 10, which is 3
        (0.7, 0.1, 0.0, 6),
        (0.15, 0.05, 0.0, 2),
        (0.2, 0.1, 0.0, 2),
        (-1e-300, 0.1, 0.0, -1),
        (-0.1, 0.1, 0.0, -1),  # half open: a cell holds its lower edge
        (-0.10000001, 0.1, 0.0, -2),
        (-9.95, 0.1, -10.0, 0),
        (10.0, 0.1, -10.0, 200),
        (1.0, 0.25, 0.5, 2),
    ],
)
def test_a_cell_is_the_floor_of_an_exact_division(x, resolution, anchor, ix):
    assert Lattice(resolution, (anchor, 0.0)).cell_of(x, 0.0) == (ix, 0)
    assert Lattice(resolution, (0.0, anchor)).cell_of(0.0, x) == (0, ix)


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.floats(MIN_RESOLUTION, 100), st.floats(-1e3, 1e3))
def test_a_point_lies_in_its_cell(x, y, resolution, anchor):
    ix, iy = Lattice(resolution, (anchor, -anchor)).cell_of(x, y)
    for cell, quotient in ((ix, (x - anchor) / resolution), (iy, (y + anchor) / resolution)):
        assert cell <= Fraction(quotient) < cell + 1


def test_corners_are_anchor_plus_index_times_resolution():
    lattice = Lattice(0.25, (-3.0, 7.0))
    assert lattice.corner_of(0, 0) == (-3.0, 7.0)
    assert lattice.corner_of(-4, 6) == (-4.0, 8.5)
    assert lattice.cell_of(*lattice.corner_of(-4, 6)) == (-4, 6)


@pytest.mark.parametrize("resolution", [0.0, -0.05, MIN_RESOLUTION / 2, 2e6, NAN, INF])
def test_a_resolution_that_is_no_length_is_refused(resolution):
    with pytest.raises(BadSetting, match=r"^resolution: 0\.001 to 1e\+06 m is needed"):
        Lattice(resolution)


@pytest.mark.parametrize("value", [NAN, INF, -INF, 1e300, MAX_INDEX * 0.05, -MAX_INDEX * 0.05])
def test_a_point_without_a_cell_is_refused(value):
    for point in ((value, 0.0), (0.0, value)):
        with pytest.raises(BadParameter, match=r"^point "):
            Lattice(0.05).cell_of(*point)


@pytest.mark.parametrize(
    ("region", "rect"),
    [
        ((0.0, 0.0, 1.0, 0.5), (0, 0, 4, 2)),  # on the edges: nothing is added
        ((0.1, 0.1, 0.2, 0.2), (0, 0, 1, 1)),
        ((0.1, 0.1, 0.26, 0.2), (0, 0, 2, 1)),
        ((-0.01, -0.26, 0.01, 0.0), (-1, -2, 2, 2)),
        ((-1.0, -1.0, 1.0, 1.0), (-4, -4, 8, 8)),
        ((5.0, 5.0, 5.0 + 1e-9, 5.0 + 1e-9), (20, 20, 1, 1)),
    ],
)
def test_a_region_is_covered_outward(region, rect):
    assert Lattice(0.25).cover(Region(*region)) == CellRect(*rect)


@pytest.mark.parametrize(("resolution", "anchor"), [(0.05, 0.0), (0.1, -10.0), (0.03, -15.1), (1 / 3, 1e4)])
def test_a_region_on_the_edges_of_cells_covers_exactly_these(resolution, anchor):
    """However its edges were computed: rounding leaves them beside the cells' own by a few 1e-13 cells."""
    lattice = Lattice(resolution, (anchor, anchor))
    for k in range(-60, 60):
        west, east = anchor + k * resolution, anchor + (k + 1) * resolution
        assert lattice.cover(Region(west, west, east, east)) == CellRect(k, k, 1, 1)
        short = Region(*(round(edge, 8) for edge in (west, west, east, east)))
        assert lattice.cover(short) == CellRect(k, k, 1, 1)


def test_only_what_is_within_a_millionth_of_a_cell_is_taken_for_its_edge():
    lattice = Lattice(1.0)
    assert lattice.cover(Region(2 - 0.9e-6, 2 + 0.9e-6, 5 + 0.9e-6, 5 - 0.9e-6)) == CellRect(2, 2, 3, 3)
    assert lattice.cover(Region(2 - 1.1e-6, 2.0, 5 + 1.1e-6, 5.0)) == CellRect(1, 2, 5, 3)


def test_cover_counts_from_the_anchor():
    assert Lattice(0.5, (-10.25, 3.0)).cover(Region(-10.0, 3.0, -9.75, 4.1)) == CellRect(0, 0, 1, 3)


def test_a_region_of_no_width_in_floats_still_covers_a_cell():
    above = math.nextafter(0.9, INF)
    assert 0.9 / 0.1 == above / 0.1 == 9.0
    assert Lattice(0.1).cover(Region(0.9, 0.9, above, above)) == CellRect(9, 9, 1, 1)


def test_a_region_may_reach_beyond_every_cell():
    everything = CellRect(-MAX_INDEX, -MAX_INDEX, 2 * MAX_INDEX, 2 * MAX_INDEX)
    assert Lattice(0.05, (7.0, 7.0)).cover(Region(-1e300, -1e300, 1e300, 1e300)) == everything
    assert Lattice(0.5).cover(Region(1.0, 2.0, 1e308, 4.0)) == CellRect(2, 4, MAX_INDEX - 2, 4)


@pytest.mark.parametrize(
    ("region", "text"),
    [
        ((1.0, 0.0, 0.0, 1.0), "xmin < xmax"),
        ((0.0, 1.0, 1.0, 1.0), "ymin < ymax"),
        ((NAN, 0.0, 1.0, 1.0), "finite"),
        ((0.0, 0.0, INF, 1.0), "finite"),
    ],
)
def test_a_region_that_is_none_is_refused(region, text):
    with pytest.raises(BadParameter, match=text):
        Lattice(0.05).cover(Region(*region))


@pytest.mark.parametrize(
    ("resolution", "bounds", "size"),
    [
        (0.1, (-10.0, -10.0, 10.0, 10.0), (200, 200)),
        (0.1, (0.0, 0.0, 0.3, 0.7), (3, 7)),  # 0.3 / 0.1 is 2.9999999999999996: a whole number within 1e-6
        (0.05, (-1.05, 2.0, 1.0, 2.05), (41, 1)),
        (1.0, (0.0, 0.0, 3.0 + 0.9e-6, 3.0 - 0.9e-6), (3, 3)),
    ],
)
def test_bounds_span_a_whole_number_of_cells(resolution, bounds, size):
    lattice, rect = bounded(resolution, Region(*bounds))
    assert lattice == Lattice(resolution, (bounds[0], bounds[1]))
    assert rect == CellRect(0, 0, *size)


@pytest.mark.parametrize(
    ("resolution", "bounds", "text"),
    [
        (1.0, (0.0, 0.0, 3.0 + 1.1e-6, 3.0), "cells of 1 m in x"),
        (1.0, (0.0, 0.0, 3.0, 3.0 - 1.1e-6), "cells of 1 m in y"),
        (0.3, (0.0, 0.0, 1.0, 1.0), "3.33333333 cells of 0.3 m in x; a whole number"),
        (1.0, (0.0, 0.0, 1e-7, 1.0), "in x; a whole number"),
        (0.05, (-1e308, 0.0, 1e308, 1.0), "in x; a whole number"),
        (0.05, (1.0, 0.0, -1.0, 1.0), "XMIN < XMAX"),
        (0.05, (0.0, 1.0, 1.0, 1.0), "YMIN < YMAX"),
        (0.05, (NAN, 0.0, 1.0, 1.0), "finite"),
        (0.05, (0.0, 0.0, 1.0, INF), "finite"),
        (NAN, (0.0, 0.0, 1.0, 1.0), "^resolution"),
    ],
)
def test_other_bounds_are_refused(resolution, bounds, text):
    with pytest.raises(BadSetting, match=text):
        bounded(resolution, Region(*bounds))


def test_rectangles_unite_intersect_and_contain():
    a, b = CellRect(-2, 0, 4, 3), CellRect(1, 2, 5, 5)
    assert a.cells == 12
    assert a.union(b) == b.union(a) == CellRect(-2, 0, 8, 7)
    assert a.intersection(b) == b.intersection(a) == CellRect(1, 2, 1, 1)
    assert a.meets(b)
    assert b.meets(a)
    assert a.union(b).contains(a)
    assert not a.contains(b)
    assert a.contains(a)


@pytest.mark.parametrize("other", [CellRect(2, 0, 3, 3), CellRect(-2, 3, 4, 1), CellRect(9, 9, 1, 1)])
def test_rectangles_that_only_touch_share_no_cell(other):
    assert CellRect(-2, 0, 4, 3).intersection(other).cells == 0
    assert not CellRect(-2, 0, 4, 3).meets(other)


@pytest.mark.parametrize(
    ("x", "cell", "place"),
    [(-3.3, 0, 0.0), (-3.0, 0, 0.6), (-2.81, 0, 0.98), (-2.8, 1, 0.0), (-3.9, -2, 0.8)],
)
def test_the_place_within_a_cell_is_from_its_corner(x, cell, place):
    (ix, iy), (fu, fv) = Lattice(0.5, (-3.3, -3.3)).place_of(x, x)
    assert (ix, iy) == (cell, cell)
    assert (fu, fv) == pytest.approx((place, place), abs=1e-12)
    assert 0.0 <= fu < 1.0
