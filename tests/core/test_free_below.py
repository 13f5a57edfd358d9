"""Maps with a `free_below` of their own: free is the same everywhere, and nothing else changes."""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml

from ogm_core.cells.classes import percent, probability_grey, ros_grey, trinary
from ogm_core.cells.compiled import compiled
from ogm_core.cells.log_odds import LogOdds, probability_of
from ogm_core.cells.rate import Rate
from ogm_core.cells.value_bytes import FREE_LAST, OCCUPIED_FIRST, value_byte
from ogm_core.errors import BadMapFile, BadSetting
from ogm_core.files.map_files import encode_npz, encode_yaml, pack, read_npz
from ogm_core.files.merged_maps import merge_maps
from ogm_core.files.npz_arrays import NpzArrays
from ogm_core.files.ros_map_writer import write_yaml
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.quality.class_maps import CLASSES, read_class_map
from ogm_core.quality.figures import map_figures, map_figures_within
from ogm_core.quality.judged_map import JudgedMap
from ogm_core.queries.rays import FOUND_NOTHING, FOUND_UNKNOWN, FOUND_WALL, RayCaster
from ogm_core.tiles.halved import tiled
from ogm_core.tiles.overviews import write_value_bytes
from ogm_core.tiles.pyramid import Square, TilePyramid
from ogm_core.types import Pose, Scan

CAUTIOUS = 0.05
MODELS = {
    "int16": LogOdds,
    "float64": lambda **given: LogOdds("float64", **given),
    "rate": lambda **given: compiled(Rate(**given)),
}
EVERY_MODEL = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)


def grid_of(model):
    """A room whose middle was seen often and whose corners once."""
    grid = OccupancyGrid(GridSettings(resolution=0.25, cell_model=model), "e", "r")
    for k in range(6):
        ranges = np.random.default_rng(k).uniform(2.0, 7.0, 90).astype(np.float32)
        scan = Scan(k, -math.pi, math.tau / 90, 0.1, 6.5, np.where(ranges > 6.5, np.inf, ranges))
        grid.integrate(scan, Pose(0.1 * k, 0.2, 0.3 * k))
    return grid


def snapshots(model):
    """The map of a model, as always and cautious, in all cells that it is served in."""
    usual, cautious = grid_of(model()).snapshot(), grid_of(model(free_below=CAUTIOUS)).snapshot()
    return [(usual, cautious), (usual.finest(), cautious.finest())]


