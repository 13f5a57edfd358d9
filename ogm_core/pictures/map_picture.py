"""A map's picture as PNG, made anew where tiles have changed, and only there.

Each tile's greys are kept as deflate's bits (run_coding), and each row of tiles as a finished piece
of the stream, a strip. After a scan only the tiles that it wrote are drawn, and only the strips that hold
them are put together again.

Sources: P. Deutsch, J-L. Gailly, RFC 1950, ZLIB Compressed Data Format Specification version 3.3, section 2.2
(header) and 8.2 (Adler-32); RFC 1951, section 3.2.4 (stored blocks).
"""

import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.log_odds import PLANE
from ogm_core.lattice import CellRect
from ogm_core.pictures.deflate import LONGEST_RUN, RunCode, code_for
from ogm_core.pictures.png import png_of
from ogm_core.pictures.run_coding import MOST_WORDS, code_tiles, count_runs, join_rows
from ogm_core.tiles.copies import TileCopies, placed
from ogm_core.tiles.store import TILE

_ZLIB_HEADER = b"\x78\x01"
_STORED = b"\x00\x00\xff\xff"
"""An empty stored block, after its three bits: what was put before becomes whole bytes."""
_LAST_BLOCK = b"\x01" + _STORED
_ADLER = 65521
_SAMPLE = 64
"""So many tiles are looked at to find the code that suits a map."""
_SUMS_OF_ONES = np.array((TILE**2, TILE**2 * (TILE - 1) // 2, TILE**2 * (TILE - 1) // 2))
_MOST_STEPS = 8
_ROOM = 4
"""The pool has room for so many times the bits of its first picture; when it is full, all is coded anew."""


class MapPicture:
    """The picture of a map's tiles in one palette, at the revision of whoever asked last.

    Who owns what: all of it belongs to the caller of `png`, one at a time.
    """

    def __init__(self, greys: NDArray[np.uint8]) -> None:
        """Begin a picture in which a stored cell with the bits n is drawn as `greys[n]`, shape (65536,)."""
        self._greys = greys
        self._steps = _steps(greys)
        self._lock = threading.Lock()
        self._rect = CellRect(0, 0, 0, 0)
        self._revision = -1
        self._numbers = np.zeros((0, 0), np.int64)
        """Of the tiles as they are drawn: what they cover, their revision, their numbers; not their cells."""
        self._slots = np.zeros((0, 0), np.uint64)
        """Slot of each tile; slot 0 is that of every tile that was never written."""
        self._strips: dict[int, tuple[tuple[int, ...], bytes]] = {}
        """By row of tiles: which part of it is drawn, and its piece of the stream."""

    def png(self, tiles: TileCopies, rect: CellRect) -> bytes:
        """PNG of `rect`, at least one cell of the tiles, north up."""
        with self._lock:
            if tiles.revision < self._revision:
                # A snapshot that is older than what is drawn is drawn for itself.
                return MapPicture(self._greys).png(tiles, rect)
            self._draw(tiles)
            north, south = (rect.iy + rect.height - 1) // TILE, rect.iy // TILE
            strips = [self._strip(rect, ty) for ty in range(north, south - 1, -1)]
            check = self._adler(rect).to_bytes(4)
        return png_of(rect.width, rect.height, [_ZLIB_HEADER, *strips, _LAST_BLOCK, check])

    def _draw(self, tiles: TileCopies) -> None:
        """Code the tiles that have changed since the last call."""
        # A picture that is half drawn, because memory gave out, is begun anew by the next call.
        drawn, self._revision = self._revision, -1
        if drawn < 0:
            self._begin(tiles)
        else:
            changed = tiles.numbers != placed(self._numbers, self._rect, tiles.rect)
            self._slots = placed(self._slots, self._rect, tiles.rect)
            fresh = np.flatnonzero(changed & (self._slots == 0))
            self._slots.reshape(-1)[fresh] = np.arange(self._next_slot, self._next_slot + len(fresh))
            self._next_slot += len(fresh)
            self._make_room()
            if not self._code_changed(tiles, changed):
                self._begin(tiles)
            for ty in np.flatnonzero(changed.any(axis=0)).tolist():
                self._strips.pop(tiles.rect.iy // TILE + ty, None)
        self._rect, self._numbers, self._revision = tiles.rect, tiles.numbers, tiles.revision

    def _begin(self, tiles: TileCopies) -> None:
        """Code all tiles, by a code that suits them."""
        written = tiles.numbers > 0
        count = int(np.count_nonzero(written))
        self._slots = np.zeros(tiles.numbers.shape, np.uint64)
        self._slots[written] = np.arange(1, count + 1)
        self._next_slot = count + 1
        self._strips = {}
        self._code = self._suitable_code(tiles)
        self._outer = np.array([[[self._greys[0], TILE, 0, 0]] * TILE], np.uint8)
        self._inner, self._sums = np.zeros((1, TILE, 2), np.uint32), np.zeros((1, 3), np.int64)
        self._make_room()
        self._pool, self._used = np.empty(count * MOST_WORDS // 8 + MOST_WORDS, np.uint32), 0
        while not self._code_changed(tiles, written):
            self._pool, self._used = np.empty(2 * len(self._pool), np.uint32), 0
        room = np.empty(_ROOM * self._used + _SAMPLE * MOST_WORDS, np.uint32)
        room[: self._used] = self._pool[: self._used]
        self._pool = room

    def _suitable_code(self, tiles: TileCopies) -> RunCode:
        numbers = tiles.numbers[tiles.numbers > 0]
        counts = np.zeros((256, LONGEST_RUN + 1), np.int64)
        for block, _, rows in tiles.find(numbers[:: max(1, len(numbers) // _SAMPLE)]):
            counts += count_runs(block[PLANE][rows], self._greys)
        counts[np.unique(self._greys), 1] += 1
        # Tiles that were never written, and the filter bytes.
        counts[self._greys[0], LONGEST_RUN] += np.count_nonzero(tiles.numbers == 0)
        counts[0, 1] += 1
        return code_for(counts)

    def _code_changed(self, tiles: TileCopies, changed: NDArray[np.bool_]) -> bool:
        """Code these tiles; False if the pool has become too small."""
        slots = self._slots[changed]
        for block, here, rows in tiles.find(tiles.numbers[changed]):
            done, self._used = code_tiles(
                block[PLANE],
                rows.astype(np.uint64),
                slots[here],
                self._greys,
                self._steps,
                self._code.runs,
                self._pool,
                self._used,
                self._outer,
                self._inner,
                self._sums,
            )
            if done < len(rows):
                return False
        return True

    def _make_room(self) -> None:
        """See to it that there is room for every slot."""
        if self._next_slot > len(self._outer):
            size = self._next_slot + self._next_slot // 4
            self._outer = _longer(self._outer, size)
            self._inner = _longer(self._inner, size)
            self._sums = _longer(self._sums, size)

    def _strip(self, rect: CellRect, ty: int) -> bytes:
        """The piece of the stream of the rows of `rect` in the row of tiles `ty` of the lattice."""
        frame = self._rect
        south, north = max(rect.iy - ty * TILE, 0), min(rect.iy + rect.height - ty * TILE, TILE)
        part = (rect.ix, rect.width, south, north)
        known = self._strips.get(ty)
        if known is not None and known[0] == part:
            return known[1]
        west, east = rect.ix - frame.ix, rect.ix + rect.width - frame.ix
        slots = self._slots[west // TILE : -(-east // TILE), ty - frame.iy // TILE]
        # At most 15 bits a byte, and the block's own.
        out = np.empty((north - south) * (rect.width + 1) // 2 + 512, np.uint32)
        size = join_rows(
            np.ascontiguousarray(slots),
            south,
            north,
            west % TILE,
            -east % TILE,
            self._pool,
            self._outer,
            self._inner,
            self._code.runs,
            self._code.header,
            self._code.end,
            out,
        )
        strip = out.view(np.uint8)[:size].tobytes() + _STORED
        self._strips[ty] = part, strip
        return strip

    def _adler(self, rect: CellRect) -> int:
        """Adler-32 of all rows, each behind its filter byte 0, from the sums over the tiles.

        It is s2 * 65536 + s1 modulo 65521, where s1 is 1 + the sum of n bytes b_i, and s2 is n + the sum of
        (n - i) b_i: linear in the bytes. So it is that of a picture without a known cell, and what the cells'
        greys differ from that.
        """
        frame = self._rect
        pitch, width, height = rect.width + 1, rect.width, rect.height
        unknown = int(self._greys[0])
        s1 = 1 + unknown * width * height
        s2 = height * pitch + unknown * (
            width * height * width
            - height * (width * (width - 1) // 2)
            + pitch * width * (height * (height - 1) // 2)
        )
        # Of the cell in column x and row y, from the south, n - i is width - x + y * pitch.
        tx, ty = np.nonzero(self._slots)
        total, by_column, by_row = (self._sums[self._slots[tx, ty]] - unknown * _SUMS_OF_ONES).T
        x, y = frame.ix - rect.ix + TILE * tx, frame.iy - rect.iy + TILE * ty
        s1 += int(total.sum())
        # Residues, for a long and narrow map would be too much for 64 bits.
        s2 += int(((width - x + y * pitch) % _ADLER * total - by_column + pitch % _ADLER * by_row).sum())
        return (s2 % _ADLER) << 16 | s1 % _ADLER


def _longer(array: NDArray[Any], length: int) -> NDArray[Any]:
    longer = np.empty((length, *array.shape[1:]), array.dtype)
    longer[: len(array)] = array
    return longer


def _steps(greys: NDArray[np.uint8]) -> NDArray[np.int16]:
    """Stored cells, rising from the lowest, from which on the grey is another; none if they are many."""
    by_cell = np.roll(greys, 2**15)
    steps = np.concatenate(([0], np.flatnonzero(np.diff(by_cell)) + 1)) - 2**15
    return steps.astype(np.int16) if len(steps) <= _MOST_STEPS else np.empty(0, np.int16)
