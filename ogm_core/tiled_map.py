"""A map as tiles: begun, copied, erased, stored and restored. What scans do to it, `grid` says."""

from collections.abc import Callable, Iterable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.compiled import compiled
from ogm_core.cells.forgetting import MapTime
from ogm_core.cells.model import CellModel, Planes
from ogm_core.errors import BadParameter, LimitReached, MapEmpty, OutsideBounds
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.aging import Aging
from ogm_core.tiles.checkpoint import Checkpoint, KeptCells, KeptTile, MapState
from ogm_core.tiles.copies import (
    CopyAhead,
    TileCopies,
    Tiles,
    aged_tiles,
    copy_tiles,
    room_for,
    uncopied_tiles,
)
from ogm_core.tiles.erasing import erase, written_rect
from ogm_core.tiles.extent import NO_CELLS, Extent
from ogm_core.tiles.polygon import Polygon
from ogm_core.tiles.store import TileStore
from ogm_core.tiles.view import TileView


class TiledMap:
    """The cells of a map, and how far it has come. One thread writes; readers get snapshots."""

    def __init__(self, settings: GridSettings, epoch: str, run: str) -> None:
        """Make an empty map; `epoch` is the id of its life until the next `reset`, `run` its process's."""
        self.settings = settings
        self.run = run
        self.model: CellModel = compiled(settings.cell_model)
        self.lattice, self.bounds = settings.lattice, settings.clipped_bounds
        """Its lattice, and the cells that it keeps if it is bounded."""
        self.time: MapTime
        """How far its time has come, and its ticks: of a map with a half-life."""
        self._aging: Aging | None
        self._store: TileStore
        self._copies: TileCopies | None = None
        self.kept_bytes = 0
        """What copies for a checkpoint hold that none of what is served shares."""
        self.reset(epoch)

    def reset(self, epoch: str) -> None:
        """Forget every cell and begin again at revision 0 under a new `epoch`."""
        self.epoch = epoch
        self.revision = 0
        self.stamp: int | None = None
        self.cell_updates = 0
        self.erasures = 0
        self._begin_time(MapTime())
        self._extent = self._unknown()
        self._begin_store(self._reserving(self.bounds or NO_CELLS))

    @property
    def nbytes(self) -> int:
        """Bytes that the map has allocated."""
        return self._store.nbytes

    @property
    def rect(self) -> CellRect:
        """What is served: the bounds, or else the smallest rectangle that holds every known cell.

        It holds every cell that was written, with as many more on every side as its model may know of: also
        beyond a clip, where cells of another map are known by this one's.
        """
        return self._extent.served(self.model.spread)

    def begin_with(self, planes: Planes, offset: tuple[int, int] = (0, 0)) -> None:
        """Fill an empty map: its model's planes, [iy, ix]; the first cell is `offset` of the lattice.

        The revision stays 0: it counts scans. A map with a clip takes what lies in it.

        Raises:
            LimitReached: they are more than the map may hold; no cell has changed.
            OutsideBounds: they are not all within the map's bounds; no cell has changed.
        """
        written = CellArrays(planes, {plane.name: plane.side for plane in self.model.planes}).any_written()
        height, width = written.shape
        rect = CellRect(*offset, width, height)
        extent = self._unknown()
        if extent.counted(rect) != rect:
            raise OutsideBounds(f"{width} x {height} cells from {offset} on are not all within the bounds")
        if rect.cells > self.settings.max_cells:
            raise LimitReached(
                f"{width} x {height} cells are more than max_cells = {self.settings.max_cells}"
            )
        store = self._reserving(self.bounds or extent.kept(rect))
        store.write(rect, planes)
        self.settings.check_bytes(store.nbytes)
        known = _rect_of(written, offset)
        if known is not None:
            extent.begin(known)
        self._extent = extent
        self._begin_store(store)

    def erase(self, area: Polygon) -> int:
        """Make the cells unknown whose centre lies in `area`; return how many were known.

        What lies outside the map is left out. The revision grows by one; stamp and number of updates stay.
        Whether an area is refused is decided without the clip.

        Raises:
            BadParameter: no cell of the map may lie in it; nothing has changed.
            MapEmpty: the map has no known cell, nor bounds; nothing has changed.
        """
        if not area.rect.cells:
            raise BadParameter("no cell's centre lies in what is to be erased: it is too small")
        whole = self._extent.whole(self.model.spread)
        if not whole.cells:
            raise MapEmpty("the map has no known cell: there is nothing to erase")
        if not whole.intersection(area.rect).cells:
            wanted, here = (self.lattice.region_of(rect).span for rect in (area.rect, whole))
            raise BadParameter(f"what is to be erased, {wanted}, lies wholly outside the map, {here}")
        part = self.rect.intersection(area.rect)
        erased = erase(self._store, area, part, self.revision + 1, self._aging)
        if erased:
            self._extent.know(written_rect(self._store, self._aging))
        self.revision += 1
        self.erasures += 1
        return erased

    def room_for_snapshot(self) -> Callable[[], Tiles]:
        """What makes memory ready for the next snapshot: call it while another thread goes on writing."""
        return partial(room_for, self._store, self._copies, self._aging)

    def snapshot(self, room: Tiles | None = None) -> MapSnapshot:
        """A copy of what is served, with the identity of its revision.

        Only tiles that were written since the last snapshot are copied, into `room` if it is large enough.
        """
        self._copies = copy_tiles(self._store, self.revision, self._copies, room, self._aging)
        return MapSnapshot(
            stored=TileView(self._copies, self.rect, self.model.planes),
            model=self.model,
            lattice=self.lattice,
            offset=(self.rect.ix, self.rect.iy),
            epoch=self.epoch,
            run=self.run,
            revision=self.revision,
            stamp=self.stamp,
            erasures=self.erasures,
            half_life=self.settings.half_life,
        )

    def copy_ahead(self) -> CopyAhead:
        """What copies the tiles written since the last copy while another thread goes on writing.

        `take_ahead` takes what it has made; the next copy then copies no more than was written meanwhile.
        """
        return CopyAhead(self._store, self.revision, self._copies, self._aging)

    @property
    def aged_bytes(self) -> int:
        """How much the next snapshot has to copy because it has missed ticks."""
        aging = self._aging
        return 0 if aging is None else aged_tiles(self._store, self._copies, aging) * self._store.tile_bytes

    def aged_copy_ahead(self, *, afresh: bool) -> CopyAhead:
        """As `copy_ahead`, for a snapshot after a tick: what has missed it is copied too.

        With `afresh` the copy of before is let go first: the two together may be too much.
        """
        if afresh:
            self._copies = None
        return CopyAhead(self._store, self.revision, self._copies, self._aging, keeping_old=False)

    def copies_ahead(self) -> list[CopyAhead]:
        """The same for all that a checkpoint copies."""
        return [self.copy_ahead()]

    def take_ahead(self, ahead: CopyAhead, made: TileCopies) -> None:
        """Take what `ahead` has made, unless cells have moved meanwhile or another copy was made."""
        if ahead.store is self._store and ahead.before is self._copies:
            self._copies = made

    @property
    def uncopied_bytes(self) -> int:
        """How much the next copy has to copy."""
        return uncopied_tiles(self._store, self._copies) * self._store.tile_bytes

    def room_for_checkpoint(self) -> Callable[[], Tiles]:
        """What makes memory ready for the next checkpoint: call it while another thread goes on writing."""
        return partial(room_for, self._store, self._copies, giving_up=False, keeping_old=True)

    def checkpoint(self, room: Tiles | None = None) -> Checkpoint:
        """The map as it is now, for a store.

        Only tiles that were written since the last copy are copied, into `room` if it is large enough.
        """
        self._copies = copy_tiles(
            *(self._store, self.revision, self._copies, room, self._aging), giving_up=False, keeping_old=True
        )
        return Checkpoint(self._state(), (KeptCells(self._copies, self._store.touched.copy()),))

    def _state(self) -> MapState:
        extent = self._extent
        return MapState(
            *(self.epoch, self.revision, self.stamp, self.cell_updates, extent.known, self._store.rect),
            *(self.erasures, self.time, None if extent.clip is None else extent.stretched),
        )

    def restore(self, state: MapState, tiles: Iterable[KeptTile]) -> None:
        """Become the map of which a checkpoint had this state and these tiles, under the same settings.

        Raises:
            LimitReached: it is more than the map may hold.
        """
        store = self._reserving(state.room)
        store.put(tiles)
        self.settings.check_bytes(store.nbytes)
        self.epoch, self.revision, self.stamp, self.cell_updates, known = state[:5]
        self.erasures = state.erasures
        self._extent = self._unknown()
        self._extent.stretched = state.stretched
        self._extent.know(known)
        self._begin_time(state.time)
        self._begin_store(store)

    def _unknown(self) -> Extent:
        """The extent of this map while nothing is known."""
        clip = self.settings.clip
        return Extent(self.settings.bounds_rect, None if clip is None else clip.rect)

    def _reserving(self, rect: CellRect) -> TileStore:
        """An empty store over `rect`, which lies in the clip, as all that grow from it will."""
        clip = self.settings.clip
        return TileStore(rect, self.model.planes, None if clip is None else clip.rect)

    def _begin_time(self, time: MapTime) -> None:
        self.time = time
        self._aging = Aging.by(time.ticks, self.model)

    def _begin_store(self, store: TileStore) -> None:
        """Take cells that have nothing to do with those of earlier snapshots."""
        self._store = store
        self._copies = None


def _rect_of(cells: NDArray[np.bool_], offset: tuple[int, int]) -> CellRect | None:
    """The smallest rectangle of every cell that is True; None if none is. [iy, ix], from `offset` on."""
    rows, columns = (np.flatnonzero(cells.any(axis=axis)).tolist() for axis in (1, 0))
    if not rows:
        return None
    size = columns[-1] - columns[0] + 1, rows[-1] - rows[0] + 1
    return CellRect(offset[0] + columns[0], offset[1] + rows[0], *size)
