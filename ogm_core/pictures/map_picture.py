"""Picture of a live map as PNG: after a scan only the rows of tiles are packed again that it has changed.

Each row of tiles is a finished piece of the deflate stream, a strip. It ends with a full flush, so it neither
refers to what stands before it nor leaves bits over, and strips can stand in any order (P. Deutsch: RFC 1951,
sections 2 and 3.2.4). The check sum of all rows is put together from those of the strips.
"""

import threading
from typing import NamedTuple

import numpy as np
from isal import isal_zlib

from ogm_core.cells.model import Encoder
from ogm_core.cells.value_bytes import Colours
from ogm_core.lattice import CellRect
from ogm_core.pictures.png import LEVEL, png_of, unfiltered, write_png
from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.halved import tiled
from ogm_core.tiles.store import TILE
from ogm_core.tiles.view import TiledCells, TiledView

_ZLIB_HEADER = b"\x78\x01"
_LAST_BLOCK = b"\x01\x00\x00\xff\xff"
_ADLER = 65521


class Strip(NamedTuple):
    """Rows as a piece of a picture's stream: of which cells; the bytes; check and size of the rows."""

    of: tuple[object, ...]
    piece: bytes
    check: int
    size: int


class MapPicture:
    """The picture of a map by one encoder, of one revision after the other.

    Who owns what: all of it belongs to the caller of `png`, one at a time; `let_go` only replaces the strips.
    """

    def __init__(self, encoder: Encoder) -> None:
        """Begin a picture whose pixels `encoder` makes, uint8: greys, or bytes for palettes of colours."""
        self._encoder = encoder
        self._lock = threading.Lock()
        self._lineage: object = None
        self._strips: dict[int, Strip] = {}
        """By row of tiles of the lattice."""
        self.nbytes = 0
        """What the strips take."""

    def let_go(self) -> None:
        """Keep no strips; any thread. Those of a picture that is being made are kept again."""
        self._strips, self.nbytes = {}, 0

    def png(
        self, snapshot: MapSnapshot, colours: Colours | None = None, *, transparent: bool = False
    ) -> bytes:
        """PNG of a snapshot with at least one cell, north up; of any revision, the newest are quick.

        Greys, or bytes that `colours` draw; `transparent`: the byte 0 is not drawn.
        """
        view = tiled(snapshot.stored)
        if view is None:
            pixels = snapshot.encode(self._encoder)[::-1]
            return write_png(pixels, colours, transparent=transparent)
        with self._lock:
            if view.tiles.lineage is not self._lineage:  # of another store: equal numbers are other cells
                self._lineage, self._strips = view.tiles.lineage, {}
            south, north = view.rect.iy // TILE, (view.rect.iy + view.rect.height - 1) // TILE
            self._strips = {ty: self._strip(snapshot, view, ty) for ty in range(north, south - 1, -1)}
            strips = list(self._strips.values())
            self.nbytes = sum(len(strip.piece) for strip in strips)
        check = combined([(strip.check, strip.size) for strip in strips]).to_bytes(4)
        pieces = [_ZLIB_HEADER, *(strip.piece for strip in strips), _LAST_BLOCK, check]
        return png_of(snapshot.width, snapshot.height, pieces, colours, transparent=transparent)

    def _strip(self, snapshot: MapSnapshot, view: TiledView, ty: int) -> Strip:
        """The rows of the snapshot that lie in this row of tiles: those of before, if they are the same."""
        rect = view.rect
        south, north = max(rect.iy, ty * TILE), min(rect.iy + rect.height, (ty + 1) * TILE)
        around = _tiles_around(CellRect(rect.ix, south, rect.width, north - south), snapshot.model.margin)
        of = (rect.ix, rect.width, south, north, _numbers(view.tiles, around))
        before = self._strips.get(ty)
        if before is not None and before.of == of:
            return before
        pixels = snapshot.encode(self._encoder, slice(south - rect.iy, north - rect.iy))[::-1]
        rows = unfiltered(pixels)
        packer = isal_zlib.compressobj(LEVEL, isal_zlib.DEFLATED, -isal_zlib.MAX_WBITS)
        piece = packer.compress(rows) + packer.flush(isal_zlib.Z_FULL_FLUSH)
        return Strip(of, piece, isal_zlib.adler32(rows), rows.nbytes)


def _tiles_around(part: CellRect, margin: int) -> tuple[slice, slice]:
    """Columns and rows of tiles, of the lattice, that the pixels of a part depend on."""
    west, south = (part.ix - margin) // TILE, (part.iy - margin) // TILE
    east, north = -(-(part.ix + part.width + margin) // TILE), -(-(part.iy + part.height + margin) // TILE)
    return slice(west, east), slice(south, north)


def _numbers(tiles: TiledCells, around: tuple[slice, slice]) -> bytes:
    """The numbers of these tiles, 0 where the store has none: equal numbers are equal cells."""
    first = tiles.rect.ix // TILE, tiles.rect.iy // TILE
    found = np.zeros([part.stop - part.start for part in around], np.int64)
    here, there = [], []
    for part, begin, count in zip(around, first, tiles.numbers.shape, strict=True):
        low, high = max(part.start, begin), min(part.stop, begin + count)
        here.append(slice(low - part.start, max(high, low) - part.start))
        there.append(slice(low - begin, max(high, low) - begin))
    found[tuple(here)] = tiles.numbers[tuple(there)]
    return found.tobytes()


def combined(parts: list[tuple[int, int]]) -> int:
    """Adler-32 of bytes one after the other, from that of each part and its length.

    It is s2 * 65536 + s1 modulo 65521, where s1 is 1 + the sum of the bytes, and s2 the sum of all s1 on the
    way (RFC 1950, section 2.2): a part of n bytes adds its own s1 - 1 to s1, and to s2 its own s2 and n times
    what s1 was beyond the 1 that it began with itself.
    """
    s1, s2 = 1, 0
    for check, size in parts:
        s2 += (check >> 16) + size * (s1 - 1)
        s1 += (check & 0xFFFF) - 1
    return (s2 % _ADLER) << 16 | s1 % _ADLER
