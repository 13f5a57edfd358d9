"""ROS map writer: the pair that nav2's map_server loads, a PGM picture and the YAML that places it."""

import json
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.classes import GREY_FREE, GREY_UNKNOWN
from ogm_core.cells.thresholds import FREE_BELOW, OCCUPIED_ABOVE


def write_pgm(grey: NDArray[np.uint8]) -> bytes:
    """Binary PGM (P5) of `grey`: uint8, shape (h, w), row 0 at the top."""
    height, width = grey.shape
    return b"P5\n%d %d\n255\n" % (width, height) + grey.tobytes()


class Seal(NamedTuple):
    """What tells a description's own picture from another map's: pixels a row, rows, CRC-32 of the file.

    map_server passes over these keys; `read_ros_map` refuses a picture that does not agree with them. They
    may have been written one after the other while somebody read.
    """

    width: int
    height: int
    crc32: int


def write_yaml(
    image_name: str,
    resolution: float,
    origin: tuple[float, float],
    seal: Seal | None = None,
    free_below: float = FREE_BELOW,
) -> str:
    """Map description for a trinary picture, every number exact.

    Args:
        image_name: the picture's file name, relative to the YAML file.
        resolution: metres per pixel.
        origin: world position of the picture's lower-left corner, m.
        seal: of the picture; without one, any picture is taken for it.
        free_below: the map's own; what is written is limited to what leaves white free and 205 unknown.
    """
    x, y = origin
    white, unknown = (1.0 - grey / 255.0 for grey in (GREY_FREE, GREY_UNKNOWN))
    free = free_below if white < free_below < unknown else FREE_BELOW
    lines = (
        f"image: {json.dumps(image_name, ensure_ascii=False)}",
        "mode: trinary",
        f"resolution: {_number(resolution)}",
        f"origin: [{_number(x)}, {_number(y)}, 0.0]",
        "negate: 0",
        f"occupied_thresh: {_number(OCCUPIED_ABOVE)}",
        f"free_thresh: {_number(free)}",
        *(f"{key}: {value}" for key, value in (seal._asdict() if seal else {}).items()),
    )
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    """Shortest text that reads back as `value`; YAML 1.1 takes 1e-05 for a word, but not 1.0e-05."""
    digits, exponent, power = repr(float(value)).partition("e")
    return digits + (".0" if exponent and "." not in digits else "") + exponent + power
