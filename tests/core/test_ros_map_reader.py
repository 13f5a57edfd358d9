"""Maps in nav2's format; the values of cells are checked against a slow twin of nav2_map_server."""

import io
import os
import struct
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ogm_core.errors import BadMapFile
from ogm_core.files import ros_map_reader
from ogm_core.files.ros_map_reader import read_ros_map
from ogm_core.files.ros_map_writer import write_pgm, write_yaml

EVERY_GREY = np.arange(256, dtype=np.uint8).reshape(8, 32)
PGM = write_pgm(EVERY_GREY)
FIELDS = {
    "image": "map.pgm",
    "mode": "trinary",
    "resolution": "0.05",
    "origin": "[-1.5, 2.25, 0.0]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}


@pytest.fixture
def write(tmp_path):
    """Write map.yaml, with `changes` of its fields (None leaves one out), and its picture."""

    def write(picture=PGM, **changes):
        fields = {key: value for key, value in {**FIELDS, **changes}.items() if value is not None}
        path = tmp_path / "map.yaml"
        path.write_text("".join(f"{key}: {value}\n" for key, value in fields.items()), encoding="utf-8")
        if picture is not None:
            (tmp_path / "map.pgm").write_bytes(picture)
        return path

    return write


def png(array, mode=None, **options):
    file = io.BytesIO()
    Image.fromarray(array, mode).save(file, "PNG", **options)
    return file.getvalue()


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_header(width, height, *, bits=8, colour=0):
    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header)


def naive_occupancy(grey, mode, negate, occupied_thresh, free_thresh):
    """One pixel, step by step as loadMapFromFile of nav2's map_io.cpp goes."""
    shade = float(grey) / 255.0
    occ = shade if negate else 1.0 - shade
    if mode == "raw":
        percent = round(shade * 255)
        return percent if 0 <= percent <= 100 else -1
    if occupied_thresh < occ:
        return 100
    if occ < free_thresh:
        return 0
    if mode == "trinary":
        return -1
    return round((occ - free_thresh) / (occupied_thresh - free_thresh) * 100.0)


@pytest.mark.parametrize("thresholds", [(0.65, 0.196), (0.65, 0.25), (1.0, 0.0), (0.5, 0.2), (0.9, 0.1)])
@pytest.mark.parametrize("negate", [0, 1])
@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_every_grey_gets_the_value_that_nav2_gives_it(write, mode, negate, thresholds):
    occupied, free = thresholds
    path = write(mode=mode, negate=negate, occupied_thresh=occupied, free_thresh=free)
    expected = [naive_occupancy(grey, mode, negate, *thresholds) for grey in range(256)]
    assert read_ros_map(path).occupancy[::-1].ravel().tolist() == expected


