"""Tiles as PNG files: 256 x 256 value bytes behind a palette, where what is unknown is not drawn.

The stream of pixels is the same in every palette: it is packed once, and each palette put before it.
"""

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.value_bytes import COLOURS
from ogm_core.pictures.png import packed, png_of
from ogm_core.tiles.pyramid import PIXELS


def tile_stream(pixels: NDArray[np.uint8]) -> bytes:
    """The stream of a tile's value bytes, [iy, ix], row 0 south: north up."""
    return packed(pixels[::-1])


def tile_png(stream: bytes, palette: str) -> bytes:
    """The PNG of a tile, north up, from what `tile_stream` makes of it."""
    return png_of(PIXELS, PIXELS, [stream], COLOURS[palette], transparent=True)


def _empty_tile() -> bytes:
    rows = np.zeros((PIXELS, PIXELS // 8), np.uint8)
    return png_of(PIXELS, PIXELS, [packed(rows)], np.zeros((1, 3), np.uint8), transparent=True, depth=1)


EMPTY_TILE = _empty_tile()
"""Where nothing was written, the same in every palette: one bit a pixel, none of them drawn."""
