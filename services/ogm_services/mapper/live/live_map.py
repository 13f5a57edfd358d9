"""Live map, the map while it is written: one writer, and any number of readers with copies."""

import threading
from typing import NamedTuple, cast

from ogm_core.errors import LimitReached, NoRoom
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Lattice, Region
from ogm_core.sensor_models.update_threads import UpdateThreads
from ogm_core.separate_grid import SeparateGrid
from ogm_core.snapshot import MapSnapshot
from ogm_core.status import MapInfo
from ogm_core.tiles.checkpoint import NOBODY, Checkpoint
from ogm_core.tiles.copies import Tiles
from ogm_core.tiles.polygon import Polygon
from ogm_core.tiles.view import TileView
from ogm_core.types import PlacedScan, Pose, Scan, Sweep
from ogm_core.units import MEBIBYTE
from ogm_services.mapper.live.identity import Identity
from ogm_services.mapper.live.live_figures import Judged, LiveFigures, MapWithFigures
from ogm_services.mapper.live.map_memory import MapMemory
from ogm_services.mapper.live.recent_scans import RECENT_BYTES, RecentScans
from ogm_services.runtime.memory import MemoryUse

_MUCH = 4 * MEBIBYTE
"""More than this the writer does not wait for after a tick, bytes: some milliseconds."""


class _State(NamedTuple):
    """What is told of a map without a look at its cells."""

    identity: Identity
    rect: CellRect
    nbytes: int
    robots: tuple[str, ...] | None


class Ahead(NamedTuple):
    """A copy of the map, the newest scans in the map that the copy has not, and how many the map has."""

    copy: MapSnapshot
    settings: GridSettings
    newest: list[PlacedScan]
    scans: int


