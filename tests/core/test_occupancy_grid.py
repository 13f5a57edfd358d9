"""Maps for ROS 2: the cells of /map.pgm and /map.json, corner for corner, and what changed between two."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import MapEmpty
from ogm_core.files.map_files import encode_json, encode_pgm
from ogm_core.lattice import Lattice, Region
from ogm_core.ros2.cdr import OccupancyGrid, encode_occupancy_grid
from ogm_core.ros2.occupancy_grid import occupancy_grid, same_extents, update_of
from ogm_core.snapshot import MapSnapshot

STAMP = 1_700_000_000_123_456_789
GREYS = {100: 0, 0: 254, -1: 205}


def map_of(cells, model=None, stamp=STAMP):
    model = model or LogOdds("float64")
    cells = CellArrays.of(model, np.asarray(cells, model.dtype))
    return MapSnapshot(cells, model, Lattice(0.05, (-1.5, 2.0)), (-7, 12), "e9", 41, stamp)


def random_map(seed=1, shape=(23, 31)):
    rng = np.random.default_rng(seed)
    return map_of(np.where(rng.random(shape) < 0.7, rng.uniform(-4.0, 4.0, shape), 0.0))


def test_a_cell_is_occupied_free_or_neither_by_the_thresholds_of_the_picture():
    snap = random_map()
    grid = occupancy_grid(snap)
    height, width = grid.data.shape
    pgm = np.frombuffer(encode_pgm(snap)[-height * width :], np.uint8).reshape(height, width)
    assert set(np.unique(grid.data)) == {-1, 0, 100}
    np.testing.assert_array_equal(np.vectorize(GREYS.get)(grid.data), pgm[::-1])  # a picture's row 0 is north


def test_log_odds_beside_the_thresholds():
    # p > 0.65 at 0.6190..., p < 0.196 at -1.4116...
    grid = occupancy_grid(map_of([[0.62, 0.61, -1.41, -1.42, 0.0, -0.0]]))
    assert grid.data.tolist() == [[100, -1, -1, 0, -1, -1]]


def test_probabilities_are_percent_and_unknown_stays_unknown():
    snap = random_map()
    grid = occupancy_grid(snap, "percent")
    assert grid.data.reshape(-1).tolist() == json.loads(encode_json(snap, "m"))["data"]
    assert occupancy_grid(map_of([[0.0, -0.0, 9.0]]), "percent").data.tolist() == [[-1, 50, 100]]


def test_the_origin_is_the_lower_left_corner_of_a_cell():
    grid = occupancy_grid(random_map(), frame="karte")
    assert grid.origin == pytest.approx((-1.5 - 7 * 0.05, 2.0 + 12 * 0.05), abs=1e-12)
    assert (grid.resolution, grid.stamp, grid.frame) == (0.05, STAMP, "karte")
    cut = occupancy_grid(random_map().crop(Region(-1.62, 2.71, -1.0, 3.0)))
    # Outward to edges of cells.
    assert cut.origin == pytest.approx((-1.65, 2.7), abs=1e-12)
    assert cut.data.shape == (6, 13)
    small = occupancy_grid(random_map().shrink(16))
    assert (small.resolution, small.data.shape) == (0.1, (12, 16))


def test_a_reader_gets_the_same_values():
    grid = occupancy_grid(random_map())
    message = get_typestore(Stores.ROS2_LYRICAL)
    read = message.deserialize_cdr(encode_occupancy_grid(grid), "nav_msgs/msg/OccupancyGrid")
    assert (read.header.frame_id, read.header.stamp.sec, read.header.stamp.nanosec) == (
        *("map", STAMP // 10**9),
        STAMP % 10**9,
    )
    info = read.info
    assert (info.width, info.height, info.resolution) == (31, 23, np.float32(0.05))
    assert (info.origin.position.x, info.origin.position.y, info.origin.position.z) == (*grid.origin, 0.0)
    rotation = info.origin.orientation
    assert (rotation.x, rotation.y, rotation.z, rotation.w) == (0.0, 0.0, 0.0, 1.0)
    np.testing.assert_array_equal(read.data.reshape(23, 31), grid.data)


def test_a_map_without_a_scan_has_the_stamp_0_and_an_empty_one_is_none():
    assert occupancy_grid(map_of([[1.0]], stamp=None)).stamp == 0
    with pytest.raises(MapEmpty):
        occupancy_grid(map_of(np.empty((0, 0))))


def grid_of(data, **given):
    values = {"stamp": 1, "frame": "map", "resolution": 0.05, "origin": (0.0, 0.0), "data": data}
    return OccupancyGrid(**values | given)


@given(
    st.integers(1, 8),
    st.integers(1, 8),
    st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7)), max_size=5),
)
def test_an_update_makes_the_new_grid_of_the_old_and_is_as_small_as_can_be(height, width, changes):
    before = np.arange(height * width, dtype=np.int8).reshape(height, width)
    after = before.copy()
    for y, x in changes:
        after[y % height, x % width] = -1
    update = update_of(grid_of(before), grid_of(after, stamp=2))
    changed = {(y % height, x % width) for y, x in changes}
    if not changed:
        assert update is None
        return
    patched = before.copy()
    rows, columns = update.data.shape
    patched[update.y : update.y + rows, update.x : update.x + columns] = update.data
    np.testing.assert_array_equal(patched, after)
    ys, xs = zip(*changed, strict=True)
    assert (update.x, update.y) == (min(xs), min(ys))
    assert (rows, columns) == (max(ys) - min(ys) + 1, max(xs) - min(xs) + 1)
    assert (update.stamp, update.frame) == (2, "map")


@pytest.mark.parametrize(
    "given",
    [
        {"frame": "other"},
        {"resolution": 0.1},
        {"origin": (0.0, 0.05)},
        {"data": np.zeros((3, 2), np.int8)},
    ],
)
def test_a_grid_of_other_extents_is_no_update(given):
    one = grid_of(np.zeros((2, 3), np.int8))
    assert same_extents(one, grid_of(np.ones((2, 3), np.int8), stamp=9))
    other = grid_of(**{"data": one.data} | given)
    assert not same_extents(one, other)
    with pytest.raises(ValueError, match="extents"):
        update_of(one, other)
