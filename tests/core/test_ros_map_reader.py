"""Maps in nav2's format; the values of cells are checked against a slow twin of nav2_map_server."""

import math
import os
import sys
import zlib
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ogm_core.files import ros_map_reader
from ogm_core.files.ros_map_reader import read_ros_map
from ogm_core.files.ros_map_writer import write_pgm, write_yaml
from ros_map_files import EVERY_GREY, FIELDS, PGM, refusal, write_ros_map


@pytest.fixture
def write(tmp_path):
    """Write a map, as `write_ros_map` does."""
    return partial(write_ros_map, tmp_path)


def naive_occupancy(grey, mode, negate, occupied_thresh, free_thresh):
    """One pixel, step by step as loadMapFromFile of nav2's map_io.cpp goes, in floats of C++."""
    if mode == "raw":
        return grey if grey <= 100 else -1
    one = np.float32(1.0)
    shade = np.float32(grey) / np.float32(255.0)
    occ = shade if negate else one - shade
    if occ <= np.float32(free_thresh):
        return 0
    if occ >= np.float32(occupied_thresh):
        return 100
    if mode == "trinary":
        return -1
    share = (occ - np.float32(free_thresh)) / np.float32(occupied_thresh - free_thresh) * np.float32(100.0)
    return math.floor(float(share) + 0.5)


@pytest.mark.parametrize("thresholds", [(0.65, 0.196), (0.65, 0.25), (1.0, 0.0), (0.5, 0.2), (0.9, 0.1)])
@pytest.mark.parametrize("negate", [0, 1])
@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_every_grey_gets_the_value_that_nav2_gives_it(write, mode, negate, thresholds):
    occupied, free = thresholds
    path = write(mode=mode, negate=negate, occupied_thresh=occupied, free_thresh=free)
    expected = [naive_occupancy(grey, mode, negate, *thresholds) for grey in range(256)]
    assert read_ros_map(path).occupancy[::-1].ravel().tolist() == expected


