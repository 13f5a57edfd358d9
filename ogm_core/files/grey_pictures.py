"""Grey picture reader: the 8-bit PGM and PNG files of ROS maps, and what of them is transparent."""

import io
import struct
import warnings
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile, UnidentifiedImageError

from ogm_core.errors import BadMapFile

MAX_PIXELS = 10**8
"""A larger picture is not decoded."""
_MAX_FILE_BYTES_OF_A_PIXEL = 5
_SAVE_AS = "save it as 8-bit grey PNG or PGM (P5)"
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

Bytes = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class GreyPicture:
    """Greys of a picture, uint8, shape (h, w), row 0 at the top.

    `opaque` tells which pixels are not transparent at all, None if the picture has no transparency. `crc32`
    is that of the file.
    """

    greys: Bytes
    opaque: NDArray[np.bool_] | None
    crc32: int


def read_picture(path: Path, *, transparent_may_be_coloured: bool = True) -> GreyPicture:
    """Read a PGM (P5 or P2) or PNG of 8-bit greys.

    A PNG may be saved as RGB or with a palette, as long as it has no colours. What is transparent in it may
    have any, unless its greys matter.

    Raises:
        BadMapFile: it cannot be read, is something else or too large; the text says what to do.
    """
    try:
        if path.stat().st_size > MAX_PIXELS * _MAX_FILE_BYTES_OF_A_PIXEL:
            raise BadMapFile(_too_large(path))
        # Whole, at once: the file may be replaced, or even cut off, while it is looked at.
        content = path.read_bytes()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow's of large pictures: what is too large is decided here
            with Image.open(io.BytesIO(content), formats=("PPM", "PNG")) as picture:
                _check_picture(picture, path, content)
                greys, opaque = _greys(picture, path, transparent_may_be_coloured)
    except Image.DecompressionBombError as error:
        raise BadMapFile(_too_large(path)) from error
    except _UNREADABLE as error:
        raise BadMapFile(f"image: {path.name} cannot be read as PGM or PNG ({_reason(error)})") from error
    return GreyPicture(greys, opaque, zlib.crc32(content))


def _check_picture(picture: ImageFile.ImageFile, path: Path, content: bytes) -> None:
    """Refuse, before a pixel is decoded, what is too large or not 8-bit grey."""
    width, height = picture.size
    if width * height > MAX_PIXELS:
        raise BadMapFile(_too_large(path))
    codec, _, offset, layout = picture.tile[0]
    if picture.format == "PPM":
        plain = codec == "ppm_plain" and layout == ("L", 255)
        if picture.mode != "L" or not (codec == "raw" or plain):
            raise BadMapFile(f"image: {path.name} is not a PGM (P5 or P2) with 255 for white: {_SAVE_AS}")
        there = len(content) - offset
        # Some programs end the file with a newline, as they do texts.
        if not plain and (there < width * height or content[offset + width * height :].strip()):
            raise BadMapFile(
                f"image: {path.name} says {width} x {height} pixels, but {there} bytes follow: copy it again"
            )
    elif picture.mode not in ("1", "L", "LA", "P", "RGB", "RGBA") or "16" in str(layout):
        raise BadMapFile(f"image: {path.name} has more than 8 bits a pixel: {_SAVE_AS}")


def _greys(
    picture: ImageFile.ImageFile, path: Path, transparent_may_be_coloured: bool
) -> tuple[Bytes, NDArray[np.bool_] | None]:
    opaque = None
    if "transparency" in picture.info or "A" in picture.getbands():
        *colours, alpha = (np.asarray(band) for band in picture.convert("RGBA").split())
        opaque = np.equal(alpha, 255)
    elif picture.mode in ("1", "L"):
        return np.asarray(picture.convert("L")), None
    else:
        colours = [np.asarray(band) for band in picture.convert("RGB").split()]
    red, green, blue = colours
    coloured = (red != green) | (red != blue)
    if opaque is not None and transparent_may_be_coloured:
        coloured &= opaque
    if coloured.any():
        raise BadMapFile(f"image: {path.name} has colours, on whose meaning readers disagree: {_SAVE_AS}")
    return red, opaque


def _reason(error: Exception) -> str:
    """Why, without the file's name."""
    if isinstance(error, UnidentifiedImageError):
        return "it begins like neither"
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__


def _too_large(path: Path) -> str:
    return f"image: {path.name} has more than {MAX_PIXELS:.0e} pixels: cut it, or make its cells larger"
