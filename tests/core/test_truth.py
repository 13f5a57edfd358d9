"""Truly occupied cells against exact geometry cell by cell, and the figures against hand and twin."""

import math
import tracemalloc

import numpy as np
import pytest

import naive_truth
from ogm_core.cells import model as model_module
from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.log_odds import LogOdds
from ogm_core.lattice import CellRect, Lattice
from ogm_core.quality.truth import occupied_cells, truth_figures
from ogm_core.queries import cell_runs
from ogm_core.simulation.trajectories import CirclePath
from ogm_core.simulation.worlds import World, lab
from ogm_core.snapshot import MapSnapshot

UNIT = Lattice(1.0)
BOTH = pytest.mark.parametrize("cells", ["int16", "float64"])
FIGURES = ("accuracy", "precision", "recall", "iou", "log_loss")


def world_of(circles=(), walls=()):
    return World(
        "w",
        np.array(circles, float).reshape(-1, 3),
        np.array(walls, float).reshape(-1, 4),
        CirclePath(0.0, 0.0, 1.0, 4),
    )


AROUND = CellRect(-9, -9, 20, 20)


def met(world, rect=AROUND, lattice=UNIT):
    """The truly occupied cells as a set of (ix, iy)."""
    occupied = occupied_cells(world, lattice, rect)
    assert (occupied.dtype, occupied.shape) == (np.bool_, (rect.height, rect.width))
    return {(rect.ix + int(ix), rect.iy + int(iy)) for iy, ix in np.argwhere(occupied)}


def naively_met(world, rect, lattice, slack=1e-9):
    return {
        (ix, iy)
        for ix in range(rect.ix, rect.ix + rect.width)
        for iy in range(rect.iy, rect.iy + rect.height)
        if naive_truth.is_occupied(world, lattice, (ix, iy), slack)
    }


def block(ix, iy, width, height):
    return {(i, j) for i in range(ix, ix + width) for j in range(iy, iy + height)}


@pytest.mark.parametrize(
    ("wall", "cells"),
    [
        pytest.param((0.5, 0.5, 3.5, 0.5), block(0, 0, 4, 1), id="inside a row"),
        pytest.param((0.5, 1.0, 2.5, 1.0), block(0, 0, 3, 2), id="on the edge of two rows"),
        pytest.param((2.0, 3.5, 2.0, 0.5), block(1, 0, 2, 4), id="on the edge of two columns"),
        pytest.param((1.0, 1.0, 3.0, 1.0), block(0, 0, 4, 2), id="its ends are corners"),
        pytest.param((0.5, 0.5, 2.5, 2.5), block(0, 0, 2, 2) | block(1, 1, 2, 2), id="through corners"),
        pytest.param((2.0, 1.0, 1.5, 1.5), block(1, 0, 2, 2), id="it ends in a corner"),
        pytest.param((0.25, 0.25, 0.75, 0.5), {(0, 0)}, id="within a cell"),
        pytest.param((0.5, 0.9, 1.5, 0.6), block(0, 0, 2, 1), id="across one edge"),
        pytest.param((-8.5, 0.5, -1e6, 0.5), {(-9, 0)}, id="out of the rectangle"),
        pytest.param((-1e6, 5.5, 1e6, 5.5), block(-9, 5, 20, 1), id="across the rectangle"),
        pytest.param((-9.0, -20.0, -9.0, 20.0), block(-9, -9, 1, 20), id="on the rectangle's edge"),
        pytest.param((-9.1, -20.0, -9.1, 20.0), set(), id="beside it"),
        pytest.param((-30.0, 0.0, 0.0, 30.0), set(), id="past its corner"),
    ],
)
def test_cells_that_a_wall_meets(wall, cells):
    assert met(world_of(walls=[wall])) == cells
    assert met(world_of(walls=[(*wall[2:], *wall[:2])])) == cells