def test_values_at_the_thresholds():
    """Spot checks that need no twin: 205 is unknown to nav2's own 0.196; a threshold itself counts."""
    table = ros_map_reader._occupancy_table
    trinary = table({"negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196})
    assert [int(trinary[grey]) for grey in (0, 89, 90, 205, 206, 254, 255)] == [100, 100, -1, -1, 0, 0, 0]
    ends = table({"negate": 0, "occupied_thresh": 1.0, "free_thresh": 0.0})
    assert [int(ends[grey]) for grey in (0, 1, 254, 255)] == [100, -1, -1, 0]
    scale = table({"mode": "scale", "negate": 0, "occupied_thresh": 1.0, "free_thresh": 0.0})
    assert [int(scale[grey]) for grey in (0, 127, 191, 254, 255)] == [100, 50, 25, 0, 0]
    raw = table({"mode": "raw", "negate": 1, "occupied_thresh": 0.65, "free_thresh": 0.196})
    assert [int(raw[grey]) for grey in (0, 1, 99, 100, 101, 255)] == [0, 1, 99, 100, -1, -1]


@pytest.mark.parametrize(
    ("grey", "negate", "thresholds", "value"),
    [
        (102, 0, (0.6, 0.2), 100),  # the door of a map: 1 - 102 / 255 is its threshold of 0.6
        (51, 1, (0.65, 0.2), 0),
        (153, 0, (0.4, 0.196), -1),  # 1 - 153 / 255 is 0.4 in float64, and less in float32
    ],
)
def test_a_grey_at_a_threshold_is_decided_in_float32(write, grey, negate, thresholds, value):
    picture = write_pgm(np.array([[grey]], np.uint8))
    path = write(picture, negate=negate, occupied_thresh=thresholds[0], free_thresh=thresholds[1])
    assert read_ros_map(path).occupancy.tolist() == [[value]]


def test_a_map_lies_where_its_file_says(write):
    greys = np.array([[0, 254, 205], [254, 254, 0]], np.uint8)
    ros_map = read_ros_map(write(write_pgm(greys)))
    assert ros_map.occupancy.dtype == np.int8
    assert ros_map.occupancy.tolist() == [[0, 0, 100], [100, 0, -1]], "row 0 is the south edge"
    assert (ros_map.resolution, ros_map.origin) == (0.05, (-1.5, 2.25))
    assert ros_map.lattice.corner_of(2, 1) == (-1.5 + 2 * 0.05, 2.25 + 0.05)


def test_classes_are_those_of_a_served_map(write):
    greys = np.array([[19, 20, 65, 66, 0, 100, 255]], np.uint8)
    ros_map = read_ros_map(write(write_pgm(greys), mode="raw"))
    assert ros_map.occupied.tolist() == [[False, False, False, True, False, True, False]]
    assert ros_map.free.tolist() == [[True, False, False, False, True, False, False]]


def test_what_is_written_is_read(tmp_path):
    greys = np.array([[0, 254, 205, 0]] * 3, np.uint8)
    (tmp_path / "Büro 1.pgm").write_bytes(write_pgm(greys))
    (tmp_path / "map.yaml").write_text(write_yaml("Büro 1.pgm", 0.025, (-1e-05, 1 / 3)), encoding="utf-8")
    ros_map = read_ros_map(tmp_path / "map.yaml")
    assert ros_map.occupancy.tolist() == [[100, 0, -1, 100]] * 3
    assert (ros_map.resolution, ros_map.origin) == (0.025, (-1e-05, 1 / 3))


@pytest.mark.parametrize(
    ("changes", "key", "value"),
    [
        ({"resolution": "5e-2"}, "resolution", 0.05),
        ({"resolution": "1"}, "resolution", 1.0),
        ({"origin": "[-1e-05, 1.5E3, 0]"}, "origin", (-1e-05, 1500.0)),
        ({"origin": "[2, 3, -0.0]"}, "origin", (2.0, 3.0)),
        ({"origin": "[-012, 010, 0]"}, "origin", (-12.0, 10.0)),  # YAML 1.1 has these for octal: -10, 8
        ({"origin": "[08, 1e1, 0]"}, "origin", (8.0, 10.0)),
        ({"origin": "['-012', \"1.5\", '0']"}, "origin", (-12.0, 1.5)),
        ({"resolution": "'0.1'"}, "resolution", 0.1),
        ({"resolution": "+.25"}, "resolution", 0.25),
        ({"origin": "[2, 3, 0.1]"}, "yaw", 0.1),
        ({"origin": "[2, 3, -3.14]"}, "yaw", -3.14),
    ],
)
def test_numbers_are_read_as_nav2_reads_them(write, changes, key, value):
    assert getattr(read_ros_map(write(**changes)), key) == value


@pytest.mark.parametrize(
    "changes",
    [
        {"mode": None},
        {"mode": "Trinary"},
        {"negate": "false"},
        {"negate": "'0'", "occupied_thresh": "'0.65'", "free_thresh": '"0.196"', "mode": "'trinary'"},
        {"cost_scaling": "[1, 2]", "width": "12.5", "height": "wide"},
    ],
    ids=["no mode", "capital", "negate as a word", "quoted", "another program's keys"],
)
def test_what_nav2_takes_is_taken(write, changes):
    expected = read_ros_map(write()).occupancy
    assert np.array_equal(read_ros_map(write(**changes)).occupancy, expected)


def test_negate_as_a_word(write):
    assert np.array_equal(
        read_ros_map(write(negate="yes")).occupancy, read_ros_map(write(negate="1")).occupancy
    )


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        *(({key: None}, f"{key}: ") for key in FIELDS if key != "mode"),
        ({"image": "7"}, "image: the name of the map's picture is needed, got 7"),
        ({"image": "''"}, "image: the name of the map's picture is needed"),
        ({"image": "other.pgm"}, "image: there is no file 'other.pgm' in "),
        ({"image": "."}, "image: there is no file '.' in "),
        ({"image": '"nul\\0byte"'}, "image: "),
        ({"image": "x" * 5000}, "image: "),
        ({"mode": "quaternary"}, "mode: one of trinary, scale, raw is needed, got 'quaternary'"),
        ({"mode": "1"}, "mode: one of trinary, scale, raw is needed, got 1"),
        ({"mode": ""}, "mode: one of trinary, scale, raw is needed, got nothing"),
        ({"resolution": "wide"}, "resolution: a number is needed, got 'wide'"),
        ({"resolution": "true"}, "resolution: a number is needed, got True"),
        ({"resolution": "0"}, "resolution: 0.001 to 1e+06 m is needed, got 0"),
        ({"resolution": "-0.05"}, "resolution: 0.001 to 1e+06 m is needed"),
        ({"resolution": "0.0009"}, "resolution: 0.001 to 1e+06 m is needed"),
        ({"resolution": ".nan"}, "resolution: 0.001 to 1e+06 m is needed, got nan"),
        ({"resolution": "1" + "0" * 400}, "resolution: 0.001 to 1e+06 m is needed, got inf"),
        ({"origin": "[1, 2]"}, "origin: [x, y, yaw] of the lower-left corner is needed, got a list of 2"),
        ({"origin": "0"}, "origin: [x, y, yaw] of the lower-left corner is needed, got 0"),
        ({"origin": "[1, x, 0]"}, "origin: a number is needed, got 'x'"),
        ({"origin": "[1, .inf, 0]"}, "origin: finite numbers of at most 1e+09 m are needed, got inf"),
        ({"origin": "[.nan, 0, 0]"}, "origin: finite numbers"),
        ({"origin": "[0, 0, .nan]"}, "origin: finite numbers"),
        ({"origin": "[0, -1e999, 0]"}, "origin: finite numbers"),
        ({"resolution": "1:30"}, "resolution: a number is needed, got '1:30'"),  # YAML 1.1 has it for 90
        ({"origin": "[1_0, 0, 0]"}, "origin: a number is needed, got '1_0'"),
        ({"negate": "2"}, "negate: 0 (white is free) or 1 (black is free) is needed, got 2"),
        ({"negate": "0.0"}, "negate: 0 (white is free) or 1"),
        ({"occupied_thresh": "high"}, "occupied_thresh: a number is needed, got 'high'"),
        ({"occupied_thresh": "0.1"}, "0 <= free_thresh < occupied_thresh <= 1 is needed, got 0.196 and 0.1"),
        ({"occupied_thresh": "0.196"}, "0 <= free_thresh < occupied_thresh <= 1 is needed"),
        ({"occupied_thresh": "1.1"}, "0 <= free_thresh < occupied_thresh <= 1 is needed"),
        ({"free_thresh": "-0.1"}, "0 <= free_thresh < occupied_thresh <= 1 is needed"),
        ({"free_thresh": ".nan"}, "0 <= free_thresh < occupied_thresh <= 1 is needed"),
        (
            {"free_thresh": "0.2\nfree_thresh: 0.3"},
            "the YAML file of a map is needed: not YAML",
        ),
        ({"origin": "[1, 2"}, "the YAML file of a map is needed: not YAML"),
        ({"negate": "!!bool maybe"}, "the YAML file of a map is needed: not YAML"),
    ],
)
def test_a_description_that_is_wrong_is_refused(write, changes, says):
    text = refusal(write(**changes))
    assert text.startswith(says)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "a mapping with the keys image, resolution, ... is needed, got nothing"),
        (b"- image", "a mapping with the keys image, resolution, ... is needed, got a list of 1"),
        (b"image: \xff", "the YAML file of a map is needed"),
        (PGM, "the YAML file of a map is needed"),
        (b"[" * 2 * sys.getrecursionlimit(), "the YAML file of a map is needed"),
        (None, "cannot be read: No such file or directory"),
    ],
)
def test_a_file_that_is_no_description_is_refused(tmp_path, content, says):
    path = tmp_path / "map.yaml"
    if content is not None:
        path.write_bytes(content)
    assert refusal(path).startswith(says)


