import json
import math

import numpy as np
import pytest

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.classes import probability_grey, trinary
from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import BadParameter
from ogm_core.lattice import CellRect, Lattice, Region
from ogm_core.snapshot import MapSnapshot

INF = math.inf
MODELS = [
    LogOdds("int16"),
    LogOdds("float64"),
    LogOdds("int16", p_prior=0.2, p_free=0.1, p_occ=0.6, l_max=0.5),
    LogOdds("float64", p_prior=0.2, p_free=0.1, p_occ=0.6, l_max=0.5),
]
model_of_every_kind = pytest.mark.parametrize("model", MODELS, ids=lambda m: f"{m.cells}, prior {m.p_prior}")


def snapshot(cells, model=MODELS[0], offset=(0, 0), lattice=None, **fields):
    fields = {"epoch": "e1", "run": "r1", "revision": 7, "stamp": 123, **fields}
    return MapSnapshot(
        CellArrays.of(model, np.asarray(cells, model.dtype)), model, lattice or Lattice(0.5), offset, **fields
    )


def random_cells(model, shape, seed, share_known=0.5):
    """Stored cells over the whole range of the type, many of them undecided, some exactly at log_odds = 0."""
    rng = np.random.default_rng(seed)
    update = model.constants
    known = rng.random(shape) < share_known
    near = rng.random(shape) < 0.7
    if model.cells == "int16":
        steps = rng.integers(update.lower // 2, update.upper // 2, shape, endpoint=True)
        steps = np.where(near, rng.integers(-2, 3, shape), steps)
        return np.where(known, 2 * steps | 1, 0).astype(np.int16)
    log_odds = np.where(
        near, rng.choice([-0.0, -1.5, -1.3, 0.4, 0.7], shape), rng.uniform(update.lower, update.upper, shape)
    )
    return np.where(known, log_odds, 0.0)


def naive_shrink(model, cells, factor):
    height, width = cells.shape
    rows = []
    for top in range(0, height, factor):
        row = []
        for left in range(0, width, factor):
            block = cells[top : top + factor, left : left + factor].ravel()
            known = [cell for cell in block if model.known(np.array([cell]))[0]]
            picked = 0
            if known:
                log_odds = [model.log_odds(np.array([cell]))[0] for cell in known]
                highest, lowest = known[int(np.argmax(log_odds))], known[int(np.argmin(log_odds))]
                occupied = model.probability(np.array([highest]))[0] > 0.65
                picked = highest if occupied else lowest
            row.append(picked)
        rows.append(row)
    return np.array(rows, cells.dtype)


def bits(cells):
    return cells.view(np.int64 if cells.dtype == np.float64 else np.int16).tolist()


@model_of_every_kind
@pytest.mark.parametrize(
    ("shape", "max_size", "factor"),
    [
        ((1, 1), 1, 1),
        ((12, 12), 12, 1),
        ((12, 12), 11, 2),
        ((12, 12), 6, 2),
        ((12, 12), 5, 3),
        ((13, 7), 4, 4),
        ((7, 13), 5, 3),
        ((37, 41), 9, 5),
        ((9, 100), 2, 50),
        ((100, 9), 1, 100),
        ((30, 1), 7, 5),
    ],
)
def test_shrink_equals_its_naive_twin(model, shape, max_size, factor):
    for seed, share_known in enumerate([0.05, 0.5, 1.0]):
        cells = random_cells(model, shape, seed, share_known)
        before = cells.copy()
        small = snapshot(cells, model).shrink(max_size)
        assert small.factor == factor
        assert max(small.width, small.height) <= max_size
        assert bits(small.cells) == bits(naive_shrink(model, cells, factor))
        assert bits(cells) == bits(before)


@model_of_every_kind
def test_occupied_wins_then_free_then_unknown(model):
    cells = random_cells(model, (60, 50), 3, 0.2)
    small = snapshot(cells, model).shrink(20)
    big, got = model.encode(cells, trinary), model.encode(small.cells, trinary)
    p, known = model.probability(cells), model.known(cells)
    grey = model.encode(small.cells, probability_grey)
    for iy in range(20):
        for ix in range(17):
            block = np.s_[3 * iy : 3 * iy + 3, 3 * ix : 3 * ix + 3]
            values = set(big[block].ravel().tolist())
            assert got[iy, ix] == (100 if 100 in values else 0 if 0 in values else -1)
            seen = p[block][known[block]]
            shown = 127 if not seen.size else 255 * (seen.max() if seen.max() > 0.65 else seen.min())
            assert grey[iy, ix] == int(shown + 0.5)


def test_blocks_count_from_the_lower_left_cell():
    cells = np.zeros((5, 5), np.int16)
    cells[2, 3] = cells[4, 4] = 2001
    small = snapshot(cells, offset=(-3, 10)).shrink(3)
    assert small.cells.tolist() == [[0, 0, 0], [0, 2001, 0], [0, 0, 2001]]
    assert (small.resolution, small.origin, small.offset) == (1.0, (-1.5, 5.0), (-3, 10))
    assert small.rect == CellRect(-3, 10, 6, 6)


@model_of_every_kind
def test_shrinking_twice_is_shrinking_once(model):
    cells = random_cells(model, (48, 36), 9)
    twice = snapshot(cells, model).shrink(16).shrink(8)
    assert twice.factor == 6
    assert bits(twice.cells) == bits(naive_shrink(model, cells, 6))


def test_a_known_zero_stays_known_through_shrink():
    model = LogOdds("float64")
    small = snapshot([[0.0, -0.0], [0.0, 0.0]], model).shrink(1)
    assert model.known(small.cells).tolist() == [[True]]
    unknown = snapshot(np.zeros((2, 2)), model).shrink(1)
    assert model.known(unknown.cells).tolist() == [[False]]


@pytest.mark.parametrize("max_size", [0, -5])
def test_max_size_below_one_is_refused(max_size):
    with pytest.raises(BadParameter, match=f"max_size.*{max_size}"):
        snapshot(np.ones((3, 3))).shrink(max_size)


def test_an_empty_map_shrinks_and_crops_to_itself():
    empty = snapshot(np.zeros((0, 0)), revision=0, stamp=None)
    assert empty.empty
    assert empty.shrink(5) is empty
    assert empty.crop(Region(0, 0, 1, 1)) is empty
    assert empty.rect == CellRect(0, 0, 0, 0)
    with pytest.raises(BadParameter):
        empty.crop(Region(1, 0, 0, 1))


def numbered(height=6, width=8, offset=(-4, -2), lattice=None):
    return snapshot(np.arange(1, height * width + 1).reshape(height, width), offset=offset, lattice=lattice)


@pytest.mark.parametrize(
    ("region", "rows", "columns"),
    [
        (Region(-2.0, -1.0, 2.0, 2.0), slice(0, 6), slice(0, 8)),
        (Region(-100.0, -100.0, 100.0, 100.0), slice(0, 6), slice(0, 8)),
        (Region(0.0, 0.0, 0.5, 0.5), slice(2, 3), slice(4, 5)),
        (Region(0.1, 0.1, 0.2, 0.2), slice(2, 3), slice(4, 5)),
        (Region(0.4, 0.4, 0.6, 1.1), slice(2, 5), slice(4, 6)),
        (Region(-9.0, 1.9, -1.6, 9.0), slice(5, 6), slice(0, 1)),
        (Region(1.9, -9.0, 9.0, -0.9), slice(0, 1), slice(7, 8)),
    ],
)
def test_crop_rounds_outward_and_clips(region, rows, columns):
    whole = numbered()
    part = whole.crop(region)
    assert part.cells.tolist() == whole.cells[rows, columns].tolist()
    assert part.offset == (-4 + columns.start, -2 + rows.start)
    assert part.origin == (0.5 * part.offset[0], 0.5 * part.offset[1])
    assert (part.epoch, part.revision, part.stamp) == ("e1", 7, 123)


def test_a_part_is_the_cells_of_a_rectangle():
    whole = numbered()
    part = whole.part(CellRect(-3, 0, 5, 2))
    assert part.cells.tolist() == whole.cells[2:4, 1:6].tolist()
    assert (part.offset, part.rect) == ((-3, 0), CellRect(-3, 0, 5, 2))
    assert whole.part(whole.rect).cells.tolist() == whole.cells.tolist()
    again = part.part(CellRect(-2, 1, 1, 1))
    assert (again.cells.tolist(), again.offset) == ([[whole.cells[3, 2]]], (-2, 1))


def test_crop_keeps_every_cell_in_its_place_in_the_world():
    lattice = Lattice(0.25, (10.0, -7.0))
    whole = numbered(offset=(3, 5), lattice=lattice)
    part = whole.crop(Region(11.3, -5.4, 11.9, -5.1))
    for x, y in [(11.3, -5.4), (11.8, -5.11), (11.6, -5.3)]:
        ix, iy = lattice.cell_of(x, y)
        assert part.cells[iy - part.offset[1], ix - part.offset[0]] == whole.cells[iy - 5, ix - 3]


@pytest.mark.parametrize(
    "region",
    [
        Region(2.0, 0.0, 3.0, 1.0),  # begins where the map ends
        Region(-3.0, 0.0, -2.0, 1.0),
        Region(0.0, 2.0, 1.0, 2.5),
        Region(0.0, -1.5, 1.0, -1.0),
        Region(50.0, 50.0, 60.0, 60.0),
    ],
)
def test_a_region_wholly_outside_is_refused_and_told_the_extent(region):
    with pytest.raises(BadParameter, match=r"^region x .* outside the map, x -2 to 2, y -1 to 2 m$"):
        numbered().crop(region)


@pytest.mark.parametrize(
    "region",
    [
        Region(1, 0, 0, 1),
        Region(0, 1, 1, 0),
        Region(0, 0, 0, 1),
        Region(0, 0, INF, 1),
        Region(INF, 0, 1, INF),
    ],
)
def test_ill_formed_regions_are_refused(region):
    with pytest.raises(BadParameter, match="region"):
        numbered().crop(region)


def test_a_shrunk_map_crops_to_whole_pixels():
    whole = numbered(offset=(1, 1)).shrink(3)
    assert (whole.factor, whole.width, whole.height) == (3, 3, 2)
    part = whole.crop(Region(2.1, 0.6, 2.2, 2.4))
    assert part.offset == (4, 1)
    assert part.cells.tolist() == whole.cells[0:2, 1:2].tolist()


def test_meta_has_the_names_and_shapes_of_the_json():
    snap = snapshot(np.ones((2, 3)), offset=(-4, 6), lattice=Lattice(0.5, (10.0, 20.0)))
    assert snap.meta() == {
        "epoch": "e1",
        "run": "r1",
        "revision": 7,
        "stamp": 123,
        "resolution": 0.5,
        "width": 3,
        "height": 2,
        "origin": {"x": 8.0, "y": 23.0, "theta": 0.0},
        "anchor": [10.0, 20.0],
        "offset": [-4, 6],
    }
    json.dumps(snap.meta())
