"""Tile pyramid: a map's value bytes as squares of 256 x 256 pixels, at seven resolutions.

z = 16 has a pixel a cell, and each z below half as many a side, down to z = 10. Square (x, y) of z = 16 - k
holds the cells with x = floor(ix / (256 * 2^k)) and y = -1 - floor(iy / (256 * 2^k)): x counts to the east
and y to the south, from the map's anchor, so that squares never move however the map grows. Four squares make
one of the z below: (floor(x / 2), floor(y / 2)).
"""

import threading
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.model import CellModel, Planes
from ogm_core.cells.value_bytes import value_byte
from ogm_core.lattice import CellRect
from ogm_core.tiles.copies import placed
from ogm_core.tiles.overviews import (
    OVERVIEW_BYTES,
    TOP,
    look_up,
    make_overviews,
    put_together,
    write_value_bytes,
)
from ogm_core.tiles.store import TILE
from ogm_core.tiles.view import TiledCells, TiledView

PIXELS: Final = 256
"""Squares are so many pixels wide and high."""
NATIVE_Z: Final = 16
"""The z of a pixel a cell."""
LEAST_Z: Final = NATIVE_Z - TOP
_AT_ONCE: Final = 32
"""So many tiles are laid out at a time, at most: it takes little memory, and few calls a tile."""
MAKING_BYTES: Final = _AT_ONCE * TILE * TILE * 64
"""What making pixels takes besides what is kept, at most: of each cell its planes and some float64."""
_FIRST_ROWS: Final = 64


class Square(NamedTuple):
    """A square of pixels: z, and which one from the anchor."""

    z: int
    x: int
    y: int

    @property
    def rect(self) -> CellRect:
        """The cells under it."""
        side = PIXELS << (NATIVE_Z - self.z)
        return CellRect(self.x * side, (-1 - self.y) * side, side, side)


class _Window(NamedTuple):
    """Tiles of a copy's table that a rectangle of cells meets, and where that begins among them."""

    columns: slice
    rows: slice
    column: int
    row: int
    """Tiles from the rectangle's first one to the window's."""


def revision_of(tiles: TiledCells, model: CellModel, square: Square) -> int | None:
    """The revision since which a square's pixels are as they are; None if nothing was written that matters.

    The highest of the tiles that its cells meet, and those around them on which their probabilities depend.
    """
    window = _window(tiles, square.rect.widened(model.margin))
    revision = int(tiles.revisions(window.columns, window.rows).max(initial=-1))
    return None if revision < 0 else revision


def revisions_of(tiles: TiledCells, model: CellModel, first: Square, last: Square) -> NDArray[np.int64]:
    """Of all squares from `first` to `last`, of one z, the `revision_of`; -1 where it has none.

    Shape (in x, in y), from `first`.
    """
    side, margin = first.rect.width, model.margin
    (left, bottom, *_), counts = tiles.rect, tiles.numbers.shape
    west = (x * side - margin - left for x in range(first.x, last.x + 1))
    south = ((-1 - y) * side - margin - bottom for y in range(first.y, last.y + 1))
    across = [_met(start, side + 2 * margin, counts[0]) for start in west]
    down = [_met(start, side + 2 * margin, counts[1]) for start in south]
    # x rises with the columns, y falls with the rows.
    columns, rows = slice(across[0].start, across[-1].stop), slice(down[-1].start, down[0].stop)
    of = tiles.revisions(columns, rows)
    highest = np.empty((len(across), of.shape[1]), np.int64)
    for i, part in enumerate(across):
        highest[i] = of[part.start - columns.start : part.stop - columns.start].max(axis=0, initial=-1)
    found = np.empty((len(across), len(down)), np.int64)
    for j, part in enumerate(down):
        found[:, j] = highest[:, part.start - rows.start : part.stop - rows.start].max(axis=1, initial=-1)
    return found