@pytest.mark.parametrize(
    "image", ["../map.pgm", "{up}/map.pgm", "link.pgm", "folder/map.pgm", "a/../../map.pgm"]
)
def test_a_picture_is_read_where_the_description_says(tmp_path, image):
    """As map_server does: by an absolute path, out of the folder, through symbolic links."""
    inside = tmp_path / "maps"
    (inside / "a").mkdir(parents=True)
    (tmp_path / "map.pgm").write_bytes(write_pgm(EVERY_GREY))
    (inside / "map.pgm").write_bytes(b"not this one")
    (inside / "link.pgm").symlink_to(tmp_path / "map.pgm")
    (inside / "folder").symlink_to(tmp_path)
    path = inside / "map.yaml"
    path.write_text(write_yaml(image.format(up=tmp_path), 0.05, (0.0, 0.0)))
    told = []
    assert read_ros_map(path, told.append).occupancy.shape == (8, 32)
    (tmp_path / "map.yaml").symlink_to(path)
    if not image.startswith(("..", "a/..", "link", "folder")):
        assert read_ros_map(tmp_path / "map.yaml", told.append).occupancy.shape == (8, 32)
    assert told == []


@pytest.mark.parametrize(
    "image",
    [
        "/home/someone/maps/map.pgm",
        "../elsewhere/map.pgm",
        "file/map.pgm",
        "C:\\maps\\map.pgm",
    ],
)
def test_a_picture_that_is_not_where_the_description_says_is_taken_from_beside_it(tmp_path, image):
    (tmp_path / "map.pgm").write_bytes(write_pgm(EVERY_GREY))
    (tmp_path / "file").write_bytes(b"")
    path = tmp_path / "map.yaml"
    path.write_text(write_yaml(image, 0.05, (0.0, 0.0)))
    told = []
    assert read_ros_map(path, told.append).occupancy.shape == (8, 32)
    (line,) = told
    assert line == f"{path}: image: there is no file {image!r}, so {tmp_path / 'map.pgm'} is taken"
    (tmp_path / "map.pgm").unlink()
    assert refusal(path) == f"image: there is no file {image!r} in {tmp_path}: put the map's picture there"


