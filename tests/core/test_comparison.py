"""Comparing maps cell by cell: counts, intersections over union, pictures, lattices that are not one."""

import io
import math

import numpy as np
import pytest
from PIL import Image

from ogm_core.cells.log_odds import logit
from ogm_core.errors import BadInput, BadMapFile
from ogm_core.files.map_files import Place, pack
from ogm_core.quality.class_maps import CLASSES, ClassMap, read_class_map
from ogm_core.quality.comparison import compare, encode_difference
from ros_map_files import write_ros_map

UNKNOWN, FREE, UNDECIDED, OCCUPIED = range(4)


def class_map(rows, offset=(0, 0), anchor=(0.0, 0.0), resolution=0.1, name="map"):
    return ClassMap(np.array(rows, np.uint8), Place(resolution, anchor, offset), name)


def naive_cells(first, second):
    """By where the cells' centres are, in the world."""

    def by_place(one):
        (resolution, (x, y), (ix, iy)), found = one.place, {}
        for j, row in enumerate(one.classes.tolist()):
            for i, kind in enumerate(row):
                found[round(x / resolution + ix + i), round(y / resolution + iy + j)] = kind
        return found

    a, b = by_place(first), by_place(second)
    cells = np.zeros((4, 4), int)
    for place in a.keys() | b.keys():
        if a.get(place) == b.get(place) == UNKNOWN or (a.get(place, 0) or b.get(place, 0)):
            cells[a.get(place, UNKNOWN), b.get(place, UNKNOWN)] += 1
    return cells


@pytest.mark.parametrize("shift", [(0, 0), (3, -2), (-20, 1), (500, 0), (2**40, -(2**50))])
def test_cells_are_counted_where_they_lie(shift):
    rng = np.random.default_rng(abs(shift[0]))
    first = class_map(rng.integers(0, 4, (20, 30)), (-5, 7))
    second = class_map(rng.integers(0, 4, (25, 26)), (-5 + shift[0], 7 + shift[1]))
    found = compare(first, second)
    assert np.array_equal(found.cells, naive_cells(first, second))
    assert found.known_in_both == found.cells[1:, 1:].sum()
    assert np.array_equal(compare(second, first).cells, found.cells.T)


def test_shares_in_closed_form():
    first = class_map([[OCCUPIED, OCCUPIED, FREE, FREE, UNKNOWN, UNDECIDED]])
    second = class_map([[OCCUPIED, FREE, FREE, UNKNOWN, OCCUPIED, UNDECIDED]])
    found = compare(first, second)
    assert found.iou(OCCUPIED) == 1 / 3
    assert found.iou(FREE) == 1 / 3
    assert (found.known_in_both, found.alike) == (4, 0.75)
    nothing = compare(class_map([[UNKNOWN]]), class_map([[UNKNOWN]]))
    assert (nothing.iou(FREE), nothing.alike) == (None, None)


def test_lattices_are_one_that_begin_whole_cells_apart():
    first = class_map([[OCCUPIED, FREE]], anchor=(0.2, 0.0))
    second = class_map([[OCCUPIED, FREE]], offset=(2, 0), anchor=(1e-9, 0.0))
    assert compare(first, second).cells[[OCCUPIED, FREE], [OCCUPIED, FREE]].tolist() == [1, 1]
    with pytest.raises(
        BadInput, match=r"b: its cells lie 0\.4 cells in x and 0 in y beside those of a: maps of"
    ):
        compare(class_map([[FREE]], name="a"), class_map([[FREE]], anchor=(0.34, 0.0), name="b"))
    with pytest.raises(
        BadInput, match=r"b: its cells are 0\.05 m, those of a 0\.1 m: maps of one resolution"
    ):
        compare(class_map([[FREE]], name="a"), class_map([[FREE]], resolution=0.05, name="b"))


def test_the_picture_shows_where_they_differ():
    first = class_map([[OCCUPIED, OCCUPIED, UNKNOWN, FREE], [FREE, FREE, UNKNOWN, UNDECIDED]])
    second = class_map([[OCCUPIED, FREE, OCCUPIED, UNKNOWN], [FREE, OCCUPIED, FREE, UNKNOWN]])
    with Image.open(io.BytesIO(encode_difference(first, second))) as picture:
        pixels = np.asarray(picture.convert("RGB"))[::-1]
    black, white, grey = (0,) * 3, (254,) * 3, (205,) * 3
    orange, blue, pale_orange, pale_blue = (213, 94, 0), (0, 114, 178), (245, 210, 180), (176, 214, 238)
    assert [tuple(pixel) for pixel in pixels[0].tolist()] == [black, orange, blue, pale_orange]
    assert [tuple(pixel) for pixel in pixels[1].tolist()] == [white, blue, pale_blue, grey]
    far = class_map([[FREE]], offset=(2**40, 0))
    with pytest.raises(
        BadInput, match=r"map and map together are \d+ x 2 cells: a picture has 1 to 100000000"
    ):
        encode_difference(first, far)


def test_maps_are_read_from_npz_and_from_ros_maps(tmp_path):
    log_odds = np.array(
        [[math.nan, logit(0.1), logit(0.5)], [logit(0.9), logit(0.66), logit(0.2)]], np.float32
    )
    place = {"resolution": np.array(0.1), "anchor": np.array([1.0, 2.0]), "offset": np.array([3, -4])}
    (tmp_path / "map.npz").write_bytes(pack({"log_odds": log_odds, **place}))
    read = read_class_map(tmp_path / "map.npz")
    assert read.classes.tolist() == [[UNKNOWN, FREE, UNDECIDED], [OCCUPIED, OCCUPIED, UNDECIDED]]
    assert (read.place, read.name) == (Place(0.1, (1.0, 2.0), (3, -4)), str(tmp_path / "map.npz"))
    assert CLASSES[read.classes[1, 0]] == "occupied"
    turned = write_ros_map(tmp_path, origin=[0.0, 0.0, 0.1])
    with pytest.raises(BadMapFile, match=r"origin: the map is turned by 0\.1 rad"):
        read_class_map(turned)