@pytest.mark.parametrize(
    ("circle", "cells"),
    [
        pytest.param((0.5, 0.5, 0.2), {(0, 0)}, id="smaller than a cell"),
        pytest.param((1.0, 1.0, 0.2), block(0, 0, 2, 2), id="around a corner"),
        pytest.param((0.5, 0.5, 0.5), block(0, 0, 1, 1) | {(1, 0), (-1, 0), (0, 1), (0, -1)}, id="tangent"),
        pytest.param((0.5, 0.5, 0.75), block(-1, -1, 3, 3) - {(0, 0)}, id="around a cell"),
        pytest.param((0.5, 0.5, 0.6), block(-1, -1, 3, 3) - {(-1, -1), (1, 1), (-1, 1), (1, -1)}, id="cut"),
        pytest.param(
            (0.5, 0.5, 1.5), block(-1, -1, 3, 3) - {(0, 0)} | {(2, 0), (-2, 0), (0, 2), (0, -2)}, id="ring"
        ),
        pytest.param((0.5, 0.5, math.sqrt(0.5)), block(-1, -1, 3, 3), id="through a cell's corners"),
        pytest.param((1.0, 1.0, 40.0), set(), id="around the rectangle"),
        pytest.param((-11.0, 0.5, 2.0), {(-9, 0)}, id="touching the rectangle"),
        pytest.param((-11.0, 0.5, 1.9), set(), id="beside it"),
    ],
)
def test_cells_that_a_circle_meets(circle, cells):
    assert met(world_of(circles=[circle])) == cells


NEAR_THE_CORNER = {(1, 0), (0, 1)}


@pytest.mark.parametrize("missed_by", [0.9e-9, 1.1e-9, -0.9e-9, -1.1e-9])
def test_slack_of_a_wall_beside_an_edge_or_a_corner(missed_by):
    """The edge y = 1, the edge x = 1, and the corner (1, 1), which is two slacks away from a diagonal."""
    within = abs(missed_by) < 1e-9
    above = missed_by > 0.0
    walls = [(0.5, 1.0 + missed_by, 1.5, 1.0 + missed_by), (1.0 + missed_by, 0.5, 1.0 + missed_by, 1.5)]
    beside = met(world_of(walls=walls[:1])), met(world_of(walls=walls[1:]))
    assert beside[0] == (block(0, 0, 2, 2) if within else block(0, int(above), 2, 1))
    assert beside[1] == (block(0, 0, 2, 2) if within else block(int(above), 0, 1, 2))
    passing = met(world_of(walls=[(0.5, 0.5 + 2 * missed_by, 1.5, 1.5 + 2 * missed_by)]))
    assert passing - NEAR_THE_CORNER == {(0, 0), (1, 1)}
    assert ((1, 0) in passing, (0, 1) in passing) == (within or not above, within or above)


@pytest.mark.parametrize(
    "circle",
    [
        (0.5, 0.5, 0.5 - 0.9e-9),
        (0.5, 0.5, 0.5 - 1.1e-9),
        (0.5, 0.5, math.sqrt(0.5) + 1.3e-9),
        (0.5, 0.5, math.sqrt(0.5) + 1.5e-9),
        (1.0 - 1e-5, 0.5, 0.5),
        (0.5, 1.0 - 1e-5, 0.5),
        (1.0 - 4e-5, 0.5, 0.5),
    ],
)
def test_slack_of_a_circle(circle):
    world = world_of(circles=[circle])
    assert met(world) == naively_met(world, AROUND, UNIT)


def test_a_wall_that_hardly_climbs():
    wall = (0.5, 0.0, 3.5, 5e-324)
    assert met(world_of(walls=[wall]), CellRect(0, 0, 9, 9)) == block(0, 0, 4, 1)
    assert met(world_of(walls=[(*wall[2:], *wall[:2])]), CellRect(0, 0, 9, 9)) == block(0, 0, 4, 1)


