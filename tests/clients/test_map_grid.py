"""A map in the user's hands: where its cells lie, what they mean, and the files it writes."""

import math

import numpy as np
import pytest
import yaml
from PIL import Image

from ogm_client import MapGrid
from ogm_core.errors import BadParameter, MapEmpty
from ogm_core.map_files import read_npz

FREE, OCCUPIED, UNDECIDED, PRIOR = math.log(0.19 / 0.81), math.log(0.66 / 0.34), math.log(0.64 / 0.36), 0.0
LOG_ODDS = np.array([[math.nan, OCCUPIED], [FREE, PRIOR], [UNDECIDED, -0.0]])


def grid_of(log_odds=LOG_ODDS, **changes):
    fields = {"resolution": 0.5, "anchor": (10.0, -20.0), "offset": (-2, 4)}
    return MapGrid(np.asarray(log_odds), **(fields | changes), epoch="e", revision=3, stamp=None)


def test_where_it_lies():
    grid = grid_of()
    assert (grid.width, grid.height) == (2, 3)
    assert grid.origin == (9.0, -18.0)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_what_its_cells_mean(dtype):
    grid = grid_of(LOG_ODDS.astype(dtype))
    np.testing.assert_array_equal(grid.known, [[False, True], [True, True], [True, True]])
    np.testing.assert_allclose(grid.probability, [[math.nan, 0.66], [0.19, 0.5], [0.64, 0.5]], rtol=1e-6)
    assert grid.probability.dtype == np.float64
    np.testing.assert_array_equal(grid.occupancy, [[-1, 100], [0, -1], [-1, -1]])
    assert grid.occupancy.dtype == np.int8


@pytest.mark.parametrize(
    ("point", "cell", "probability"),
    [
        ((9.0, -18.0), (-2, 4), math.nan),  # the lower-left corner belongs to the cell, which is unknown
        ((9.75, -17.75), (-1, 4), 0.66),
        ((9.25, -17.25), (-2, 5), 0.19),
        ((9.25, -16.51), (-2, 6), 0.64),
        ((8.99, -17.25), (-3, 5), math.nan),  # west of the grid: no wrapping round
        ((9.25, -18.01), (-2, 3), math.nan),
        ((10.0, -17.25), (0, 5), math.nan),
        ((9.25, -16.5), (-2, 7), math.nan),
    ],
)
def test_points_and_cells(point, cell, probability):
    grid = grid_of()
    assert grid.world_to_cell(*point) == cell
    assert grid.at(*point) == pytest.approx(probability, nan_ok=True)


def test_a_point_that_is_none():
    with pytest.raises(BadParameter, match="no cell"):
        grid_of().at(math.nan, 0.0)


@pytest.mark.parametrize(
    ("palette", "pixels"),
    [("ros", [[205, 205], [254, 205], [205, 0]]), ("probability", [[163, 128], [48, 128], [127, 168]])],
)
def test_a_picture_is_north_up(tmp_path, palette, pixels):
    grid_of().save_png(tmp_path / "map.png", palette=palette)
    with Image.open(tmp_path / "map.png") as image:
        np.testing.assert_array_equal(np.asarray(image), pixels)


def test_an_unknown_palette(tmp_path):
    with pytest.raises(BadParameter, match="palette"):
        grid_of().save_png(tmp_path / "map.png", palette="rainbow")


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_an_archive_is_the_mapper_s(tmp_path, dtype):
    grid = grid_of(LOG_ODDS.astype(dtype))
    grid.save_npz(str(tmp_path / "kept"))
    read = read_npz((tmp_path / "kept").read_bytes())
    np.testing.assert_array_equal(read.log_odds, grid.log_odds)
    assert read.log_odds.dtype == dtype
    assert (read.resolution, read.anchor, read.offset) == (0.5, (10.0, -20.0), (-2, 4))
    with np.load(tmp_path / "kept") as arrays:
        np.testing.assert_array_equal(arrays["origin"], [9.0, -18.0])


@pytest.mark.parametrize(
    ("given", "name", "suffix"),
    [("a", "a", "yaml"), ("a.yaml", "a", "yaml"), ("a.yml", "a", "yml"), ("floor.2", "floor.2", "yaml")],
)
def test_a_ros_map_is_a_pair(tmp_path, given, name, suffix):
    grid_of().save_ros_map(tmp_path / given)
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"{name}.pgm", f"{name}.{suffix}"]
    description = yaml.safe_load((tmp_path / f"{name}.{suffix}").read_text())
    assert description == {
        "image": f"{name}.pgm",
        "mode": "trinary",
        "resolution": 0.5,
        "origin": [9.0, -18.0, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    with Image.open(tmp_path / f"{name}.pgm") as image:
        np.testing.assert_array_equal(np.asarray(image), [[205, 205], [254, 205], [205, 0]])


@pytest.mark.parametrize("save", ["save_png", "save_ros_map"])
def test_an_empty_map_has_no_picture(tmp_path, save):
    grid = grid_of(np.empty((0, 0)), offset=(0, 0))
    assert grid.origin == (10.0, -20.0)
    assert math.isnan(grid.at(10.0, -20.0))
    with pytest.raises(MapEmpty):
        getattr(grid, save)(tmp_path / "map")
    assert list(tmp_path.iterdir()) == []
