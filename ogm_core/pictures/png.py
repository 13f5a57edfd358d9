"""PNG files of grey pictures, or of bytes with a palette: one deflate stream over unfiltered rows.

ISA-L packs it at memory speed. What a palette is stands before the stream: the same stream does for all.

Source: W3C, Portable Network Graphics (PNG) Specification, 3rd edition, sections 5 (chunks) and 9 (filters).
"""

import struct
from collections.abc import Sequence

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from ogm_core.cells.value_bytes import Colours

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_DEPTH, _GREY, _INDEXED = 8, 0, 3
LEVEL = 1
"""Maps are large flat areas: ISA-L's higher levels take longer and gain little."""


def write_png(
    pixels: NDArray[np.uint8], colours: Colours | None = None, *, transparent: bool = False
) -> bytes:
    """PNG file of `pixels`: uint8, shape (h, w), at least 1 x 1, row 0 at the top.

    8-bit greys, or, with `colours`, bytes that these draw; `transparent`: the byte 0 is not drawn.
    """
    height, width = pixels.shape
    return png_of(width, height, [packed(pixels)], colours, transparent=transparent)


def packed(pixels: NDArray[np.uint8]) -> bytes:
    """The zlib stream of `pixels`, as `png_of` takes it."""
    return isal_zlib.compress(unfiltered(pixels), LEVEL)


def unfiltered(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Rows as the stream has them, shape (h, w + 1): each begins with its filter, 0 for none."""
    height, width = pixels.shape
    rows = np.empty((height, width + 1), np.uint8)
    rows[:, 0] = 0
    rows[:, 1:] = pixels
    return rows


def png_of(
    width: int,
    height: int,
    pixels: Sequence[bytes],
    colours: Colours | None = None,
    *,
    transparent: bool = False,
    depth: int = _DEPTH,
) -> bytes:
    """PNG file of a zlib stream, in pieces, of its rows, each behind a filter byte; see `write_png`.

    Of rows with fewer bits a pixel, 1, 2 or 4, `depth` tells how many; the palette is then as long.
    """
    kind = _GREY if colours is None else _INDEXED
    header = struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0)
    parts = [SIGNATURE, *_chunk(b"IHDR", [header])]
    if colours is not None:
        parts += _chunk(b"PLTE", [colours.tobytes()])
        parts += _chunk(b"tRNS", [b"\x00"]) if transparent else ()
    return b"".join((*parts, *_chunk(b"IDAT", pixels), *_chunk(b"IEND", [])))


def _chunk(kind: bytes, data: Sequence[bytes]) -> tuple[bytes, ...]:
    check = isal_zlib.crc32(kind)
    for piece in data:
        check = isal_zlib.crc32(piece, check)
    return struct.pack(">I", sum(map(len, data))), kind, *data, struct.pack(">I", check)