def test_a_circle_through_corners_meets_the_cells_on_both_sides():
    """3, 4 and 5: the circle of radius 5 around a corner touches twelve corners of the lattice."""
    cells = met(world_of(circles=[(0.0, 0.0, 5.0)]))
    for x, y in [(3, 4), (4, 3), (-3, 4), (-4, 3), (3, -4), (4, -3), (-3, -4), (-4, -3)]:
        assert block(x - 1, y - 1, 2, 2) <= cells
    assert {(5, 0), (5, -1), (-6, 0), (0, 5), (-1, -6)} <= cells
    assert cells.isdisjoint({(2, 2), (5, 1), (4, 4), (0, 3), (3, -3)} - {(3, -3)})
    assert cells == naively_met(world_of(circles=[(0.0, 0.0, 5.0)]), AROUND, UNIT)


def test_walls_of_the_lab_occupy_the_cells_on_both_of_their_sides():
    """0.1 is no binary fraction: without slack some of these would be missed."""
    cells = occupied_cells(lab(), Lattice(0.1, (-10.0, -10.0)), CellRect(-2, -2, 204, 204))
    for edge in (cells, cells[::-1], cells.T, cells.T[::-1]):
        assert not edge[0].any()
        assert edge[1, 1:-1].all()
        assert edge[2, 1:-1].all()
        assert edge[3].sum() == 4


def random_world(rng, number):
    """Obstacles of all sizes, on and off the lattice of halves."""
    circles = np.column_stack([rng.uniform(-7, 7, (number, 2)), rng.exponential(2.0, number)])
    walls = rng.uniform(-7, 7, (number, 4))
    circles[::2] = np.round(circles[::2] * 2) / 2 + [0, 0, 0.5]
    walls[::3] = np.round(walls[::3] * 2) / 2
    walls[::3, 2:] += (walls[::3, :2] == walls[::3, 2:]).all(axis=1, keepdims=True)
    walls[1::3, 2] = walls[1::3, 0]
    return world_of(circles, walls)


@pytest.mark.parametrize("piece", [1, 7, 2**18])
@pytest.mark.parametrize(
    ("lattice", "rect"),
    [
        (UNIT, CellRect(-5, -4, 11, 9)),
        (Lattice(0.5), CellRect(-12, -3, 13, 17)),
        (Lattice(0.3, (-3.1, 2.7)), CellRect(-4, -14, 12, 11)),
    ],
)
def test_cells_are_those_of_exact_geometry(monkeypatch, lattice, rect, piece):
    monkeypatch.setattr(cell_runs, "_PIECE", piece)
    rng = np.random.default_rng(piece)
    met_at_all = 0
    for number in (2, 3, 5):
        world = random_world(rng, number)
        cells = met(world, rect, lattice)
        # What lies as far out as the slack may go either way.
        assert (
            naively_met(world, rect, lattice, 0.999e-9)
            <= cells
            <= naively_met(world, rect, lattice, 1.001e-9)
        )
        met_at_all += len(cells)
    assert 20 < met_at_all < rect.cells * 3


@pytest.mark.parametrize("seed", range(6))
def test_cells_on_a_lattice_of_halves_are_exact_to_the_last_one(seed):
    rng = np.random.default_rng(seed)
    circles = np.column_stack([rng.integers(-6, 7, (3, 2)), rng.integers(1, 9, 3)]) / 2
    walls = rng.integers(-7, 8, (4, 4)) / 2
    walls[(walls[:, :2] == walls[:, 2:]).all(axis=1), 0] += 0.5
    world, rect = world_of(circles, walls), CellRect(-4, -4, 8, 8)
    assert met(world, rect) == naively_met(world, rect, UNIT)


def test_no_cells_and_no_obstacles_of_a_kind_are_no_trouble():
    assert occupied_cells(lab(), UNIT, CellRect(0, 0, 0, 0)).shape == (0, 0)
    assert occupied_cells(lab(), UNIT, CellRect(3, 3, 0, 5)).shape == (5, 0)
    assert met(world_of(circles=[(0.5, 0.5, 0.2)])) == {(0, 0)}