class LiveMap(MapWithFigures):
    """An `OccupancyGrid` with one writer and many readers.

    Who owns what: only the worker thread calls `integrate`, `reset`, `become`, `erase` and `forget`, and
    `_writing` is held while kernels run, on it and on the `threads` that help it, or tiles that have changed
    are copied out. After each change the writer replaces `_state`, a tuple that nobody changes: whoever reads
    it waits for nobody. Readers (HTTP and Zenoh threads) share the newest snapshot, which nobody changes;
    `_reading` keeps them from making the same copy twice. `LiveFigures` have locks of their own, so that who
    waits for them holds up nobody else.
    """

    def __init__(
        self, grid: OccupancyGrid, memory: MemoryUse | None = None, threads: UpdateThreads | None = None
    ) -> None:
        """`memory`: what others hold beside the map, which gets new tiles only while all of it has room.

        `threads` update the cells of large scans, if not the writer alone; who gives them closes them.
        """
        self._grid = grid
        self._threads = grid.threads = threads
        self._memory = memory
        self._map_memory = None if memory is None else MapMemory(memory, self._copies_bytes)
        # A share tells no figures of scans, and keeps none: most would be of places that it does not map.
        wanted = 0 if grid.settings.share is not None else RECENT_BYTES
        self._recent = RecentScans(wanted if memory is None or not wanted else memory.share(wanted))
        self._writing = threading.Lock()
        self._reading = threading.Lock()
        self._snapshot: MapSnapshot | None = None
        self._view: TileView | None = None
        self._copied = 0
        self._state = self._told()
        super().__init__(LiveFigures(lambda: self.now, lambda: self.snapshot().known_cells, self._to_judge))
        if memory is not None:
            memory.add("map", lambda: self._state.nbytes)
            memory.add("copies", self._copies_bytes)
            memory.add("recent", lambda: self._recent.nbytes, self._recent.share)

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None, robot: str = NOBODY) -> int:
        """Writer: add a scan taken at its sensor's pose; see `OccupancyGrid.integrate`."""
        with self._writing:
            if self._map_memory is not None:
                allowed = self._map_memory.allowed(self._state.nbytes)
                self._grid.max_bytes = min(self._grid.settings.max_bytes, allowed)
            try:
                updates = self._grid.integrate(scan, pose, sweep, robot)
            except NoRoom as refusal:
                raise self._reason_of(refusal) from refusal
            grew, self._state = self._grid.nbytes > self._state.nbytes, self._told()
            self._recent.append(PlacedScan(scan, pose, sweep))
            if grew and self._memory is not None:
                self._memory.make_room()
            return updates

    def reset(self, epoch: str) -> None:
        """Writer: empty the map."""
        with self._writing:
            self._grid.reset(epoch)
            self._state = self._told()
            self._recent.clear()

    def become(self, grid: OccupancyGrid) -> None:
        """Writer: go on with another map on the same lattice, which is this one's from now on.

        Its epoch is none that this map has had; its run is this process's.
        """
        with self._writing:
            self._grid = grid
            grid.threads = self._threads
            self._state = self._told()
            self._recent.clear()

    def erase(self, area: Polygon) -> int:
        """Writer: make the cells of an area unknown; see `OccupancyGrid.erase`.

        Scans of before are no measure of what is left: the live consistency begins anew.
        """
        with self._writing:
            erased = self._grid.erase(area)
            self._state = self._told()
            self._recent.clear()
            return erased

    def forget(self, robot: str) -> None:
        """Writer: leave a robot out of a map that keeps robots apart; see `SeparateGrid.forget`.

        The live consistency begins anew, as after an erasure.
        """
        with self._writing:
            cast(SeparateGrid, self._grid).forget(robot)
            self._state = self._told()
            self._recent.clear()

    def copy_ahead(self) -> Tiles:
        """Copy what has changed while the writer goes on: `checkpoint` has next to nothing left to copy.

        Returns memory for that.
        """
        with self._writing:
            aheads = self._grid.copies_ahead()
        copies = [(ahead, ahead.made()) for ahead in aheads]
        with self._writing:
            for ahead, made in copies:
                self._grid.take_ahead(ahead, made)
            make_room = self._grid.room_for_checkpoint()
        return make_room()

    def checkpoint(self, most: int | None = None, room: Tiles | None = None) -> Checkpoint | None:
        """Writer: the map as it is now, for a store; None if more than `most` bytes were to be copied.

        They are copied into `room` if it is large enough: into new memory that takes many times longer.
        """
        with self._writing:
            # Before the first scan what the map began with counts as uncopied, and nobody waits for the lock.
            if most is not None and self._grid.revision and self._grid.uncopied_bytes > most:
                return None
            return self._grid.checkpoint(room)

    @property
    def now(self) -> Identity:
        """Epoch, revision and stamp of this moment; waits for nobody."""
        return self._state.identity

    @property
    def settings(self) -> GridSettings:
        """What the map is made with."""
        return self._grid.settings

    @property
    def free_below(self) -> float:
        """Which probabilities mean free."""
        return self._grid.settings.cell_model.free_below

    @property
    def finest(self) -> Lattice:
        """The lattice of the finest cells that are served."""
        return self._grid.settings.finest_lattice

    @property
    def time(self) -> int | None:
        """Writer: how far the time of a map that forgets has come, ns; None before its first scan."""
        return self._grid.time.time

    @property
    def robots(self) -> tuple[str, ...] | None:
        """The robots in a map that keeps them apart; None of others. Waits for nobody."""
        return self._state.robots

    def cells_in(self, region: Region | None, *, finest: bool = False) -> int:
        """How many cells of the map a region covers, None: all of them; waits for nobody.

        With `finest` those that are served of a model that has cells half as wide.

        Raises:
            BadParameter: the region is inverted or not finite.
        """
        rect = self._state.rect
        cells = rect.cells if region is None else rect.intersection(self._grid.lattice.cover(region)).cells
        return cells * self._grid.model.finest**2 if finest else cells

    def snapshot(self) -> MapSnapshot:
        """The map as it is now; the same object until it changes."""
        with self._reading:
            room = self._room()
            with self._writing:
                return self._current_snapshot(room)

    @property
    def newest_copy(self) -> MapSnapshot | None:
        """The newest snapshot that was taken, None if none was; waits for nobody."""
        return self._snapshot

    def ahead_of_copy(self) -> "Ahead | None":
        """What has come into the map since its newest copy, None if there is none of this life."""
        with self._writing:
            copy, grid = self._snapshot, self._grid
            if copy is None or copy.epoch != grid.epoch:
                return None
            scans = grid.revision - grid.erasures
            newest = list(self._recent)[max(0, len(self._recent) - (scans - copy.scans)) :]
            return Ahead(copy, grid.settings, newest, scans)

    def info(self) -> MapInfo:
        """The status's `map_info`; known cells may be as old as `LiveFigures.known_cells` says."""
        state = self._state
        return MapInfo(
            known_cells=self._figures.known_cells(),
            bytes=state.nbytes,
            width=state.rect.width,
            height=state.rect.height,
            resolution=self._grid.lattice.resolution,
            robots=None if state.robots is None else list(state.robots),
        )

    def _to_judge(self) -> Judged:
        with self._reading:
            room = self._room()
            with self._writing:
                snapshot = self._current_snapshot(room)
                updates = self._grid.cell_updates
                return Judged(snapshot.finest(), self._grid.settings, list(self._recent), updates)

    def _reason_of(self, refusal: NoRoom) -> LimitReached:
        """A refusal that names the limit which was reached."""
        if self._map_memory is None or self._grid.max_bytes >= self._grid.settings.max_bytes:
            return refusal
        return self._map_memory.refusal()

    def _copies_bytes(self) -> int:
        view = self._view
        return self._grid.kept_bytes + (0 if view is None else self._copied + view.nbytes)

    def _told(self) -> _State:
        """The state of the grid; the writer's."""
        grid = self._grid
        robots = grid.robots if isinstance(grid, SeparateGrid) else None
        return _State(Identity.of(grid), grid.rect, grid.nbytes, robots)

    def _room(self) -> Tiles | None:
        """Memory for the next snapshot; `_reading` is held, and the writer goes on meanwhile."""
        if self._snapshot is not None and Identity.of(self._snapshot) == self.now:
            return None
        self._copy_aged()
        with self._writing:
            make_room = self._grid.room_for_snapshot()
        return make_room()

    def _copy_aged(self) -> None:
        """Copy what has missed a tick (see tiles.aging), if that is much, while the writer goes on."""
        with self._writing:
            aged = self._grid.aged_bytes
            if aged <= _MUCH:
                return
            afresh = self._memory is not None and self._memory.left() < aged
            ahead = self._grid.aged_copy_ahead(afresh=afresh)
        if afresh:
            self._snapshot = self._view = None
        made = ahead.made()
        with self._writing:
            self._grid.take_ahead(ahead, made)

    def _current_snapshot(self, room: Tiles | None) -> MapSnapshot:
        """The newest snapshot, taken if need be; both locks are held."""
        known = self._snapshot
        if known is None or Identity.of(known) != Identity.of(self._grid):
            known = self._snapshot = self._grid.snapshot(room)
            self._view = cast(TileView, known.stored)
            self._copied = self._view.tiles.nbytes
            if self._memory is not None:
                self._memory.make_room()
        return known
