"""ROS map reader: the pair of files that nav2's map_server loads, a YAML description and its picture.

Cells get the values that nav2_map_server gives them (map_io.cpp, loadMapFromFile, of Jazzy 1.3.7 and later).
Keys that it does not know are passed over, as it does, but for those of `Seal`. Colours are refused: its
versions disagree about them.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.classes import FREE, OCCUPIED, UNKNOWN
from ogm_core.cells.thresholds import FREE_BELOW, OCCUPIED_ABOVE
from ogm_core.errors import BadMapFile, BadSetting
from ogm_core.files.grey_pictures import GreyPicture, read_picture
from ogm_core.files.strict_yaml import NUMBER, parse_yaml, read_text, shown
from ogm_core.lattice import Lattice

MAX_YAML_BYTES = 64 * 1024
"""A longer description is not read: ten lines are needed."""
MAX_ORIGIN = 1e9
"""Farther from (0, 0), m, float64 no longer places cells exactly."""


@dataclass(frozen=True, slots=True, eq=False)
class RosMap:
    """A map as nav2's map_server loads it.

    `occupancy` int8, shape (h, w), [iy, ix], row 0 south: 0 free ... 100 occupied, -1 unknown. `resolution`
    in metres per cell, `origin` the world position of the lower-left corner of cell (0, 0), m. About that
    corner the whole map is turned by `yaw`, rad, counter-clockwise.
    """

    occupancy: NDArray[np.int8]
    resolution: float
    origin: tuple[float, float]
    yaw: float = 0.0

    @property
    def lattice(self) -> Lattice:
        """The map's cells in the world, as they lie before they are turned by `yaw`."""
        return Lattice(self.resolution, self.origin)

    @property
    def occupied(self) -> NDArray[np.bool_]:
        """Which cells are occupied, p > 0.65."""
        return np.greater(self.occupancy, 100.0 * OCCUPIED_ABOVE)

    @property
    def free(self) -> NDArray[np.bool_]:
        """Which cells are free, p < 0.196."""
        return np.less(self.occupancy, 100.0 * FREE_BELOW) & np.not_equal(self.occupancy, UNKNOWN)


_GREY_OF_UNKNOWN = 205
_MUCH = 0.02
"""A share of the picture from which on it is told."""


def read_ros_map(path: Path, tell: Callable[[str], None] = lambda _: None) -> RosMap:
    """Read a map description and the picture that it names.

    `tell` is told, in one line each, where the picture was found if it is not where the description says, and
    if much of it is the grey that mapping programs write for unknown, and yet free by the thresholds.

    Raises:
        BadMapFile: one of them cannot be read or is not what is needed, or they do not belong together; the
            text names the description, and says what to do.
    """
    try:
        fields = _fields(path)
        resolution, (x, y, yaw) = _resolution(fields), _origin(fields)
        table = _occupancy_table(fields)
        file = _picture_path(path, fields.get("image"), tell)
        raw = _mode(fields) == "raw"
        picture = read_picture(file, transparent_may_be_coloured=not raw)
        _check_seal(fields, picture, file)
    except BadMapFile as error:
        raise BadMapFile(f"{path}: {error}") from error
    occupancy = table[picture.greys[::-1]]  # pictures begin at the top, north
    share = np.count_nonzero(picture.greys == _GREY_OF_UNKNOWN) / picture.greys.size
    if share > _MUCH and table[_GREY_OF_UNKNOWN] == 0:
        tell(
            f"{path}: {share:.0%} of its picture are grey {_GREY_OF_UNKNOWN}, which mapping programs write "
            "for unknown, and its free_thresh calls that free: set free_thresh: 0.196 if it is unknown"
        )
    if picture.opaque is not None and not raw:  # whose greys are taken as they are
        occupancy = np.where(picture.opaque[::-1], occupancy, np.int8(UNKNOWN))
    return RosMap(occupancy, resolution, (x, y), yaw)


def _fields(path: Path) -> Mapping[str, object]:
    try:
        fields = parse_yaml(read_text(path, MAX_YAML_BYTES))
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


