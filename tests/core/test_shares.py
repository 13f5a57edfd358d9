"""Shares: where a map is cut, which cells each owns, and whose a scan is to count."""

import math

import numpy as np
import pytest

from gathering import tiles_of_grid
from ogm_core.cells.rate import Rate
from ogm_core.errors import BadSetting, LimitReached
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Clip, Lattice, Region
from ogm_core.shares import Cuts, Ground, Share
from ogm_core.types import PlacedScan, Pose, Scan, Sweep

TENTH = Lattice(0.1)
FOUR = Cuts((0.0,), (6.4,))


def test_shares_are_counted_from_the_south_west_along_x_first():
    cuts = Cuts((-6.4, 12.8), (0.0,))
    assert cuts.count == 6
    assert [Share(cuts, k).bounds for k in range(6)] == [
        (None, None, -6.4, 0.0),
        (-6.4, None, 12.8, 0.0),
        (12.8, None, None, 0.0),
        (None, 0.0, -6.4, None),
        (-6.4, 0.0, 12.8, None),
        (12.8, 0.0, None, None),
    ]
    assert Share(cuts, 4).clip(TENTH) == Clip(-64, 0, 128, None)
    assert Share(Cuts(), 0).clip(TENTH) == Clip()


def test_cuts_count_from_the_anchor_of_the_lattice():
    assert Share(Cuts((7.4,)), 1).clip(Lattice(0.1, (1.0, 0.0))) == Clip(xmin=64)
    with pytest.raises(BadSetting, match=r"^shares.cuts_x: 6.4 m is no edge .* nearest are 1 and 7.4$"):
        Share(Cuts((6.4,)), 1).clip(Lattice(0.1, (1.0, 0.0)))


@pytest.mark.parametrize("cuts", [(1.0, 0.0), (2.0, 2.0)])
def test_cuts_have_to_rise(cuts):
    with pytest.raises(BadSetting, match=r"^shares.cuts_y: \d comes after \d"):
        Cuts((), cuts)


def test_cuts_and_shares_that_cannot_be_are_refused():
    with pytest.raises(BadSetting, match=r"^shares.index: 4: .* shares 0 to 3$"):
        Share(FOUR, 4)
    with pytest.raises(BadSetting, match=r"^shares: these cuts make 1025 shares"):
        Cuts(tuple(float(x) for x in range(1024)))
    with pytest.raises(BadSetting, match=r"^shares.cuts_y: 1.7 m is no edge .* nearest are 0 and 6.4$"):
        Cuts((), (1.7,)).check(TENTH)
    with pytest.raises(BadSetting, match=r"^shares.cuts_x: 12.8 m lies outside map.bounds, x 0 to 12.8"):
        Cuts((12.8,)).check(TENTH, Region(0.0, 0.0, 12.8, 6.4))
    with pytest.raises(BadSetting, match=r"^shares.cuts_x: 1e\+300 m is farther away"):
        Cuts((1e300,)).check(TENTH)


def scan_at(x, y, *, reach=None, ranges=(2.0,), sweep=None, stamp=0):
    scan = Scan(stamp, 0.0, math.tau / len(ranges), 0.0, 8.0, np.array(ranges, np.float32), reach=reach)
    return PlacedScan(scan, Pose(x, y, 0.3), sweep)


def ground(index, reach=3.0):
    return Ground(Share(FOUR, index).clip(TENTH), TENTH, reach)


def test_a_scan_is_at_home_where_its_sensor_stands_and_may_reach_others():
    whose = [ground(k).whose(scan_at(-1.0, 2.0)) for k in range(4)]
    assert whose == ["home", "border", "elsewhere", "elsewhere"]
    assert [ground(k).whose(scan_at(0.0, 6.4)) for k in range(4)] == ["border", "border", "border", "home"]
    edge = np.nextafter(0.0, -1.0)
    assert [ground(k).whose(scan_at(edge, 0.0)) for k in range(4)] == ["home", "border"] + ["elsewhere"] * 2


