"""Picture of a live map as PNG: after a scan only the rows of tiles are packed again that it has changed.

Each row of tiles is a finished piece of the deflate stream, a strip. It ends with a full flush, so it neither
refers to what stands before it nor leaves bits over, and strips can stand in any order (P. Deutsch: RFC 1951,
sections 2 and 3.2.4). The check sum of all rows is put together from those of the strips.

Where a model's cells are dear to publish, as counts are, what has not changed of a strip is unpacked from the
one before: of a row of tiles only those are published that have changed, and the cells that these decide.
"""

import threading
from typing import NamedTuple

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

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

    part: CellRect
    numbers: NDArray[np.int64]
    """Of the tiles that it depends on: [tx, ty], the first one at `tiles`."""
    tiles: tuple[int, int]
    piece: bytes
    check: int
    size: int

    def pixels(self) -> NDArray[np.uint8]:
        """Its pixels, [iy, ix], row 0 south."""
        rows = isal_zlib.decompressobj(-isal_zlib.MAX_WBITS).decompress(self.piece)
        return np.frombuffer(rows, np.uint8).reshape(self.part.height, -1)[::-1, 1:]


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
        rect, margin = view.rect, snapshot.model.margin
        south, north = max(rect.iy, ty * TILE), min(rect.iy + rect.height, (ty + 1) * TILE)
        part = CellRect(rect.ix, south, rect.width, north - south)
        columns, rows = _tiles_around(part, margin)
        numbers, before = _numbers(view.tiles, (columns, rows)), self._strips.get(ty)
        if before is not None and before.part == part and np.array_equal(before.numbers, numbers):
            return before
        strip = Strip(part, numbers, (columns.start, rows.start), b"", 0, 0)
        stream = unfiltered(self._pixels(snapshot, before, strip)[::-1])
        packer = isal_zlib.compressobj(LEVEL, isal_zlib.DEFLATED, -isal_zlib.MAX_WBITS)
        piece = packer.compress(stream) + packer.flush(isal_zlib.Z_FULL_FLUSH)
        return strip._replace(piece=piece, check=isal_zlib.adler32(stream), size=stream.nbytes)

    def _pixels(self, snapshot: MapSnapshot, before: Strip | None, strip: Strip) -> NDArray[np.uint8]:
        """The pixels of a strip, with what has not changed since the one before, if that is worth it."""
        part = strip.part
        if (
            before is None
            or (part.iy, part.height) != (before.part.iy, before.part.height)
            or snapshot.model.table_of(self._encoder) is not None
        ):
            return snapshot.part(part).encode(self._encoder)
        pixels = np.empty((part.height, part.width), np.uint8)
        kept, first = part.intersection(before.part), before.part.ix
        west, there = kept.ix - part.ix, kept.ix - first
        pixels[:, west : west + kept.width] = before.pixels()[:, there : there + kept.width]
        stale = _stale(before, strip, snapshot.model.margin)
        edges = np.flatnonzero(np.diff(stale, prepend=False, append=False))
        for west, east in edges.reshape(-1, 2).tolist():
            columns = CellRect(part.ix + west, part.iy, east - west, part.height)
            pixels[:, west:east] = snapshot.part(columns).encode(self._encoder)
        return pixels


def _stale(before: Strip, now: Strip, margin: int) -> NDArray[np.bool_]:
    """Which columns of pixels are not what they were: those around tiles that have changed, and new ones."""
    old, new = before.part, now.part
    stale = np.ones(new.width, np.bool_)
    stale[max(old.ix - new.ix, 0) : max(old.ix - new.ix + old.width, 0)] = False
    shift = before.tiles[0] - now.tiles[0]
    here, there = now.numbers[max(shift, 0) :], before.numbers[max(-shift, 0) :]
    both = min(len(here), len(there))
    changed = np.ones(len(now.numbers), np.bool_)
    changed[max(shift, 0) : max(shift, 0) + both] = (here[:both] != there[:both]).any(axis=1)
    for west in (TILE * (now.tiles[0] + np.flatnonzero(changed)) - new.ix).tolist():
        stale[max(west - margin, 0) : max(west + TILE + margin, 0)] = True
    return stale


def _tiles_around(part: CellRect, margin: int) -> tuple[slice, slice]:
    """Columns and rows of tiles, of the lattice, that the pixels of a part depend on."""
    west, south = (part.ix - margin) // TILE, (part.iy - margin) // TILE
    east, north = -(-(part.ix + part.width + margin) // TILE), -(-(part.iy + part.height + margin) // TILE)
    return slice(west, east), slice(south, north)


def _numbers(tiles: TiledCells, around: tuple[slice, slice]) -> NDArray[np.int64]:
    """The numbers of these tiles, 0 where the store has none: equal numbers are equal cells."""
    first = tiles.rect.ix // TILE, tiles.rect.iy // TILE
    found = np.zeros([part.stop - part.start for part in around], np.int64)
    here, there = [], []
    for part, begin, count in zip(around, first, tiles.numbers.shape, strict=True):
        low, high = max(part.start, begin), min(part.stop, begin + count)
        here.append(slice(low - part.start, max(high, low) - part.start))
        there.append(slice(low - begin, max(high, low) - begin))
    found[tuple(here)] = tiles.numbers[tuple(there)]
    return found


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
