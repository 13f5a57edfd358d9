"""What settings of a map are refused, and in which words."""

import math

import pytest

from ogm_core.errors import BadSetting
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Region


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"alpha": -0.1}, "alpha: 0 m or more is needed, got -0.1"),
        ({"alpha": math.nan}, "alpha: 0 m or more is needed, got nan"),
        ({"alpha": math.inf}, "alpha: 0 m or more is needed, got inf"),
        ({"reach": 0.0}, "reach: more than 0 m is needed, got 0"),
        ({"reach": math.nan}, "reach: more than 0 m is needed, got nan"),
        ({"clear_range": -1.0}, "clear_range: 0 m or more is needed, got -1"),
        ({"clear_range": math.nan}, "clear_range: 0 m or more is needed, got nan"),
        (
            {"bounds": Region(0, 0, 10, 10), "max_cells": 39_999},
            "bounds: 200 x 200 cells are more than max_cells",
        ),
        ({"resolution": 0.0}, "resolution: 0.001 to 1e"),
    ],
)
def test_what_makes_no_map_is_refused(changes, says):
    with pytest.raises(BadSetting, match=f"^{says}"):
        GridSettings(**changes)


def test_the_edges_of_what_is_allowed():
    GridSettings(alpha=0.0, reach=5e-324, clear_range=0.0)
    assert GridSettings(reach=math.inf, clear_range=math.inf).bounds_rect is None
    assert GridSettings(bounds=Region(0, 0, 10, 10), max_cells=40_000).bounds_rect == CellRect(0, 0, 200, 200)


def test_an_unbounded_maps_lattice_has_its_anchor_and_a_bounded_ones_the_bounds():
    assert GridSettings(anchor=(1.5, -2.0)).lattice.anchor == (1.5, -2.0)
    bounded = GridSettings(anchor=(1.5, -2.0), bounds=Region(-3, -4, 0, 0))
    assert bounded.lattice.anchor == (-3, -4)
