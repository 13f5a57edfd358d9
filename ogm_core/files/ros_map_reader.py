"""ROS map reader: the pair of files that nav2's map_server loads, a YAML description and its picture.

Cells get the values that nav2_map_server gives them (map_io.cpp, loadMapFromFile, of Humble and Jazzy). Keys
that it does not know are passed over, as it does. Colours and alpha are refused: its versions disagree about
them.
"""

import math
import re
import struct
import warnings
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile, UnidentifiedImageError

from ogm_core.cells.classes import FREE, FREE_BELOW, OCCUPIED, OCCUPIED_ABOVE, UNKNOWN
from ogm_core.errors import BadMapFile, BadSetting
from ogm_core.files.strict_yaml import parse_yaml, shown
from ogm_core.lattice import Lattice

MAX_PIXELS = 10**8
"""A larger picture is not decoded."""
MAX_ORIGIN = 1e9
"""Farther from (0, 0), m, float64 no longer places cells exactly."""
_SAVE_AS = "save it as 8-bit grey PNG or binary PGM (P5)"
_EXPONENT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+")
"""Numbers that YAML 1.1 takes for words, and nav2's YAML library for numbers."""
_UNREADABLE = (
    OSError,
    SyntaxError,
    ValueError,
    EOFError,
    LookupError,
    ArithmeticError,
    TypeError,
    struct.error,
    zlib.error,
)
"""What Pillow raises on damaged pictures."""

Greys = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class RosMap:
    """A map as nav2's map_server loads it.

    `occupancy` int8, shape (h, w), [iy, ix], row 0 south: 0 free ... 100 occupied, -1 unknown. `resolution`
    in metres per cell, `origin` the world position of the lower-left corner of cell (0, 0), m.
    """

    occupancy: NDArray[np.int8]
    resolution: float
    origin: tuple[float, float]

    @property
    def lattice(self) -> Lattice:
        """The map's cells in the world."""
        return Lattice(self.resolution, self.origin)

    @property
    def occupied(self) -> NDArray[np.bool_]:
        """Which cells are occupied, p > 0.65."""
        return np.greater(self.occupancy, 100.0 * OCCUPIED_ABOVE)

    @property
    def free(self) -> NDArray[np.bool_]:
        """Which cells are free, p < 0.196."""
        return np.less(self.occupancy, 100.0 * FREE_BELOW) & np.not_equal(self.occupancy, UNKNOWN)


def read_ros_map(path: Path) -> RosMap:
    """Read a map description and the picture that it names, which must lie in its folder or below.

    Raises:
        BadMapFile: one of them cannot be read or is not what is needed; the text names the description, and
            says what to do.
    """
    try:
        fields = _fields(path)
        resolution, origin = _resolution(fields), _origin(fields)
        table = _occupancy_table(fields)
        greys = _read_picture(_picture_path(path, fields.get("image")))
    except BadMapFile as error:
        raise BadMapFile(f"{path}: {error}") from error
    # Pictures begin at the top, north.
    return RosMap(table[greys[::-1]], resolution, origin)