def _origin(fields: Mapping[str, object]) -> tuple[float, float, float]:
    origin = fields.get("origin")
    if not isinstance(origin, list) or len(origin) != 3:
        raise BadMapFile(f"origin: [x, y, yaw] of the lower-left corner is needed, got {shown(origin)}")
    x, y, yaw = (_number(value, "origin") for value in origin)
    for value in (x, y, yaw):
        if not abs(value) <= MAX_ORIGIN:
            raise BadMapFile(
                f"origin: finite numbers of at most {MAX_ORIGIN:g} m are needed, got {shown(value)}"
            )
    return x, y, yaw


def _occupancy_table(fields: Mapping[str, object]) -> NDArray[np.int8]:
    """Occupancy of every 8-bit grey, int8, shape (256,): the arithmetic of nav2_map_server, in float32."""
    mode, negate = _mode(fields), _negate(fields.get("negate"))
    occupied, free = (_number(fields.get(key), key) for key in ("occupied_thresh", "free_thresh"))
    if not 0.0 <= free < occupied <= 1.0:
        raise BadMapFile(
            f"0 <= free_thresh < occupied_thresh <= 1 is needed, got {free:g} and {occupied:g}: correct them"
        )
    grey = np.arange(256)
    if mode == "raw":
        return np.where(grey <= OCCUPIED, grey, UNKNOWN).astype(np.int8)
    shade = grey.astype(np.float32) / np.float32(255.0)
    occ = shade if negate else np.float32(1.0) - shade
    between = np.full(256, UNKNOWN)
    if mode == "scale":
        share = (occ - np.float32(free)) / np.float32(occupied - free) * np.float32(100.0)
        between = np.trunc(share) + (share - np.trunc(share) >= 0.5)  # halves away from zero
    marked = np.where(occ >= np.float32(occupied), OCCUPIED, between)
    return np.where(occ <= np.float32(free), FREE, marked).astype(np.int8)


def _mode(fields: Mapping[str, object]) -> str:
    modes, value = ("trinary", "scale", "raw"), fields.get("mode", "trinary")
    if not isinstance(value, str) or value.lower() not in modes:
        raise BadMapFile(f"mode: one of {', '.join(modes)} is needed, got {shown(value)}")
    return value.lower()


def _negate(value: object) -> bool:
    words = {"0": 0, "1": 1, "false": 0, "true": 1, "no": 0, "yes": 1}
    plain = words.get(value.lower()) if isinstance(value, str) else value
    if not isinstance(plain, int) or plain not in (0, 1):
        raise BadMapFile(f"negate: 0 (white is free) or 1 (black is free) is needed, got {shown(value)}")
    return bool(plain)


def _number(value: object, key: str) -> float:
    if isinstance(value, str) and NUMBER.fullmatch(value):  # in quotes, which yaml-cpp does not look at
        value = float(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadMapFile(f"{key}: a number is needed, got {shown(value)}")
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _picture_path(path: Path, image: object, tell: Callable[[str], None]) -> Path:
    """The picture where the description says, or else, of the same name, beside the description."""
    if not isinstance(image, str) or not image:
        raise BadMapFile(f"image: the name of the map's picture is needed, got {shown(image)}")
    named = path.parent / image
    beside = path.parent / re.split(r"[/\\]", image)[-1]
    try:
        if named.is_file():
            return named
        if beside.is_file():
            tell(f"{path}: image: there is no file {shown(image)}, so {beside} is taken")
            return beside
    except (OSError, ValueError) as error:  # a name too long
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise BadMapFile(f"image: {shown(image)} is not a file that can be read ({reason})") from error
    folder = path.parent.absolute()
    raise BadMapFile(f"image: there is no file {shown(image)} in {folder}: put the map's picture there")


def _check_seal(fields: Mapping[str, object], picture: GreyPicture, file: Path) -> None:
    """Refuse a picture that is not the one that its description was written with (see `Seal`)."""
    if "crc32" not in fields:
        return
    height, width = picture.greys.shape
    for key, found in (("width", width), ("height", height), ("crc32", picture.crc32)):
        wanted = _number(fields.get(key), key)
        if wanted != found:
            raise BadMapFile(
                f"image: {file.name} is not the picture that this file was written with ({key} {found}, not "
                f"{wanted:.0f}): if they were just being written, read them again; if the picture was "
                "edited, remove the line crc32"
            )