@pytest.mark.parametrize("image", ["floor/map.pgm", "{here}/floor/map.pgm", "floor/../floor/map.pgm"])
def test_a_picture_below_the_folder_is_read(tmp_path, image, monkeypatch):
    (tmp_path / "floor").mkdir()
    (tmp_path / "floor" / "map.pgm").write_bytes(write_pgm(EVERY_GREY))
    (tmp_path / "map.yaml").write_text(write_yaml(image.format(here=tmp_path), 0.05, (0.0, 0.0)))
    assert read_ros_map(tmp_path / "map.yaml").occupancy.shape == (8, 32)
    monkeypatch.chdir(tmp_path / "floor")
    assert read_ros_map(Path("..") / "map.yaml").occupancy.shape == (8, 32)


def test_a_pipe_is_not_waited_for(write, tmp_path):
    path = write(None)
    os.mkfifo(tmp_path / "map.pgm")
    assert refusal(path).startswith("image: there is no file 'map.pgm'")


def test_a_description_knows_its_own_picture(write):
    """Width, height and CRC-32, as this project writes them; another picture would be placed wrongly."""
    seal = {"width": 32, "height": 8, "crc32": zlib.crc32(PGM)}
    expected = read_ros_map(write()).occupancy
    assert np.array_equal(read_ros_map(write(**seal)).occupancy, expected)
    other = write_pgm(EVERY_GREY[::-1])
    for picture, changes, key in (
        (other, {}, "crc32"),
        (PGM, {"width": 31}, "width"),
        (PGM, {"height": 9}, "height"),
        (write_pgm(EVERY_GREY[1:]), {}, "height"),
        (PGM + b"\n", {}, "crc32"),
    ):
        text = refusal(write(picture, **{**seal, **changes}))
        assert text.startswith(f"image: map.pgm is not the picture that this file was written with ({key} ")
        assert "read them again" in text
        assert "remove the line crc32" in text
    assert read_ros_map(write(other, width=31, height=8)).occupancy.shape == (8, 32), "another program's keys"
    assert refusal(write(crc32="new")) == "width: a number is needed, got nothing"
    assert refusal(write(**{**seal, "crc32": "new"})) == "crc32: a number is needed, got 'new'"


