"""A map in the user's hands: where its cells lie, what they mean, and the files it writes."""

import io
import math
import os
import zlib
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from ogm_client import MapGrid
from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import BadMapFile, BadParameter, MapEmpty
from ogm_core.files.map_files import encode_npz, read_npz
from ogm_core.files.ros_map_reader import read_ros_map
from ogm_core.lattice import Lattice
from ogm_core.snapshot import MapSnapshot

FREE, OCCUPIED, UNDECIDED, PRIOR = math.log(0.19 / 0.81), math.log(0.66 / 0.34), math.log(0.64 / 0.36), 0.0
LOG_ODDS = np.array([[math.nan, OCCUPIED], [FREE, PRIOR], [UNDECIDED, -0.0]])


def grid_of(log_odds=LOG_ODDS, **changes):
    fields = {"resolution": 0.5, "anchor": (10.0, -20.0), "offset": (-2, 4)}
    return MapGrid(np.asarray(log_odds), **(fields | changes), epoch="e", revision=3, stamp=None)


def test_where_it_lies():
    grid = grid_of()
    assert (grid.width, grid.height) == (2, 3)
    assert grid.origin == (9.0, -18.0)


@pytest.mark.parametrize("cells", ["int16", "float64"])
def test_of_a_snapshot_it_is_what_a_mapper_would_send(cells):
    model = LogOdds(cells)
    stored = model.store(np.nan_to_num(LOG_ODDS), ~np.isnan(LOG_ODDS))
    snapshot = MapSnapshot(
        CellArrays.of(model, stored), model, Lattice(0.5, (10.0, -20.0)), (-2, 4), "e", 3, 17, run="r"
    )
    grid, sent = MapGrid.from_snapshot(snapshot), read_npz(encode_npz(snapshot))
    np.testing.assert_array_equal(grid.log_odds, sent.log_odds)
    assert grid.log_odds.dtype == sent.log_odds.dtype
    assert (grid.resolution, grid.anchor, grid.offset) == (sent.resolution, sent.anchor, sent.offset)
    assert (grid.epoch, grid.run, grid.revision, grid.stamp) == ("e", "r", 3, 17)
    np.testing.assert_allclose(grid.log_odds, LOG_ODDS, atol=model.step)
    assert grid.origin == snapshot.origin == (9.0, -18.0)
    with pytest.raises(BadParameter, match="blocks of 2 x 2"):
        MapGrid.from_snapshot(snapshot.shrink(2))


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


@pytest.mark.parametrize(
    ("options", "pixels"),
    [
        ({}, [[205, 205], [254, 205], [205, 0]]),
        ({"palette": "probability"}, [[163, 128], [48, 128], [127, 168]]),
        ({"max_size": 3}, [[205, 205], [254, 205], [205, 0]]),
        ({"max_size": 2}, [[205], [0]]),  # blocks from the lower-left cell: the lower one holds a wall
        ({"max_size": 1}, [[0]]),
        ({"palette": "probability", "max_size": 2}, [[128], [168]]),
    ],
)
def test_a_picture_as_bytes_is_the_file_s(tmp_path, options, pixels):
    png = grid_of().to_png(**options)
    with Image.open(io.BytesIO(png)) as image:
        assert (image.format, image.mode) == ("PNG", "L")
        np.testing.assert_array_equal(np.asarray(image), pixels)
    grid_of().save_png(tmp_path / "map.png", **options)
    assert (tmp_path / "map.png").read_bytes() == png


def test_a_picture_has_a_pixel_at_least():
    with pytest.raises(BadParameter, match="max_size"):
        grid_of().to_png(max_size=0)


