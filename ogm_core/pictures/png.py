"""PNG files of grey pictures: one deflate stream over unfiltered rows, which ISA-L packs at memory speed.

Source: W3C, Portable Network Graphics (PNG) Specification, 3rd edition, sections 5 (chunks) and 9 (filters).
"""

import struct
from collections.abc import Sequence

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_DEPTH, _GREY = 8, 0
LEVEL = 1
"""Maps are large flat areas: ISA-L's higher levels take longer and gain little."""


def write_png(grey: NDArray[np.uint8]) -> bytes:
    """PNG file, 8-bit greyscale, of `grey`: uint8, shape (h, w), at least 1 x 1, row 0 at the top."""
    height, width = grey.shape
    return png_of(width, height, [isal_zlib.compress(unfiltered(grey), LEVEL)])


def unfiltered(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Rows as the stream has them, shape (h, w + 1): each begins with its filter, 0 for none."""
    height, width = grey.shape
    rows = np.empty((height, width + 1), np.uint8)
    rows[:, 0] = 0
    rows[:, 1:] = grey
    return rows


def png_of(width: int, height: int, pixels: Sequence[bytes]) -> bytes:
    """PNG file, 8-bit greyscale, of a zlib stream, in pieces, of its rows, each behind a filter byte."""
    header = struct.pack(">IIBBBBB", width, height, _DEPTH, _GREY, 0, 0, 0)
    return b"".join((SIGNATURE, *_chunk(b"IHDR", [header]), *_chunk(b"IDAT", pixels), *_chunk(b"IEND", [])))


def _chunk(kind: bytes, data: Sequence[bytes]) -> tuple[bytes, ...]:
    check = isal_zlib.crc32(kind)
    for piece in data:
        check = isal_zlib.crc32(piece, check)
    return struct.pack(">I", sum(map(len, data))), kind, *data, struct.pack(">I", check)