def test_maps_of_the_field(ros_maps):
    """Counts by hand of greys that map_server's YAML files call free, occupied or unknown."""
    found = {}
    for path in sorted(ros_maps.glob("*.yaml")):
        ros_map = read_ros_map(path)
        values, counts = np.unique(ros_map.occupancy, return_counts=True)
        found[path.stem] = dict(zip(values.tolist(), counts.tolist(), strict=True))
        with Image.open(path.with_suffix(".pgm")) as picture:
            assert ros_map.occupancy.shape == picture.size[::-1]
    assert found == {
        "depot": {0: 170587 + 8894, 100: 5947},
        "depot_keepout": {0: 149422 + 4793, 100: 31213},
        "depot_speed": {0: 123746, 20: 4228, 25: 25017, 50: 28702, 100: 3735},
        "tb3_sandbox": {-1: 138683, 0: 7903, 100: 870},
        "warehouse": {-1: 230801, 0: 1318485 + 103807, 100: 30951},
    }
    warehouse = read_ros_map(ros_maps / "warehouse.yaml")
    assert (warehouse.resolution, warehouse.origin) == (0.03, (-15.1, -25.0))


@pytest.mark.parametrize(
    ("name", "free_from", "origin", "yaw"),
    [
        ("f1_gbr", 204, (-50.0, -50.0), 0.0),  # its free_thresh is 0.2, which is grey 204
        ("izs-carpark-top", 206, (0.0, 0.0), 0.0),
        ("stata_basement", 206, (25.9, 48.5), 3.14),
    ],
)
def test_a_race_track_an_alpha_channel_and_a_map_that_is_turned(datasets, name, free_from, origin, yaw):
    ros_map = read_ros_map(datasets / "maps" / f"{name}.yaml")
    with Image.open(datasets / "maps" / f"{name}.png") as picture:
        greys = np.asarray(picture.convert("L"))[::-1]
    assert np.array_equal(ros_map.occupied, greys <= 89)
    assert np.array_equal(ros_map.free, greys >= free_from)
    assert (ros_map.origin, ros_map.yaw) == (origin, yaw)


@pytest.mark.parametrize(("free_thresh", "grey", "told"), [(0.25, 205, 1), (0.196, 205, 0), (0.25, 206, 0)])
def test_much_grey_of_unknown_that_is_free_by_the_thresholds_is_told(tmp_path, free_thresh, grey, told):
    picture = np.full((10, 10), 254, np.uint8)
    picture[:3] = grey
    (tmp_path / "map.pgm").write_bytes(b"P5\n10 10\n255\n" + picture.tobytes())
    (tmp_path / "map.yaml").write_text(
        f"image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\n"
        f"occupied_thresh: 0.65\nfree_thresh: {free_thresh}\n"
    )
    said = []
    read_ros_map(tmp_path / "map.yaml", said.append)
    assert len(said) == told
    assert all("30% of its picture are grey 205" in line and "free_thresh: 0.196" in line for line in said)
