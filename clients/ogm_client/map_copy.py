"""Copy of a mapper's map, kept up to date by map updates."""

from collections import deque
from dataclasses import replace
from enum import Enum, auto
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_client.counted_copy import MODEL, PER_CELL, SPREAD, lay_out_counts
from ogm_client.errors import BadReply
from ogm_client.map_grid import MapGrid
from ogm_client.transport import Version
from ogm_core.cells.log_odds import PLANE
from ogm_core.cells.rate import PLANES
from ogm_core.cells.thresholds import FREE_BELOW, OCCUPIED_ABOVE
from ogm_core.lattice import CellRect
from ogm_core.tiles.store import TILE, tile_bytes
from ogm_core.wire.map_update import MapUpdate

_PAST_LIVES = 16
_TABLE_BYTES = 256
"""What a tile takes beside its cells, about."""

Place = tuple[int, int]


class Taken(Enum):
    """What became of an update."""

    APPLIED = auto()
    KNOWN = auto()
    """It tells nothing new."""
    GAP = auto()
    """The copy is too old for it, or of another map: what lies between has to be fetched."""
    PART = auto()
    """The rest of it is still to come."""


class MapCopy:
    """The tiles of a map at one revision, as its mapper keeps them. One thread writes and reads at a time."""

    def __init__(self, max_bytes: int, *, coarse: bool = False) -> None:
        """All tiles together may take `max_bytes`, and so may the log odds that are read.

        `coarse`: of a map that counts, these are of the cells that it counts in, not of their halves.
        """
        self._max_bytes, self._coarse = max_bytes, coarse
        self.newest: MapUpdate | None = None
        """The last update that was applied."""
        self._tiles: dict[Place, dict[str, NDArray[Any]]] = {}
        self._changed: dict[Place, int] = {}
        """By tile, the revision with which it came to what it is."""
        self._parts: list[MapUpdate] = []
        self._past: deque[tuple[str, str]] = deque(maxlen=_PAST_LIVES)
        self._shown: NDArray[np.floating[Any]] | None = None
        """Log odds of `_shown_of`."""
        self._shown_of = CellRect(0, 0, 0, 0)
        self._stale: set[Place] = set()
        """Tiles that are not in `_shown` as they are now."""

    @property
    def version(self) -> Version | None:
        """Which map it is; None before the first."""
        newest = self.newest
        return None if newest is None else Version(newest.epoch, newest.run, newest.revision)

    @property
    def tiles(self) -> dict[Place, dict[str, NDArray[Any]]]:
        """The planes of every tile that was ever written, by its place (tx, ty) on the lattice."""
        return self._tiles

    def take(self, update: MapUpdate, *, asked: bool = False) -> Taken:
        """Apply an update, if it follows what the copy is; parts of one are applied with the last of them.

        Of a life that the copy has left nothing is taken any more, unless it was `asked` for.

        Raises:
            BadReply: it does not go with those before it, or the copy would be too large.
        """
        life, mine = (update.epoch, update.run), self.version
        if mine is not None and life == mine[:2]:
            # Who is asked, and is not as far, is right: somebody else has told what is here.
            if update.revision <= mine.revision and not (asked and update.whole):
                return Taken.KNOWN
            if update.prev > mine.revision and not update.whole:
                return Taken.GAP
        elif not asked and life in self._past:
            return Taken.KNOWN
        elif not update.whole:
            return Taken.GAP
        if update.parts == 1:
            self._apply([update])
            return Taken.APPLIED
        parts = [*self._parts, update] if update.part else [update]
        self._parts = []
        # Those before are one change already.
        if update.part != len(parts) - 1 or _change(parts[0]) != _change(update):
            return Taken.GAP
        self._check_size(parts)
        if len(parts) < update.parts:
            self._parts = parts
            return Taken.PART
        self._apply(parts)
        return Taken.APPLIED

    def changed_since(self, seen: Version | None) -> list[Place]:
        """The tiles that are not what they were at a version of this life; all of them for another one."""
        mine = self.version
        if mine is None or seen is None or not seen.is_before(mine):
            return list(self._tiles)
        return [place for place, revision in self._changed.items() if revision > seen.revision]

    def grid(self) -> MapGrid:
        """The copy as an occupancy grid map of its own; only what has changed is made anew for it.

        Raises:
            BadReply: there is none, or its model is one that this client cannot read, or it is too large.
        """
        newest = self.newest
        if newest is None:
            raise BadReply("map.tiles: no map has come yet")
        _check_model(newest)
        exact, extent, per_cell = newest.planes[0].dtype == np.float64, newest.extent, self._per_cell
        size = extent.cells * per_cell**2 * (8 if exact else 4)
        if size > self._max_bytes:
            raise BadReply(f"map.tiles: its cells take {size} bytes, at most {self._max_bytes} are allowed")
        if self._shown is None or self._shown_of != extent:
            shape = extent.height * per_cell, extent.width * per_cell
            self._shown, self._shown_of = np.full(shape, np.nan, np.float64 if exact else np.float32), extent
            self._stale = set(self._tiles)
        if self._counts:
            lay_out_counts(self._tiles, self._stale, extent, self._shown, per_cell, self._free_below)
        else:
            for place in self._stale:
                _lay_out(self._tiles[place][PLANE], place, newest, self._shown)
        self._stale.clear()
        return MapGrid(
            log_odds=self._shown.copy(),
            resolution=newest.lattice.resolution / per_cell,
            anchor=newest.lattice.anchor,
            offset=(per_cell * extent.ix, per_cell * extent.iy),
            epoch=newest.epoch,
            revision=newest.revision,
            stamp=newest.stamp,
            run=newest.run,
            free_below=self._free_below,
        )

    @property
    def spread(self) -> int:
        """How many cells around a changed tile may have changed with it."""
        return SPREAD if self._counts else 0

    @property
    def _per_cell(self) -> int:
        """How many cells of `grid` lie along a side of one of the map's."""
        return PER_CELL if self._counts and not self._coarse else 1

    @property
    def _free_below(self) -> float:
        told = FREE_BELOW if self.newest is None else self.newest.model.get("free_below", FREE_BELOW)
        return float(told)

    @property
    def _counts(self) -> bool:
        return self.newest is not None and self.newest.model["name"] == MODEL

    def _check_size(self, parts: list[MapUpdate]) -> None:
        first = parts[0]
        held = 0 if first.whole else len(self._tiles)
        tiles = held + sum(len(part.tiles) for part in parts)
        size = tiles * (tile_bytes(first.planes) + _TABLE_BYTES)
        if held and size > self._max_bytes:  # some of them may be there already
            new = sum(place not in self._tiles for part in parts for place in _places(part))
            size = (held + new) * (tile_bytes(first.planes) + _TABLE_BYTES)
        if size > self._max_bytes:
            raise BadReply(f"map.tiles: a copy takes {size} bytes, at most {self._max_bytes} are allowed")

    def _apply(self, parts: list[MapUpdate]) -> None:
        update, mine = parts[-1], self.newest
        new_life = mine is None or (update.epoch, update.run) != (mine.epoch, mine.run)
        if mine is not None and not new_life and _form(update) != _form(mine):
            raise BadReply("map.tiles: its lattice or its planes have changed within one life of the map")
        self._check_size(parts)
        if update.whole:
            self._tiles, self._changed = {}, {}
            self._shown, self._stale = None, set()
        if new_life and mine is not None:
            self._past.append((mine.epoch, mine.run))
        for part in parts:
            for row, place in enumerate(_places(part)):
                self._tiles[place] = {name: cells[row].copy() for name, cells in part.cells.items()}
                self._changed[place] = update.revision
                self._stale.add(place)
        self._parts = []
        # Without the message's tiles, which are copied already.
        none = {name: cells[:0].copy() for name, cells in update.cells.items()}
        self.newest = replace(update, tiles=update.tiles[:0].copy(), cells=none)


