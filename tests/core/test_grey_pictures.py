"""Pictures of ROS maps: which are read, what is transparent in them, and what is refused."""

import io
import struct
import zlib
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ogm_core.errors import BadMapFile
from ogm_core.files import grey_pictures
from ogm_core.files.ros_map_reader import read_ros_map
from ros_map_files import EVERY_GREY, PGM, png, refusal, write_ros_map


@pytest.fixture
def write(tmp_path):
    """Write a map, as `write_ros_map` does."""
    return partial(write_ros_map, tmp_path)


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_header(width, height, *, bits=8, colour=0):
    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header)


@pytest.mark.parametrize(
    "picture",
    [
        png(EVERY_GREY),
        png(EVERY_GREY, interlace=1),
        png(np.repeat(EVERY_GREY[..., None], 3, axis=2)),
        b"P5 # made by hand\n# CREATOR: someone\n32\n8\n255\n" + EVERY_GREY.tobytes(),
        PGM + b"\n",
        PGM + b"\r\n",
        b"P2\n# CREATOR: GIMP\n32 8\n255\n" + "\n".join(map(str, range(256))).encode() + b"\n",
        b"P2 32 8 255 " + " ".join(map(str, range(256))).encode(),
    ],
    ids=[
        *("grey PNG", "interlaced", "RGB without colours", "PGM with comments", "trailing newline"),
        *("trailing CR and newline", "PGM as text", "PGM as text, one line"),
    ],
)
def test_pictures_that_are_grey_are_read(write, picture):
    path = write(picture, mode="raw")
    expected = np.where(EVERY_GREY <= 100, EVERY_GREY.astype(int), -1)[::-1]
    assert np.array_equal(read_ros_map(path).occupancy, expected)


@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_what_is_transparent_is_unknown(write, mode):
    """In any degree; of what is opaque the grey counts. Mode raw takes greys as they are."""
    greys, alpha = (np.array([row], np.uint8) for row in ([0, 0, 0, 254, 254], [255, 254, 0, 255, 128]))
    expected = [[0, 0, 0, -1, -1]] if mode == "raw" else [[100, -1, -1, 0, -1]]
    pictures = [png(np.dstack([greys, alpha])), png(np.dstack([greys, greys, greys, alpha]))]
    if mode != "raw":
        red = greys + np.where(alpha < 255, 9, 0).astype(np.uint8)  # nobody sees these colours
        pictures.append(png(np.dstack([red, greys, greys, alpha])))
    for picture in pictures:
        assert read_ros_map(write(picture, mode=mode)).occupancy.tolist() == expected
    opaque = png(np.dstack([EVERY_GREY] * 3 + [np.full_like(EVERY_GREY, 255)]))
    expected = read_ros_map(write(mode=mode)).occupancy
    assert np.array_equal(read_ros_map(write(opaque, mode=mode)).occupancy, expected)


def test_a_grey_or_an_entry_of_a_palette_may_be_transparent(write):
    two = np.array([[0, 254, 254]], np.uint8)
    for picture in (png(two, transparency=0), png(np.dstack([two] * 3), transparency=(0, 0, 0))):
        assert read_ros_map(write(picture)).occupancy.tolist() == [[-1, 0, 0]]
    palette = Image.fromarray(np.array([[0, 1, 1]], np.uint8), "P")
    palette.putpalette([0, 0, 0, 254, 254, 254])
    file = io.BytesIO()
    palette.save(file, "PNG", transparency=0)
    assert read_ros_map(write(file.getvalue())).occupancy.tolist() == [[-1, 0, 0]]


def test_a_png_of_two_greys_or_a_grey_palette_is_read(write):
    two = Image.fromarray(np.array([[0, 255, 255]], np.uint8)).convert("1", dither=Image.Dither.NONE)
    four = Image.fromarray(np.array([[0, 1, 2]], np.uint8), "P")
    four.putpalette([0, 0, 0, 254, 254, 254, 205, 205, 205])
    for picture, expected in ((two, [[100, 0, 0]]), (four, [[100, 0, -1]])):
        file = io.BytesIO()
        picture.save(file, "PNG")
        assert read_ros_map(write(file.getvalue())).occupancy.tolist() == expected


GREY = EVERY_GREY[:2, :3].copy()


NO_PGM = "map.pgm is not a PGM (P5 or P2) with 255 for white: save it as 8-bit grey PNG or PGM (P5)"


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
        (b"P5\n3 2\n255\n123456\n7", "map.pgm says 3 x 2 pixels, but 8 bytes follow"),
        (b"P2\n3 2\n15\n1 2 3 4 5 6\n", NO_PGM),
        (b"P2\n3 2\n255\n1 2 3 4 5\n", "map.pgm cannot be read"),
        (b"P2\n3 2\n255\n1 2 3 4 5 256\n", "map.pgm cannot be read"),
        (b"P2\n3 2\n255\n1 2 3 4 5 x\n", "map.pgm cannot be read"),
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
        (png(np.dstack([GREY, GREY, GREY + 1])), "map.pgm has colours, on whose meaning readers disagree"),
        (png(np.dstack([GREY, GREY, GREY + 1, GREY | 255])), "map.pgm has colours"),
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


def test_a_palette_with_colours_is_refused(write):
    picture = Image.fromarray(np.array([[0, 1]], np.uint8), "P")
    picture.putpalette([0, 0, 0, 254, 0, 254])
    file = io.BytesIO()
    picture.save(file, "PNG")
    assert "has colours" in refusal(write(file.getvalue()))


def test_colours_that_are_transparent_matter_where_greys_are_taken_as_they_are(write):
    picture = png(np.dstack([GREY, GREY, GREY + 1, GREY * 0]))
    assert (read_ros_map(write(picture)).occupancy == -1).all()
    assert "has colours" in refusal(write(picture, mode="raw"))


def test_pictures_as_large_as_allowed_are_read_without_a_warning(write, monkeypatch):
    """Pillow warns above its own limit, and refuses above twice that; the limit here lies between."""
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 200)
    monkeypatch.setattr(grey_pictures, "MAX_PIXELS", 256)
    assert read_ros_map(write()).occupancy.size == 256
    monkeypatch.setattr(grey_pictures, "MAX_PIXELS", 255)
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