def test_many_walls_and_a_large_map_fit_into_little_memory():
    rng = np.random.default_rng(0)
    starts = rng.uniform(0, 200, (20_000, 2))
    walls = np.hstack([starts, starts + rng.normal(0, 1, (20_000, 2))])
    walls[:50, 2:] = rng.uniform(0, 200, (50, 2))
    rect = CellRect(0, 0, 4000, 4000)
    tracemalloc.start()
    try:
        occupied = occupied_cells(world_of(walls=walls), Lattice(0.05), rect)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < rect.cells + 60e6
    ends = np.floor(walls.reshape(-1, 2) / 0.05).astype(int)
    ends = ends[((ends >= 0) & (ends < 4000)).all(axis=1)]
    assert occupied[ends[:, 1], ends[:, 0]].all()


def snapshot_of(p, cells="float64", offset=(0, 0), lattice=UNIT):
    """A map of these probabilities, NaN where unknown; rows from the north, as one reads."""
    p = np.array(p, float)[::-1]
    known = ~np.isnan(p)
    model = LogOdds(cells)
    log_odds = np.log(np.where(known, p, 0.5) / (1 - np.where(known, p, 0.5)))
    return MapSnapshot(CellArrays.of(model, model.store(log_odds, known)), model, lattice, offset, "e", 1, 1)


NAN = math.nan


def figures(p, world, **changes):
    return truth_figures(snapshot_of(p, **changes), world)


WALL = world_of(walls=[(2.5, -9.0, 2.5, 9.0)])
"""Column 2 is truly occupied."""


def test_figures_by_hand():
    result = figures([[0.2, 0.2, 0.9, 0.2, 0.6, 0.8, NAN]], WALL)
    # Right of one half: all but 0.6 and 0.8, where nothing is.
    assert result["accuracy"] == pytest.approx(4 / 6)
    # 0.9 stands where the wall does; 0.8 does not.
    assert result["precision"] == 1 / 2
    # The wall's cells in this row, the one above and the one below are looked at, and all near 0.9.
    assert result["recall"] == 1.0
    assert result["iou"] == 1 / 2
    expected = -(3 * math.log(0.8) + math.log(0.9) + math.log(0.4) + math.log(0.2)) / 6
    assert result["log_loss"] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("p", "precision", "recall", "iou"),
    [
        ([[0.1, 0.9, 0.1, 0.1, 0.1]], 1.0, 1.0, 1.0),  # one cell beside it is near enough
        ([[0.1, 0.1, 0.1, 0.9, 0.1]], 1.0, 1.0, 1.0),
        ([[0.9, 0.1, 0.1, 0.1, 0.1]], 0.0, 0.0, 0.0),  # two are not
        ([[0.1, 0.1, 0.1, 0.1, 0.9]], 0.0, 0.0, 0.0),
        ([[0.9, 0.1, 0.1, 0.9, 0.9]], 1 / 3, 1.0, 1 / 3),
        # Six cells of the wall: those beside the map, too. The row of 0.9 finds three of them.
        ([[0.1, 0.9], [0.1, 0.1], [0.1, 0.1], [0.1, 0.1]], 1.0, 3 / 6, 1 / 4),
        ([[NAN, 0.9], [NAN, NAN], [NAN, NAN], [NAN, 0.1]], 1.0, 3 / 6, 1 / 4),
        ([[NAN, 0.9], [NAN, NAN], [NAN, NAN], [NAN, NAN]], 1.0, 1.0, 1.0),  # never looked at
        ([[0.1, 0.65]], None, 0.0, 0.0),
        ([[0.1, 0.66]], 1.0, 1.0, 1.0),
    ],
)
def test_precision_recall_and_iou_allow_one_cell(p, precision, recall, iou):
    result = figures(p, WALL)
    assert (result["precision"], result["recall"], result["iou"]) == (precision, recall, iou)


def test_corners_are_within_one_cell():
    post = world_of(circles=[(1.5, 1.5, 0.2)])
    assert figures([[0.1, 0.1, 0.9], [0.1, 0.1, 0.1], [0.1, 0.1, 0.1]], post)["precision"] == 1.0
    assert figures([[0.9, 0.1, 0.1], [0.1, 0.1, 0.1], [0.1, 0.1, 0.1]], post)["recall"] == 1.0


