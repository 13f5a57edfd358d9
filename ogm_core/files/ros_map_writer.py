"""ROS map writer: the pair that nav2's map_server loads, a PGM picture and the YAML that places it."""

import json

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.classes import FREE_BELOW, OCCUPIED_ABOVE


def write_pgm(grey: NDArray[np.uint8]) -> bytes:
    """Binary PGM (P5) of `grey`: uint8, shape (h, w), row 0 at the top."""
    height, width = grey.shape
    return b"P5\n%d %d\n255\n" % (width, height) + grey.tobytes()


def write_yaml(image_name: str, resolution: float, origin: tuple[float, float]) -> str:
    """Map description for a trinary picture, every number exact.

    Args:
        image_name: the picture's file name, relative to the YAML file.
        resolution: metres per pixel.
        origin: world position of the picture's lower-left corner, m.
    """
    x, y = origin
    lines = (
        f"image: {json.dumps(image_name, ensure_ascii=False)}",
        "mode: trinary",
        f"resolution: {_number(resolution)}",
        f"origin: [{_number(x)}, {_number(y)}, 0.0]",
        "negate: 0",
        f"occupied_thresh: {_number(OCCUPIED_ABOVE)}",
        f"free_thresh: {_number(FREE_BELOW)}",
    )
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    """Shortest text that reads back as `value`; YAML 1.1 takes 1e-05 for a word, but not 1.0e-05."""
    digits, exponent, power = repr(float(value)).partition("e")
    return digits + (".0" if exponent and "." not in digits else "") + exponent + power