@EVERY_MODEL
def test_free_is_the_same_in_all_that_has_classes(model):
    for usual, cautious in snapshots(model):
        p, known = cautious.published()
        free, between = known & (p < CAUTIOUS), known & (p >= CAUTIOUS) & (p < 0.196)
        assert free.any()
        assert between.any()
        assert np.array_equal(cautious.encode(trinary) == 0, free)
        assert np.array_equal(cautious.encode(ros_grey) == 254, free)
        values = cautious.encode(value_byte)
        assert np.array_equal((values >= 1) & (values <= FREE_LAST), free)
        assert (values[between] == FREE_LAST + 1).all()
        judged = JudgedMap.of(cautious) if cautious.model.margin != 1 else None
        if judged is not None:
            assert np.array_equal(judged.classes == CLASSES.index("free"), free)
        cell = cautious.resolution**2
        assert map_figures(cautious)["free_m2"] == pytest.approx(free.sum() * cell)
        part, whole = (map_figures_within(each, p.size // 2)[0] for each in (cautious, usual))
        assert 0.0 < part["free_m2"] < whole["free_m2"]
        for encoder in (percent, probability_grey):
            assert np.array_equal(cautious.encode(encoder), usual.encode(encoder))
        assert np.array_equal(cautious.encode(trinary) == 100, usual.encode(trinary) == 100)


@EVERY_MODEL
def test_blocks_and_tiles_have_the_same_classes(model):
    for usual, cautious in snapshots(model):
        small, blocks = (each.shrink(each.width // 2 + 1) for each in (cautious, usual))
        assert small.factor > 1
        p, known = blocks.published()
        assert np.array_equal(small.encode(trinary), trinary(p, known, CAUTIOUS))
        assert (small.encode(trinary) != blocks.encode(trinary)).any()
        view = tiled(cautious.stored)
        for z in (16, 15, 14):
            square = Square(z, 0, -1)
            pixels = TilePyramid().pixels(view, cautious.model, square)
            side = 1 << (16 - z)
            part = square.rect.intersection(cautious.rect)
            cells = np.full((square.rect.height, square.rect.width), 0, np.uint8)
            y, x = part.iy - square.rect.iy, part.ix - square.rect.ix
            cells[y : y + part.height, x : x + part.width] = cautious.part(part).encode(value_byte)
            joined = cells.reshape(256, side, 256, side).swapaxes(1, 2).reshape(256, 256, -1).astype(int)
            lowest = np.where(joined == 0, 256, joined).min(axis=2) % 256
            highest = joined.max(axis=2)
            assert np.array_equal(pixels, np.where(highest >= OCCUPIED_FIRST, highest, lowest))


@pytest.mark.parametrize("free_below", [0.004, CAUTIOUS, 0.196, 0.4, 0.64])
def test_value_bytes_rise_with_the_probability_and_keep_its_class(free_below):
    p = np.unique([*np.linspace(0.0, 1.0, 10_001), free_below, np.nextafter(free_below, 0.0)])
    known = np.ones(p.shape, np.bool_)
    values, found = value_byte(p, known, free_below), np.empty(p.size, np.uint8)
    write_value_bytes(p, known, free_below, found)
    assert np.array_equal(found, values)
    assert (np.diff(values.astype(int)) >= 0).all()
    assert np.array_equal((values >= 1) & (values <= FREE_LAST), p < free_below)
    assert np.array_equal(values >= OCCUPIED_FIRST, p > 0.65)


@EVERY_MODEL
def test_a_saved_map_tells_it_and_only_where_it_is_not_the_usual_one(model, tmp_path):
    usual, cautious = (snapshot.finest() for snapshot in snapshots(model)[0])
    npz, path = read_npz(encode_npz(cautious)), tmp_path / "map.npz"
    assert npz.free_below == CAUTIOUS
    classes = trinary(probability_of(npz.log_odds), ~np.isnan(npz.log_odds), npz.free_below)
    assert np.array_equal(classes, cautious.encode(trinary))
    path.write_bytes(encode_npz(cautious))
    free = read_class_map(path).classes == CLASSES.index("free")
    assert np.array_equal(free, cautious.encode(trinary) == 0)
    path.write_bytes(encode_npz(usual))
    with path.open("rb") as file, NpzArrays(file) as arrays:
        assert "free_below" not in arrays
    assert read_npz(encode_npz(usual)).free_below == 0.196
    assert cautious.model.told == {**usual.model.told, "free_below": CAUTIOUS}
    assert "free_below" not in usual.model.told


def test_merged_maps_are_as_cautious_as_the_most_cautious_of_them(tmp_path):
    paths = [tmp_path / f"{n}.npz" for n in range(3)]
    for path, free_below in zip(paths, (0.1, CAUTIOUS, 0.196), strict=True):
        path.write_bytes(encode_npz(grid_of(Rate(free_below=free_below)).snapshot()))
    assert merge_maps(paths).model.free_below == CAUTIOUS
    assert merge_maps([paths[2], paths[2]]).model.free_below == 0.196


@pytest.mark.parametrize(
    ("free_below", "written"),
    [(CAUTIOUS, CAUTIOUS), (0.196, 0.196), (0.3, 0.196), (0.003, 0.196), (0.1961, 0.196)],
)
def test_a_ros_map_is_described_so_that_its_greys_mean_what_they_do(free_below, written):
    """White is p = 0.004 to nav2, and 205, unknown, 0.19608: between the two lies what tells them apart."""
    described = yaml.safe_load(write_yaml("map.pgm", 0.05, (0.0, 0.0), free_below=free_below))
    assert described["free_thresh"] == written
    snapshot = grid_of(LogOdds(free_below=free_below)).snapshot()
    assert yaml.safe_load(encode_yaml(snapshot, "map.pgm"))["free_thresh"] == written


def test_a_ray_ends_at_the_first_cell_that_is_not_free():
    log_odds = np.log(np.array([[0.01, 0.03, 0.1, 0.9]]) / np.array([[0.99, 0.97, 0.9, 0.1]]))
    given = (log_odds, replace(GridSettings(resolution=1.0)).lattice, (0, 0), (0.5, 0.5), 10.0)
    assert RayCaster(*given).cast(0.0) == (FOUND_WALL, 2.5)
    assert RayCaster(*given, free_below=CAUTIOUS).cast(0.0) == (FOUND_UNKNOWN, 1.5)
    assert RayCaster(*given, free_below=CAUTIOUS, through_unknown=True).cast(0.0) == (FOUND_WALL, 2.5)
    assert RayCaster(*given, through_unknown=True).cast(math.pi / 2) == (FOUND_NOTHING, 10.0)


def test_models_that_call_other_cells_free_are_not_the_same():
    """Tables of what their cells become are kept by the model."""
    for model in MODELS.values():
        assert model() == model(free_below=0.196)
        assert model() != model(free_below=CAUTIOUS)
        assert hash(model(free_below=CAUTIOUS)) == hash(model(free_below=CAUTIOUS))


@pytest.mark.parametrize("wrong", [0.0, -0.1, 0.65, 1.0, math.nan, math.inf])
def test_what_cannot_separate_free_from_occupied_is_refused(wrong, tmp_path):
    told = rf"free_below: a probability above 0 and below 0\.65, .*, is needed, got {wrong:g}"
    for model in MODELS.values():
        with pytest.raises(BadSetting, match=told):
            model(free_below=wrong)
    path = tmp_path / "map.npz"
    snapshot = grid_of(Rate()).snapshot()
    place = {"resolution": 0.5, "anchor": np.zeros(2), "offset": np.zeros(2, np.int64)}
    arrays = {**snapshot.model.arrays(snapshot.stored), **place, "free_below": wrong}
    path.write_bytes(pack({name: np.asarray(value) for name, value in arrays.items()}))
    with pytest.raises(BadMapFile, match=rf"map\.npz: {told}"):
        read_class_map(path)


def test_the_cells_that_a_map_keeps_do_not_depend_on_it():
    whole = CellRect(-40, -40, 80, 80)
    for model in MODELS.values():
        usual, cautious = grid_of(model()), grid_of(model(free_below=CAUTIOUS))
        for name, cells in tiled(usual.snapshot().stored).window(whole, 0).items():
            assert np.array_equal(cells, tiled(cautious.snapshot().stored).window(whole, 0)[name]), name