def _fields(path: Path) -> Mapping[str, object]:
    try:
        fields = parse_yaml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadMapFile(f"cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise BadMapFile(f"the YAML file of a map is needed: {error}") from error
    if not isinstance(fields, dict):
        raise BadMapFile(f"a mapping with the keys image, resolution, ... is needed, got {shown(fields)}")
    return fields


def _resolution(fields: Mapping[str, object]) -> float:
    resolution = _number(fields.get("resolution"), "resolution")
    try:
        return Lattice(resolution).resolution
    except BadSetting as error:
        raise BadMapFile(str(error)) from error


def _origin(fields: Mapping[str, object]) -> tuple[float, float]:
    origin = fields.get("origin")
    if not isinstance(origin, list) or len(origin) != 3:
        raise BadMapFile(f"origin: [x, y, yaw] of the lower-left corner is needed, got {shown(origin)}")
    x, y, yaw = (_number(value, "origin") for value in origin)
    for value in (x, y, yaw):
        if not abs(value) <= MAX_ORIGIN:
            raise BadMapFile(
                f"origin: finite numbers of at most {MAX_ORIGIN:g} m are needed, got {shown(value)}"
            )
    if yaw != 0.0:
        raise BadMapFile(f"origin: the map is turned by {yaw:g} rad; turn the picture, and set yaw to 0")
    return x, y


def _occupancy_table(fields: Mapping[str, object]) -> NDArray[np.int8]:
    """Occupancy of every 8-bit grey, int8, shape (256,): the arithmetic of nav2_map_server, in float64."""
    mode, negate = _mode(fields.get("mode", "trinary")), _negate(fields.get("negate"))
    occupied, free = (_number(fields.get(key), key) for key in ("occupied_thresh", "free_thresh"))
    if not 0.0 <= free < occupied <= 1.0:
        raise BadMapFile(
            f"0 <= free_thresh < occupied_thresh <= 1 is needed, got {free:g} and {occupied:g}: correct them"
        )
    grey = np.arange(256)
    shade = grey / 255.0
    occ = shade if negate else 1.0 - shade
    match mode:
        case "raw":
            between = np.where(grey <= OCCUPIED, grey, UNKNOWN)
            return between.astype(np.int8)
        case "scale":
            between = np.rint((occ - free) / (occupied - free) * 100.0)
        case _:
            between = np.full(256, UNKNOWN)
    return np.where(occ > occupied, OCCUPIED, np.where(occ < free, FREE, between)).astype(np.int8)


def _mode(value: object) -> str:
    modes = ("trinary", "scale", "raw")
    if not isinstance(value, str) or value.lower() not in modes:
        raise BadMapFile(f"mode: one of {', '.join(modes)} is needed, got {shown(value)}")
    return value.lower()


def _negate(value: object) -> bool:
    if not isinstance(value, int) or value not in (0, 1):
        raise BadMapFile(f"negate: 0 (white is free) or 1 (black is free) is needed, got {shown(value)}")
    return bool(value)


def _number(value: object, key: str) -> float:
    if isinstance(value, str) and _EXPONENT.fullmatch(value):
        value = float(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadMapFile(f"{key}: a number is needed, got {shown(value)}")
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _picture_path(path: Path, image: object) -> Path:
    if not isinstance(image, str) or not image:
        raise BadMapFile(f"image: the name of the map's picture is needed, got {shown(image)}")
    try:
        folder = path.parent.resolve()
        picture = (folder / image).resolve()
        there = picture.is_file()
    except (OSError, ValueError, RuntimeError) as error:  # a name too long, with a NUL, a ring of links
        raise BadMapFile(
            f"image: {shown(image)} is not a file that can be read ({_reason(error)})"
        ) from error
    if not picture.is_relative_to(folder):
        raise BadMapFile(f"image: {shown(image)} leads out of the folder {folder}: put the picture there")
    if not there:
        raise BadMapFile(f"image: there is no file {shown(image)} in {folder}: put the map's picture there")
    return picture


def _read_picture(path: Path) -> Greys:
    """Greys of an 8-bit PGM or PNG, row 0 at the top."""
    try:
        # Not by its name: Pillow would map the file into memory, and what is cut off meanwhile would end us.
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow's of large pictures: what is too large is decided here
            with Image.open(file, formats=("PPM", "PNG")) as picture:
                _check_picture(picture, path)
                return _greys(picture, path)
    except Image.DecompressionBombError as error:
        raise BadMapFile(_too_large(path)) from error
    except _UNREADABLE as error:
        raise BadMapFile(f"image: {path.name} cannot be read as PGM or PNG ({_reason(error)})") from error


def _check_picture(picture: ImageFile.ImageFile, path: Path) -> None:
    """Refuse, before a pixel is decoded, what is too large or not 8-bit grey."""
    width, height = picture.size
    if width * height > MAX_PIXELS:
        raise BadMapFile(_too_large(path))
    if "transparency" in picture.info or "A" in picture.getbands():
        raise BadMapFile(
            f"image: {path.name} has an alpha channel, on whose meaning readers disagree: {_SAVE_AS}"
        )
    codec, _, offset, layout = picture.tile[0]
    if picture.format == "PPM":
        if picture.mode != "L" or codec != "raw":
            raise BadMapFile(f"image: {path.name} is not a binary PGM (P5) with 255 for white: {_SAVE_AS}")
        there = path.stat().st_size - offset
        if there != width * height:
            raise BadMapFile(
                f"image: {path.name} says {width} x {height} pixels, but {there} bytes follow: copy it again"
            )
    elif picture.mode not in ("1", "L", "P", "RGB") or "16" in str(layout):
        raise BadMapFile(f"image: {path.name} has more than 8 bits a pixel: {_SAVE_AS}")


def _greys(picture: ImageFile.ImageFile, path: Path) -> Greys:
    if picture.mode in ("1", "L"):
        return np.asarray(picture.convert("L"))
    red, green, blue = (np.asarray(band) for band in picture.convert("RGB").split())
    if not (np.array_equal(red, green) and np.array_equal(red, blue)):
        raise BadMapFile(f"image: {path.name} has colours, on whose meaning readers disagree: {_SAVE_AS}")
    return red


def _reason(error: Exception) -> str:
    """Why, without the file's name."""
    if isinstance(error, UnidentifiedImageError):
        return "it begins like neither"
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__


def _too_large(path: Path) -> str:
    return f"image: {path.name} has more than {MAX_PIXELS:.0e} pixels: cut it, or make its cells larger"