class TilePyramid:
    """Overviews of the newest map that was asked for, made when they are, and made anew where it has changed.

    Who owns what: all of it belongs to the caller of `pixels`, one at a time; `let_go` only puts another in
    the place of what is kept.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept = _Overviews(None)

    @property
    def nbytes(self) -> int:
        """What is kept; any thread may ask."""
        return self._kept.nbytes

    def let_go(self) -> None:
        """Keep no overviews; any thread."""
        self._kept = _Overviews(None)

    def pixels(self, view: TiledView, model: CellModel, square: Square) -> NDArray[np.uint8]:
        """The value bytes of a square, (256, 256), row 0 south, of any revision; the newest are quick."""
        if square.z == NATIVE_Z:
            return _bytes_in(view, model, square.rect)
        tiles = view.tiles
        with self._lock:
            kept = self._kept
            if kept.lineage is not tiles.lineage:  # of another store: equal revisions are other cells
                kept = self._kept = _Overviews(tiles.lineage)
            if kept.revision > tiles.revision:  # this reader's map is an older one
                kept = _Overviews(tiles.lineage)
            return kept.pixels(view, model, square)


class _Overviews:
    """Overviews of the tiles of one lineage, each of the revision that it was last asked for."""

    def __init__(self, lineage: object) -> None:
        self.lineage = lineage
        self.revision = -1
        self._rect = CellRect(0, 0, 0, 0)
        self._made: NDArray[np.int64] = np.zeros((0, 0), np.int64)
        """Of every tile 1 + the revision that its overviews are of; 0: it has none."""
        self._which: NDArray[np.int32] = np.zeros((0, 0), np.int32)
        """Of every tile 1 + which of `_rows` is its own; 0: it has none."""
        self._rows: NDArray[np.uint8] = np.zeros((0, OVERVIEW_BYTES), np.uint8)
        self._used = 0

    @property
    def nbytes(self) -> int:
        return self._rows.nbytes + self._made.nbytes + self._which.nbytes

    def pixels(self, view: TiledView, model: CellModel, square: Square) -> NDArray[np.uint8]:
        self.revision = view.tiles.revision
        self._cover(view.tiles.rect)
        window = _window(view.tiles, square.rect)
        self._bring_up_to_date(view, model, window)
        level = NATIVE_Z - square.z
        pixels = np.zeros((PIXELS, PIXELS), np.uint8)
        side = TILE >> level
        which = self._which[window.columns, window.rows] - np.int32(1)
        put_together(self._rows, which, window.column * side, window.row * side, level, pixels)
        return pixels

    def _cover(self, rect: CellRect) -> None:
        """Have a place for every tile of a map, which only grows."""
        if rect != self._rect:
            self._made = _placed(self._made, self._rect, rect)
            self._which = _placed(self._which, self._rect, rect)
            self._rect = rect

    def _bring_up_to_date(self, view: TiledView, model: CellModel, window: _Window) -> None:
        """Make the overviews of the tiles in a window that have none, or older ones."""
        wanted = 1 + _with_margin(view.tiles, model.margin, window)
        made = self._made[window.columns, window.rows]
        stale = np.flatnonzero(wanted != made)
        if not model.margin:  # then as they lie in memory, else in runs up the columns
            numbers = view.tiles.numbers[window.columns, window.rows].reshape(-1)[stale]
            stale = stale[np.argsort(numbers)]
        tx, ty = np.divmod(stale, made.shape[1])
        for first in range(0, len(stale), _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            self._make(view, model, tx[part] + window.columns.start, ty[part] + window.rows.start)
        made[tx, ty] = wanted[tx, ty]

    def _make(self, view: TiledView, model: CellModel, tx: NDArray[np.intp], ty: NDArray[np.intp]) -> None:
        """Make the overviews of some tiles."""
        which = self._which[tx, ty]
        new = np.flatnonzero(which == 0)
        self._make_room(len(new))
        which[new] = np.arange(self._used + 1, self._used + 1 + len(new))
        self._used += len(new)
        self._which[tx, ty] = which
        found = np.empty((len(which), OVERVIEW_BYTES), np.uint8)
        make_overviews(_side_by_side(view, model, tx, ty), found)
        self._rows[which - 1] = found

    def _make_room(self, more: int) -> None:
        if self._used + more > len(self._rows):
            count = max(_FIRST_ROWS, self._used + more, len(self._rows) * 5 // 4)
            grown = np.empty((count, OVERVIEW_BYTES), np.uint8)
            grown[: self._used] = self._rows[: self._used]
            self._rows = grown


def _value_bytes(model: CellModel, planes: Planes) -> NDArray[np.uint8]:
    """The value bytes of cells; of 16 bits by a table, half as long as `encoded` takes."""
    table = model.table_of(value_byte)
    if table is None:
        p, known = model.published(planes)
        found = np.empty(p.shape, np.uint8)
        write_value_bytes(p.reshape(-1), known.reshape(-1), model.free_below, found.reshape(-1))
        return found
    (cells,) = planes.values()
    found = np.empty(cells.shape, np.uint8)
    look_up(table, cells.view(np.uint16).reshape(-1), found.reshape(-1))
    return found


def _bytes_in(view: TiledView, model: CellModel, rect: CellRect) -> NDArray[np.uint8]:
    """The value bytes of the cells of a rectangle; those beyond the map are unknown, whatever is near."""
    found = _value_bytes(model, view.window(rect, model.margin))
    inside = rect.intersection(view.rect)
    if model.margin and inside != rect:
        cut = np.zeros_like(found)
        rows = slice(inside.iy - rect.iy, inside.iy - rect.iy + inside.height)
        columns = slice(inside.ix - rect.ix, inside.ix - rect.ix + inside.width)
        cut[rows, columns] = found[rows, columns]
        return cut
    return found


def _side_by_side(
    view: TiledView, model: CellModel, tx: NDArray[np.intp], ty: NDArray[np.intp]
) -> NDArray[np.uint8]:
    """The value bytes of some tiles of a copy, side by side."""
    if not model.margin:
        return _value_bytes(model, view.side_by_side(view.tiles.numbers[tx, ty]))
    frame, parts = view.tiles.rect, []
    begins = np.flatnonzero((np.diff(tx, prepend=tx[:1] - 1) != 0) | (np.diff(ty, prepend=ty[:1] - 2) != 1))
    for first, end in zip(begins.tolist(), [*begins[1:].tolist(), len(tx)], strict=True):
        place = frame.ix + TILE * int(tx[first]), frame.iy + TILE * int(ty[first])
        run = _bytes_in(view, model, CellRect(*place, TILE, TILE * (end - first)))
        parts += list(run.reshape(-1, TILE, TILE))
    return np.concatenate(parts, axis=1)


def _placed(table: NDArray[Any], rect: CellRect, wider: CellRect) -> NDArray[Any]:
    """A table of tiles that covers `wider`, which holds `rect` unless that is empty."""
    return placed(table, rect if rect.cells else wider, wider)


def _window(tiles: TiledCells, rect: CellRect) -> _Window:
    """The tiles of a copy that `rect` meets; none, where it lies outside."""
    here, places = [], []
    ends = ((rect.ix, rect.width, tiles.rect.ix), (rect.iy, rect.height, tiles.rect.iy))
    for (start, length, begin), count in zip(ends, tiles.numbers.shape, strict=True):
        here.append(_met(start - begin, length, count))
        places.append(here[-1].start - (start - begin) // TILE)
    return _Window(here[0], here[1], places[0], places[1])


def _met(start: int, length: int, count: int) -> slice:
    """Which of `count` tiles in a row so many cells from `start` on meet; none, if they lie outside."""
    low = min(max(start // TILE, 0), count)
    return slice(low, max(low, min(-(-(start + length) // TILE), count)))


def _with_margin(tiles: TiledCells, margin: int, window: _Window) -> NDArray[np.int64]:
    """The revisions of a window's tiles; with a margin, the highest of each and the eight around it."""
    if not margin:
        return tiles.revisions(window.columns, window.rows)
    low = [max(part.start - 1, 0) for part in window[:2]]
    high = [min(part.stop + 1, count) for part, count in zip(window[:2], tiles.numbers.shape, strict=True)]
    found = tiles.revisions(slice(low[0], high[0]), slice(low[1], high[1]))
    shape = [part.stop - part.start + 2 for part in window[:2]]
    around = np.full(shape, -1, np.int64)
    x, y = (begin - part.start + 1 for begin, part in zip(low, window[:2], strict=True))
    around[x : x + found.shape[0], y : y + found.shape[1]] = found
    rows, columns = shape[0] - 2, shape[1] - 2
    highest: NDArray[np.int64] = np.max(
        [around[i : i + rows, j : j + columns] for i in range(3) for j in range(3)], axis=0
    )
    return highest