class _Change(NamedTuple):
    life: tuple[str, str]
    prev: int
    revision: int
    whole: bool
    parts: int
    form: tuple[Any, ...]


def _change(update: MapUpdate) -> _Change:
    """What the parts of one change have in common."""
    life = update.epoch, update.run
    return _Change(life, update.prev, update.revision, update.whole, update.parts, _form(update))


def _form(update: MapUpdate) -> tuple[Any, ...]:
    return update.lattice, update.planes, dict(update.model)


def _places(update: MapUpdate) -> list[Place]:
    return [(tx, ty) for tx, ty in update.tiles.tolist()]


def _check_model(update: MapUpdate) -> None:
    """Refuse what this client cannot make log odds of: it can of log odds, and of counts."""
    model, planes = update.model, update.planes
    free_below = model.get("free_below", FREE_BELOW)
    if not isinstance(free_below, int | float) or not 0.0 < free_below < OCCUPIED_ABOVE:
        raise BadReply(f"map.tiles: free_below {free_below!r} is no probability below {OCCUPIED_ABOVE}")
    if model["name"] == MODEL:
        if planes != PLANES:
            told = ", ".join(plane.name for plane in planes)
            raise BadReply(f"map.tiles: counts of {MODEL} in other planes than known here: {told}")
        return
    if model["name"] != PLANE or len(planes) != 1 or planes[0].name != PLANE or planes[0].side != 1:
        raise BadReply(f"map.tiles: log odds and counts can be read, not cells of {model['name']!r}")
    if planes[0].dtype not in (np.int16, np.float64):
        raise BadReply(f"map.tiles: log odds of int16 or float64 can be read, not of {planes[0].dtype}")
    if not all(isinstance(model.get(name), int | float) for name in ("l0", "step")):
        raise BadReply("map.tiles: l0 and step of the log odds are missing")


def _lay_out(
    cells: NDArray[Any], place: Place, update: MapUpdate, log_odds: NDArray[np.floating[Any]]
) -> None:
    """Put the log odds of a tile where they lie, as /map.npz has them; what juts out is left out."""
    rect = CellRect(place[0] * TILE, place[1] * TILE, TILE, TILE)
    part, extent = rect.intersection(update.extent), update.extent
    if not part.cells:
        return
    x, y = part.ix - rect.ix, part.iy - rect.iy
    shown = cells.reshape(TILE, TILE)[y : y + part.height, x : x + part.width]
    x, y = part.ix - extent.ix, part.iy - extent.iy
    log_odds[y : y + part.height, x : x + part.width] = _log_odds(shown, update)


def _log_odds(cells: NDArray[Any], update: MapUpdate) -> NDArray[np.float64]:
    if cells.dtype == np.float64:
        return np.where(cells.copy().view(np.int64) != 0, cells + 0.0, np.nan)
    l0, step = float(update.model["l0"]), float(update.model["step"])
    return np.where(cells != 0, l0 + (cells >> 1).astype(np.float64) * step, np.nan)