def test_what_is_true_beside_the_map_counts():
    """A wall on the map's edge, and one that a whole cell lies between."""
    on_the_edge, beside, far = (world_of(walls=[(x, -9.0, x, 9.0)]) for x in (2.0, 2.5, 3.5))
    assert figures([[0.1, 0.9]], on_the_edge)["accuracy"] == 1.0
    result = figures([[0.1, 0.9]], beside)
    assert (result["accuracy"], result["precision"], result["recall"]) == (0.5, 1.0, 1.0)
    result = figures([[0.1, 0.9]], far)
    assert (result["precision"], result["recall"], result["iou"]) == (0.0, None, 0.0)


def test_one_half_is_not_occupied():
    assert figures([[0.5, 0.5, 0.5]], WALL)["accuracy"] == 2 / 3
    assert figures([[0.5, 0.5, 0.5]], WALL)["log_loss"] == pytest.approx(math.log(2))


def test_log_loss_is_limited():
    model = LogOdds("float64", l_min=-900.0, l_max=900.0)
    row = np.array([[-900.0, -900.0, -900.0]])
    result = truth_figures(MapSnapshot(CellArrays.of(model, row), model, UNIT, (0, 0), "e", 1, 1), WALL)
    assert result["log_loss"] == pytest.approx(-math.log(1e-9) / 3)
    result = truth_figures(MapSnapshot(CellArrays.of(model, -row), model, UNIT, (0, 0), "e", 1, 1), WALL)
    assert result["log_loss"] == pytest.approx(-math.log(1e-9) * 2 / 3)


@BOTH
def test_nothing_judged_gives_none(cells):
    nothing = dict.fromkeys(FIGURES)
    assert figures(np.empty((0, 0)), WALL, cells=cells) == nothing
    assert figures([[NAN, NAN], [NAN, NAN]], WALL, cells=cells) == nothing
    free = figures([[0.2, 0.2]], world_of(circles=[(90.0, 90.0, 1.0)]), cells=cells)
    assert free == {**nothing, "accuracy": 1.0, "log_loss": pytest.approx(-math.log(0.8), abs=1e-4)}


@BOTH
@pytest.mark.parametrize("band", [1, 40, 2**18])
def test_figures_are_those_of_every_cell_by_itself(monkeypatch, cells, band):
    monkeypatch.setattr(model_module, "_BAND_CELLS", band)
    rng = np.random.default_rng(band)
    world, lattice, offset = random_world(rng, 2), Lattice(0.7, (-3.1, 2.7)), (-4, -14)
    rect = CellRect(*offset, 14, 15)
    true = occupied_cells(world, lattice, rect)
    # A map that is right about most cells, and knows two thirds of them.
    p = np.clip(np.where(true, 0.65, 0.3) + rng.normal(0, 0.3, true.shape), 0.001, 0.999)
    p[rng.random(true.shape) < 0.33] = NAN
    snapshot = snapshot_of(p[::-1], cells, offset, lattice)
    stored = snapshot.model.probability(snapshot.cells)
    known = {(rect.ix + ix, rect.iy + iy): stored[iy, ix] for iy, ix in np.argwhere(~np.isnan(p)).tolist()}
    expected = naive_truth.truth_figures(known, lambda cell: naive_truth.is_occupied(world, lattice, cell))
    assert truth_figures(snapshot, world) == pytest.approx(expected, rel=1e-12)
    assert all(0.3 < expected[name] < 1.0 for name in FIGURES), expected


def test_figures_do_not_depend_on_where_the_map_is_cut():
    rng = np.random.default_rng(3)
    world = random_world(rng, 3)
    p = rng.uniform(0.01, 0.99, (9, 11))
    tight = snapshot_of(p, offset=(-5, -4))
    wide = snapshot_of(np.pad(p, 3, constant_values=NAN), offset=(-8, -7))
    assert truth_figures(tight, world) == truth_figures(wide, world)