def test_the_reach_of_a_sensor_takes_the_place_of_the_maps():
    assert ground(1).whose(scan_at(-4.0, 0.0, reach=5.0)) == "border"
    assert ground(1).whose(scan_at(-4.0, 0.0)) == "elsewhere"
    assert ground(1).whose(scan_at(-1.0, 0.0, reach=0.5)) == "elsewhere"


def test_while_it_swept_the_sensor_may_have_come_into_reach():
    beams = np.array([[-5.0, 0.0, 0.0], [-2.5, 0.0, 0.0]])
    swept = scan_at(-5.0, 0.0, ranges=(2.0, 2.0), sweep=Sweep(Pose(-4.0, 0.0, 0.0), beams))
    assert ground(1).whose(swept) == "border"
    assert ground(0).whose(swept) == "home"


@pytest.mark.parametrize(("x", "whose"), [(3.2, "border"), (3.3, "elsewhere"), (1e300, "elsewhere")])
def test_the_last_cells_that_a_scan_may_write_count(x, whose):
    """30 cells of its reach, and two more for rounding."""
    assert ground(1).whose(scan_at(-x, 0.0)) == whose
    west = Ground(Clip(xmax=0), TENTH, 3.0)
    assert west.whose(scan_at(np.nextafter(x, 0.0), 0.0)) == whose


@pytest.mark.parametrize("sensor_model", ["beam", "sector"])
def test_every_scan_has_one_home_and_changes_no_cell_where_it_is_elsewhere(sensor_model):
    """Random scans: what `elsewhere` says must never be wrong, nor a scan count twice."""
    rng = np.random.default_rng(5)
    settings = [
        GridSettings(resolution=0.1, reach=3.0, sensor_model=sensor_model, share=Share(FOUR, k))
        for k in range(4)
    ]
    grids = [OccupancyGrid(each) for each in settings]
    seen = set()
    for _ in range(300):
        x, y = rng.uniform((-8.0, -2.0), (8.0, 14.0))
        placed = scan_at(x, y, ranges=rng.uniform(0.1, 9.0, 24))
        whose = [ground(k).whose(placed) for k in range(4)]
        assert whose.count("home") == 1
        for k, grid in enumerate(grids):
            updates = grid.integrate(placed.scan, placed.pose)
            assert not (updates and whose[k] == "elsewhere")
            seen.add((whose[k], updates > 0))
    assert ("border", True) in seen
    assert ("elsewhere", False) in seen


def taken(grid, placed):
    """Whether a map takes a scan."""
    try:
        grid.integrate(placed.scan, placed.pose)
    except LimitReached:
        return False
    return True


@pytest.mark.parametrize(
    "made_of",
    [{}, {"sensor_model": "sector"}, {"traversal": "dda"}, {"cell_model": Rate()}, {"half_life": 5.0}],
)
def test_who_does_not_look_at_scans_from_elsewhere_takes_and_refuses_the_same(monkeypatch, made_of):
    """`max_cells` refuses the same scans at all shares, though some do not look at some of the scans."""
    elsewhere, skipped = OccupancyGrid._is_elsewhere, []

    def noted(grid, placed):
        skipped.append(elsewhere(grid, placed))
        return skipped[-1]

    monkeypatch.setattr(OccupancyGrid, "_is_elsewhere", noted)
    common = {"resolution": 0.1, "reach": 3.0, "max_cells": 24_000, **made_of}
    whole = OccupancyGrid(GridSettings(**common))
    grids = [OccupancyGrid(GridSettings(**common, share=Share(FOUR, k))) for k in range(4)]
    rng, refused = np.random.default_rng(6), 0
    for n in range(400):
        x, y = rng.uniform((-8.0, -2.0), (8.0, 14.0))
        placed = scan_at(x, y, stamp=n * 100_000_000, ranges=rng.uniform(0.1, 2.9, 24))
        was_taken = taken(whole, placed)
        assert [taken(grid, placed) for grid in grids] == [was_taken] * 4
        refused += not was_taken
        assert {grid._extent.stretched for grid in grids} == {whole._extent.stretched}
    assert {grid.revision for grid in grids} == {whole.revision}
    assert 40 < refused < 360
    assert sum(skipped) > 60
    together = {}
    for grid in grids:
        together |= tiles_of_grid(grid)
    assert together == tiles_of_grid(whole)
