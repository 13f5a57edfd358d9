"""PNG files of grey pictures: one deflate stream over unfiltered rows, which ISA-L packs at memory speed.

Source: W3C, Portable Network Graphics (PNG) Specification, 3rd edition, sections 5 (chunks) and 9 (filters).
"""

import struct

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_DEPTH, _GREY = 8, 0
_LEVEL = 1
"""Maps are large flat areas: ISA-L's higher levels take longer and gain little."""


def write_png(grey: NDArray[np.uint8]) -> bytes:
    """PNG file, 8-bit greyscale, of `grey`: uint8, shape (h, w), at least 1 x 1, row 0 at the top."""
    height, width = grey.shape
    rows = np.empty((height, width + 1), np.uint8)
    rows[:, 0] = 0  # every row begins with its filter: none
    rows[:, 1:] = grey
    header = struct.pack(">IIBBBBB", width, height, _DEPTH, _GREY, 0, 0, 0)
    pixels = isal_zlib.compress(rows, _LEVEL)
    return b"".join((SIGNATURE, *_chunk(b"IHDR", header), *_chunk(b"IDAT", pixels), *_chunk(b"IEND", b"")))


def _chunk(kind: bytes, data: bytes) -> tuple[bytes, ...]:
    check = isal_zlib.crc32(data, isal_zlib.crc32(kind))
    return struct.pack(">I", len(data)), kind, data, struct.pack(">I", check)