@pytest.mark.parametrize(
    ("region", "offset", "cells"),
    [
        ((9.0, -18.0, 10.0, -16.5), (-2, 4), [[0, 1], [2, 3], [4, 5]]),
        ((9.1, -17.4, 9.2, -17.3), (-2, 5), [[2]]),  # rounded outward
        ((9.4, -17.6, 9.6, -17.4), (-2, 4), [[0, 1], [2, 3]]),
        ((9.5, -17.5, 10.0, -17.0), (-1, 5), [[3]]),  # along the edges of cells: not one cell more
        ((9.7, -99, 99, 99), (-1, 4), [[1], [3], [5]]),
        (np.array([-1e300, -17, 9.5, 1e300]), (-2, 6), [[4]]),
        ([9, -18, 10, -17], (-2, 4), [[0, 1], [2, 3]]),
    ],
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_part_is_a_copy_of_its_cells(region, offset, cells, dtype):
    grid = grid_of(np.arange(6, dtype=dtype).reshape(3, 2))
    part = grid.crop(region)
    np.testing.assert_array_equal(part.log_odds, cells)
    assert part.log_odds.dtype == dtype
    assert part.offset == offset
    assert (part.resolution, part.anchor) == (grid.resolution, grid.anchor)
    assert (part.epoch, part.revision, part.stamp) == ("e", 3, None)
    assert not np.shares_memory(part.log_odds, grid.log_odds)


def test_a_part_on_the_edges_of_cells_is_exactly_these():
    grid = grid_of(np.zeros((120, 120)), resolution=0.1, anchor=(-6.0, -6.0), offset=(0, 0))
    for ix in range(120):
        west, east = -6.0 + ix * 0.1, -6.0 + (ix + 1) * 0.1
        part = grid.crop((west, round(west, 6), east, round(east, 6)))
        assert (part.width, part.height, part.offset) == (1, 1, (ix, ix))


def test_a_point_of_a_part_is_that_of_the_whole():
    grid, point = grid_of(), (9.75, -17.75)
    part = grid.crop((9.6, -17.9, 9.7, -17.8))
    assert part.world_to_cell(*point) == grid.world_to_cell(*point)
    assert part.at(*point) == grid.at(*point) == pytest.approx(0.66)
    assert math.isnan(part.at(9.25, -17.25))
    np.testing.assert_array_equal(part.crop((0, -99, 99, 0)).log_odds, part.log_odds)


@pytest.mark.parametrize(
    ("region", "message"),
    [
        ((10.0, -18.0, 11.0, -16.0), "wholly outside the map, x 9 to 10, y -18 to -16.5 m"),
        ((10.0, -18.0, 9.0, -16.5), "xmin < xmax"),
        ((9.0, -18.0, 9.0, -16.5), "xmin < xmax"),
        ((9.0, -18.0, 10.0, math.nan), "finite"),
        ((9.0, -18.0, 10.0), "region: four numbers"),
        (("west", -18.0, 10.0, 0.0), "region: four numbers"),
        (3.0, "region: four numbers"),
    ],
)
def test_a_region_that_is_none(region, message):
    with pytest.raises(BadParameter, match=message):
        grid_of().crop(region)


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


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_what_is_saved_is_loaded_value_for_value(tmp_path, dtype):
    grid = grid_of(LOG_ODDS.astype(dtype), resolution=0.1 + 0.2, anchor=(1 / 3, -1e-5))
    for path in (tmp_path / "map.npz", str(tmp_path / "saved")):
        grid.save_npz(path)
        again = MapGrid.load(path)
        assert again.log_odds.dtype == dtype
        np.testing.assert_array_equal(again.log_odds, grid.log_odds)
        assert (again.resolution, again.anchor, again.offset) == (0.1 + 0.2, (1 / 3, -1e-5), (-2, 4))
        assert (again.epoch, again.revision, again.stamp) == ("", 0, None)


def test_what_cannot_be_loaded_is_told_in_one_line(tmp_path):
    grid_of().save_ros_map(tmp_path / "map.yaml")
    for name, says in (
        ("none.npz", "cannot be read: No such file or directory"),
        ("map.yaml", "not a map that was saved here and can be read"),
        (".", "cannot be read: Is a directory"),
    ):
        with pytest.raises(BadMapFile, match=rf"^{tmp_path / name}: {says}"):
            MapGrid.load(tmp_path / name)


def test_a_map_is_loaded_within_a_limit(tmp_path):
    grid = grid_of()
    grid.save_npz(tmp_path / "map.npz")
    size = grid.log_odds.nbytes
    assert MapGrid.load(tmp_path / "map.npz", max_bytes=size).width == grid.width
    with pytest.raises(BadMapFile, match=f"its cells take {size} bytes, at most {size - 1} are allowed"):
        MapGrid.load(tmp_path / "map.npz", max_bytes=size - 1)


@pytest.mark.parametrize(
    ("given", "name", "suffix"),
    [
        ("a", "a", "yaml"),
        ("a.pgm", "a", "yaml"),
        ("a.yaml", "a", "yaml"),
        ("a.yml", "a", "yml"),
        ("floor.2", "floor.2", "yaml"),
    ],
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
        "width": 2,
        "height": 3,
        "crc32": zlib.crc32((tmp_path / f"{name}.pgm").read_bytes()),
    }
    with Image.open(tmp_path / f"{name}.pgm") as image:
        np.testing.assert_array_equal(np.asarray(image), [[205, 205], [254, 205], [205, 0]])


def test_a_grid_with_a_free_below_of_its_own_keeps_it(tmp_path):
    grid = grid_of(free_below=0.1)
    assert (grid.occupancy == [[-1, 100], [-1, -1], [-1, -1]]).all()
    grid.save_npz(tmp_path / "map.npz")
    grid.save_ros_map(tmp_path / "map")
    for kept in (MapGrid.load(tmp_path / "map.npz"), MapGrid.from_snapshot(grid.to_snapshot())):
        assert kept.free_below == kept.crop((9.5, -18.0, 10.0, -17.0)).free_below == 0.1
    assert yaml.safe_load((tmp_path / "map.yaml").read_text())["free_thresh"] == 0.1
    with Image.open(tmp_path / "map.pgm") as image:
        np.testing.assert_array_equal(np.asarray(image), [[205, 205], [205, 205], [205, 0]])


def test_who_reads_while_a_map_is_saved_gets_a_pair_or_is_told(tmp_path, monkeypatch):
    """After every step of the writing, where it may have been cut off, too: never parts of two maps."""
    full = grid_of(np.random.default_rng(0).normal(0, 3, (40, 40)), resolution=0.1)
    first, second = full.crop((9.8, -18, 12, -15)), full.crop((10.5, -19, 12, -16))
    maps = {grid.origin: grid.occupancy.tolist() for grid in (first, second)}
    path, seen = tmp_path / "hall.yaml", []
    replace = Path.replace

    def looked_at(part, target):
        replace(part, target)
        try:
            ros_map = read_ros_map(path)
        except BadMapFile as error:
            seen.append(str(error))
        else:
            assert ros_map.occupancy.tolist() == maps[ros_map.origin]
            seen.append(ros_map.origin)

    first.save_ros_map(path)
    monkeypatch.setattr(Path, "replace", looked_at)
    for grid in (second, first):
        seen.clear()
        grid.save_ros_map(path)
        between, after = seen
        assert "hall.pgm is not the picture that this file was written with" in between
        assert after == grid.origin


def test_what_is_saved_is_there_whole_or_not_at_all(tmp_path):
    (tmp_path / "hall.pgm").write_bytes(b"before")
    (tmp_path / "hall.yaml").mkdir()
    with pytest.raises(IsADirectoryError):
        grid_of().save_ros_map(tmp_path / "hall.yaml")
    assert (tmp_path / "hall.pgm").read_bytes() == b"before"
    (tmp_path / "hall").mkdir()
    for save in ("save_png", "save_npz"):
        with pytest.raises(IsADirectoryError):
            getattr(grid_of(), save)(tmp_path / "hall")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hall", "hall.pgm", "hall.yaml"]


@pytest.mark.parametrize(
    ("save", "name", "wanted"),
    [("save_png", "a.jpg", "png"), ("save_npz", "a.png", "npz"), ("save_ros_map", "a.JPEG", "yaml")],
)
def test_a_name_that_says_another_format_is_refused(tmp_path, save, name, wanted):
    with pytest.raises(
        BadParameter, match=rf"{name}: a file of this name is no {wanted} file: end it in \.{wanted}"
    ):
        getattr(grid_of(), save)(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_ros_map_needs_a_name_that_its_yaml_can_say(tmp_path):
    with pytest.raises(BadParameter, match="is not UTF-8 text: choose another name"):
        grid_of().save_ros_map(tmp_path / os.fsdecode(b"\xff.yaml"))
    grid_of().save_png(tmp_path / os.fsdecode(b"\xff.png"))
    assert [path.name for path in tmp_path.iterdir()] == [os.fsdecode(b"\xff.png")]


@pytest.mark.parametrize(
    ("save", "names"),
    [("save_png", ["hall"]), ("save_npz", ["hall"]), ("save_ros_map", ["hall.pgm", "hall.yaml"])],
)
def test_a_disk_that_is_full_leaves_what_was_there(tmp_path, disk_full, save, names):
    for name in names:
        (tmp_path / name).write_bytes(b"before")
    with pytest.raises(OSError, match="No space left on device"):
        getattr(grid_of(), save)(tmp_path / "hall")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == dict.fromkeys(names, b"before")


@pytest.mark.parametrize("save", ["save_png", "save_ros_map"])
def test_an_empty_map_has_no_picture(tmp_path, save):
    grid = grid_of(np.empty((0, 0)), offset=(0, 0))
    assert grid.origin == (10.0, -20.0)
    assert math.isnan(grid.at(10.0, -20.0))
    with pytest.raises(MapEmpty):
        getattr(grid, save)(tmp_path / "map")
    assert list(tmp_path.iterdir()) == []


def test_an_empty_map_crops_to_itself():
    part = grid_of(np.empty((0, 0)), offset=(0, 0)).crop((0, 0, 1, 1))
    assert (part.width, part.height, part.offset) == (0, 0, (0, 0))
    with pytest.raises(MapEmpty):
        part.to_png(max_size=10)
