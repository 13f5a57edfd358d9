"""Occupancy grid mapping with known poses: scans and sensor poses in, snapshots out."""

from collections.abc import Callable, Iterable
from functools import partial

import numpy as np

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.compiled import compiled
from ogm_core.cells.forgetting import MapTime
from ogm_core.cells.model import CellModel, Planes
from ogm_core.errors import SMALLER_MAP, BadParameter, LimitReached, MapEmpty, OutsideBounds
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.sensor_models.evidence import Evidence, may_be_refused, observe
from ogm_core.sensor_models.one_call import OneCall
from ogm_core.sensor_models.update_threads import UpdateThreads
from ogm_core.shares import in_reach
from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.aging import Aging
from ogm_core.tiles.checkpoint import NOBODY, Checkpoint, KeptCells, KeptTile, MapState
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
from ogm_core.types import PlacedScan, Pose, Scan, Sweep


class OccupancyGrid:
    """A map built up by `integrate`, unbounded or bounded. One thread writes; readers get snapshots.

    Equal scans and poses in equal order give equal cells.
    """

    def __init__(self, settings: GridSettings, epoch: str = "", run: str = "") -> None:
        """Make an empty map; `epoch` is the id of its life until the next `reset`.

        `run` is the id of the process that writes it: another one may reach the same revision by other scans.
        """
        self.settings = settings
        self.run = run
        self.model: CellModel = compiled(settings.cell_model)
        self.max_bytes = settings.max_bytes
        """What the map may hold from now on; less than it holds: it gets no new tiles."""
        self.lattice, self.bounds = settings.lattice, settings.clipped_bounds
        """Its lattice, and the cells that it keeps if it is bounded."""
        self._one_call = OneCall.into(settings, self.model)
        self.time: MapTime
        """How far its time has come, and its ticks: of a map with a half-life."""
        self._aging: Aging | None
        self._store: TileStore
        self._copies: TileCopies | None = None
        self.kept_bytes = 0
        """What copies for a checkpoint hold that none of what is served shares."""
        self.threads: UpdateThreads | None = None
        """What updates the cells of large scans, if not this thread alone; who gives it closes it."""
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
        if store.nbytes > self.settings.max_bytes:
            raise LimitReached(f"{store.nbytes} bytes are more than max_bytes = {self.settings.max_bytes}")
        rows = np.flatnonzero(written.any(axis=1)).tolist()
        columns = np.flatnonzero(written.any(axis=0)).tolist()
        if rows:
            size = columns[-1] - columns[0] + 1, rows[-1] - rows[0] + 1
            extent.stretched = CellRect(offset[0] + columns[0], offset[1] + rows[0], *size)
            kept = extent.kept(extent.stretched)
            extent.know(kept if kept.cells else None)
        self._extent = extent
        self._begin_store(store)

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None, robot: str = NOBODY) -> int:
        """Add a scan taken at the sensor's `pose` in the map frame; return the number of cell updates.

        With a `sweep` every beam starts where the sensor was then (sensor model `beam`), or the whole scan at
        mid sweep (`sector`). (Thrun, Burgard & Fox 2005, table 9.1; docs/method.md.)
        `robot` took it: for maps that keep robots apart (see separate_grid).

        Raises:
            LimitReached: it would stretch the map past a limit; no cell has changed.
            OutsideBounds: every beam that counts leaves a map that drops such beams; no cell has changed.
        """
        time, aging = self._time_after(scan.stamp)
        placed = PlacedScan(scan, pose, sweep)
        try:
            updates = 0 if self._is_elsewhere(placed) else self._add_at_once(placed)
            if updates is None:
                # What the scan says: about which cells, and which of them are this map's.
                evidence = observe(placed, self.settings)
                updated = self._extent.counted(evidence.extent())
                updates = self._add(evidence, updated, aging) if updated.cells else 0
        except MemoryError as error:
            raise LimitReached(
                f"the system has no memory left for the map: {SMALLER_MAP}", "memory"
            ) from error
        self._note(scan.stamp, time, aging)
        self.cell_updates += updates
        return updates

    def _is_elsewhere(self, placed: PlacedScan) -> bool:
        """Whether a scan reaches no cell of the clip, and is not refused: nobody looks at its beams then.

        What limits count does not grow by it either.
        """
        extent, settings = self._extent, self.settings
        if extent.clip is None or extent.stretched is None or may_be_refused(placed.scan, settings):
            return False
        reached = in_reach(placed, self.lattice, settings.distances[2])
        return (
            not reached.meets(extent.clip)
            and extent.stretched.contains(reached)
            and extent.counted(reached) == reached
        )

    def _add_at_once(self, placed: PlacedScan) -> int | None:
        """Add a scan that tells of known parts of the map alone; None if it does not, or not simply so."""
        beams, threads = placed.scan.ranges.size, self.threads
        if self._one_call is None or (threads is not None and threads.wanted(beams)):
            return None
        place = self._extent, self._store, self.max_bytes, self.revision + 1
        updates = self._one_call.integrate(placed, *place)
        if threads is not None and updates is not None:
            work = updates * self._one_call.cell_work
            if work >= threads.worth_sharing:
                threads.alone(beams, work)
        return updates

    def pass_over(self, stamp: int) -> None:
        """Count a scan of this stamp that is integrated elsewhere: none of its cells lies in the clip."""
        self._note(stamp, *self._time_after(stamp))

    def _time_after(self, stamp: int) -> tuple[MapTime, Aging | None]:
        """How far the map's time has come with the next scan."""
        if self.settings.tick is None:
            return self.time, self._aging
        time = self.time.after(stamp, self.revision + 1, self.settings.tick)
        return time, self._aging if time.ticks is self.time.ticks else Aging.by(time.ticks, self.model)

    def _note(self, stamp: int, time: MapTime, aging: Aging | None) -> None:
        """Note that there is one scan more."""
        self.revision += 1
        self.stamp = stamp if self.stamp is None else max(self.stamp, stamp)
        self.time, self._aging = time, aging

    def _add(self, evidence: Evidence, updated: CellRect, aging: Aging | None) -> int:
        """Refuse what is too large, grow, and update the cells of `updated`; return the number of updates.

        They have aged before.
        """
        extent = self._extent
        stretched = extent.stretched_by(updated)
        self.settings.check_known(stretched.width, stretched.height)
        if extent.clip is not None:
            # Maps of other clips may have room where this one has none: all go on taking the same scans.
            extent.stretched = stretched
            updated = extent.kept(updated)
            if not updated.cells:
                return 0

        store = self._make_room(evidence, updated)
        if aging is not None:
            aging.before_writing(store, updated, self.revision + 1)
        work = evidence, store, self._window(evidence, store), self.revision + 1
        if self.threads is None:
            updates = self.model.update(*work)
        else:
            updates = self.threads.update(self.model, updated, *work)
        extent.add(updated)
        return updates

    def _make_room(self, evidence: Evidence, updated: CellRect) -> TileStore:
        """Have a place for every cell that is updated; none changes."""
        self._store = self._store.admitting(
            updated, lambda store: evidence.new_tiles(store, self._window(evidence, store)), self.max_bytes
        )
        return self._store

    def _window(self, evidence: Evidence, store: TileStore) -> CellRect:
        return evidence.window(store, self.bounds or store.rect)

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
        if store.nbytes > self.settings.max_bytes:
            raise LimitReached(f"{store.nbytes} bytes are more than max_bytes = {self.settings.max_bytes}")
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