def test_values_at_the_thresholds():
    """Spot checks that need no twin: 205 is unknown to nav2's own 0.196; a threshold itself is not passed."""
    table = ros_map_reader._occupancy_table
    trinary = table({"negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196})
    assert [int(trinary[grey]) for grey in (0, 89, 90, 205, 206, 254, 255)] == [100, 100, -1, -1, 0, 0, 0]
    strict = table({"negate": 0, "occupied_thresh": 1.0, "free_thresh": 0.0})
    assert set(strict.tolist()) == {-1}, "occupied is above its threshold, free below"
    scale = table({"mode": "scale", "negate": 0, "occupied_thresh": 1.0, "free_thresh": 0.0})
    assert [int(scale[grey]) for grey in (0, 127, 191, 254, 255)] == [100, 50, 25, 0, 0]
    raw = table({"mode": "raw", "negate": 1, "occupied_thresh": 0.65, "free_thresh": 0.196})
    assert [int(raw[grey]) for grey in (0, 1, 99, 100, 101, 255)] == [0, 1, 99, 100, -1, -1]


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
    "picture",
    [
        png(EVERY_GREY),
        png(EVERY_GREY, interlace=1),
        png(np.repeat(EVERY_GREY[..., None], 3, axis=2)),
        b"P5 # made by hand\n# CREATOR: someone\n32\n8\n255\n" + EVERY_GREY.tobytes(),
    ],
    ids=["grey PNG", "interlaced", "RGB without colours", "PGM with comments"],
)
def test_pictures_that_are_grey_are_read(write, picture):
    path = write(picture, mode="raw")
    expected = np.where(EVERY_GREY <= 100, EVERY_GREY.astype(int), -1)[::-1]
    assert np.array_equal(read_ros_map(path).occupancy, expected)


def test_a_png_of_two_greys_or_a_grey_palette_is_read(write):
    two = Image.fromarray(np.array([[0, 255, 255]], np.uint8)).convert("1", dither=Image.Dither.NONE)
    four = Image.fromarray(np.array([[0, 1, 2]], np.uint8), "P")
    four.putpalette([0, 0, 0, 254, 254, 254, 205, 205, 205])
    for picture, expected in ((two, [[100, 0, 0]]), (four, [[100, 0, -1]])):
        file = io.BytesIO()
        picture.save(file, "PNG")
        assert read_ros_map(write(file.getvalue())).occupancy.tolist() == expected


@pytest.mark.parametrize(
    ("changes", "key", "value"),
    [
        ({"resolution": "5e-2"}, "resolution", 0.05),
        ({"resolution": "1"}, "resolution", 1.0),
        ({"origin": "[-1e-05, 1.5E3, 0]"}, "origin", (-1e-05, 1500.0)),
        ({"origin": "[2, 3, -0.0]"}, "origin", (2.0, 3.0)),
    ],
)
def test_numbers_are_read_as_nav2_reads_them(write, changes, key, value):
    assert getattr(read_ros_map(write(**changes)), key) == value


@pytest.mark.parametrize(
    "changes",
    [{"mode": None}, {"mode": "Trinary"}, {"negate": "false"}, {"cost_scaling": "[1, 2]"}],
    ids=["no mode", "capital", "negate as a word", "another program's key"],
)
def test_what_nav2_takes_is_taken(write, changes):
    expected = read_ros_map(write()).occupancy
    assert np.array_equal(read_ros_map(write(**changes)).occupancy, expected)


def test_negate_as_a_word(write):
    assert np.array_equal(
        read_ros_map(write(negate="yes")).occupancy, read_ros_map(write(negate="1")).occupancy
    )


def refusal(path):
    """The text of the refusal, which names the file, in one line."""
    with pytest.raises(BadMapFile) as caught:
        read_ros_map(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    assert len(text) < 600 + len(str(path))
    return text.removeprefix(f"{path}: ")


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        *(({key: None}, f"{key}: ") for key in FIELDS if key != "mode"),
        ({"image": "7"}, "image: the name of the map's picture is needed, got 7"),
        ({"image": "''"}, "image: the name of the map's picture is needed"),
        ({"image": "other.pgm"}, "image: there is no file 'other.pgm' in "),
        ({"image": "."}, "image: there is no file '.' in "),
        ({"image": '"nul\\0byte"'}, "image: 'nul\\x00byte' is not a file that can be read"),
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
        (
            {"origin": "[0, 0, 0.1]"},
            "origin: the map is turned by 0.1 rad; turn the picture, and set yaw to 0",
        ),
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
def test_a_picture_outside_the_folder_is_not_read(tmp_path, image):
    inside = tmp_path / "maps"
    inside.mkdir()
    (inside / "a").mkdir()
    (tmp_path / "map.pgm").write_bytes(write_pgm(EVERY_GREY))
    (inside / "link.pgm").symlink_to(tmp_path / "map.pgm")
    (inside / "folder").symlink_to(tmp_path)
    path = inside / "map.yaml"
    path.write_text(write_yaml(image.format(up=tmp_path), 0.05, (0.0, 0.0)))
    assert "leads out of the folder" in refusal(path)


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


GREY = EVERY_GREY[:2, :3].copy()
ALPHA = "map.pgm has an alpha channel"
NO_PGM = "map.pgm is not a binary PGM (P5) with 255 for white: save it as 8-bit grey PNG or binary PGM (P5)"


@pytest.mark.parametrize(
    ("picture", "says"),
    [
        (b"", "map.pgm cannot be read as PGM or PNG"),
        (b"just words", "map.pgm cannot be read as PGM or PNG"),
        (b"P5\n3 2\n255\n12345", "map.pgm says 3 x 2 pixels, but 5 bytes follow: copy it again"),
        (b"P5\n3 2\n255\n1234567", "map.pgm says 3 x 2 pixels, but 7 bytes follow"),
        (b"P5\n3 2\n255\n", "map.pgm says 3 x 2 pixels, but 0 bytes follow"),
        (b"P5\n3 2\n", "map.pgm cannot be read"),
        (b"P5\n0 2\n255\n", "map.pgm cannot be read"),
        (b"P5\n-3 -2\n255\n123456", "map.pgm cannot be read"),
        (b"P5\nx y\n255\n123456", "map.pgm cannot be read"),
        (b"P5\n3 2\n65535\n" + bytes(12), NO_PGM),
        (b"P5\n3 2\n256\n" + bytes(12), NO_PGM),
        (b"P5\n3 2\n100\n123456", NO_PGM),
        (b"P2\n3 2\n255\n1 2 3 4 5 6\n", NO_PGM),
        (b"P6\n1 2\n255\n123456", NO_PGM),
        (b"P4\n3 2\n12", NO_PGM),
        (b"P5\n10001 10000\n255\n", "map.pgm has more than 1e+08 pixels: cut it"),
        (b"P5\n1000000000 1000000000\n255\n", "map.pgm has more than 1e+08 pixels"),
        (png_header(20000, 20000) + chunk(b"IDAT", zlib.compress(bytes(100))), "map.pgm has more than 1e+08"),
        (png_header(10**5, 10**5) + chunk(b"IDAT", b""), "map.pgm has more than 1e+08 pixels"),
        (png_header(0, 5) + chunk(b"IDAT", b""), "map.pgm cannot be read"),
        (png_header(5, 5), "map.pgm cannot be read"),
        (png_header(5, 5) + chunk(b"IDAT", b"no zlib stream"), "map.pgm cannot be read"),
        (png(GREY)[:-30], "map.pgm cannot be read"),
        (png(GREY)[:45], "map.pgm cannot be read"),
        (png(np.dstack([GREY, GREY])), ALPHA),
        (png(np.dstack([GREY] * 4)), ALPHA),
        (png(GREY, transparency=0), ALPHA),
        (png(np.dstack([GREY] * 3), transparency=(1, 2, 3)), ALPHA),
        (png(np.dstack([GREY, GREY, GREY + 1])), "map.pgm has colours, on whose meaning readers disagree"),
        (png(GREY.astype(np.uint16)), "map.pgm has more than 8 bits a pixel"),
        (
            png_header(1, 1, bits=16, colour=2)
            + chunk(b"IDAT", zlib.compress(bytes(7)))
            + chunk(b"IEND", b""),
            "map.pgm has more than 8 bits a pixel",
        ),
        (Path(__file__).read_bytes(), "map.pgm cannot be read"),
    ],
)
def test_a_picture_that_is_wrong_is_refused(write, picture, says):
    assert refusal(write(picture)).startswith(f"image: {says}")


def test_a_jpeg_is_refused(write):
    file = io.BytesIO()
    Image.fromarray(EVERY_GREY).save(file, "JPEG")
    assert refusal(write(file.getvalue())).startswith("image: map.pgm cannot be read as PGM or PNG")


def test_a_palette_with_colours_or_with_transparency_is_refused(write):
    picture = Image.fromarray(np.array([[0, 1]], np.uint8), "P")
    picture.putpalette([0, 0, 0, 254, 0, 254])
    for options, says in (({}, "has colours"), ({"transparency": 1}, "has an alpha channel")):
        file = io.BytesIO()
        picture.save(file, "PNG", **options)
        assert says in refusal(write(file.getvalue()))


def test_pictures_as_large_as_allowed_are_read_without_a_warning(write, monkeypatch):
    """Pillow warns above its own limit, and refuses above twice that; the limit here lies between."""
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 200)
    monkeypatch.setattr(ros_map_reader, "MAX_PIXELS", 256)
    assert read_ros_map(write()).occupancy.size == 256
    monkeypatch.setattr(ros_map_reader, "MAX_PIXELS", 255)
    assert "pixels" in refusal(write())
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    assert "pixels" in refusal(write())


@pytest.mark.parametrize("picture", [png(EVERY_GREY), PGM], ids=["png", "pgm"])
def test_damaged_pictures_are_read_or_refused(write, picture):
    """A byte changed or a part cut out at random: never anything but a picture or a BadMapFile."""
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(300):
        damaged = bytearray(picture)
        if rng.random() < 0.3:
            first = int(rng.integers(0, len(damaged)))
            del damaged[first : first + int(rng.integers(1, 40))]
        for _ in range(int(rng.integers(0, 3))):
            damaged[int(rng.integers(0, min(80, len(damaged))))] = int(rng.integers(0, 256))
        try:
            read_ros_map(write(bytes(damaged)))
        except BadMapFile:
            refused += 1
    assert refused > 50


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
