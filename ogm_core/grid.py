"""Occupancy grid mapping with known poses: scans and sensor poses in, snapshots out."""

from ogm_core.cells.forgetting import MapTime
from ogm_core.errors import SMALLER_MAP, LimitReached
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.sensor_models.evidence import Evidence, may_be_refused, observe
from ogm_core.sensor_models.one_call import OneCall
from ogm_core.sensor_models.update_threads import SPOILT, UpdateThreads
from ogm_core.shares import Reached
from ogm_core.tiled_map import TiledMap
from ogm_core.tiles.aging import Aging
from ogm_core.tiles.checkpoint import NOBODY
from ogm_core.tiles.store import TileStore
from ogm_core.types import PlacedScan, Pose, Scan, Sweep


class OccupancyGrid(TiledMap):
    """A map built up by `integrate`, unbounded or bounded. One thread writes; readers get snapshots.

    Equal scans and poses in equal order give equal cells.
    """

    def __init__(self, settings: GridSettings, epoch: str = "", run: str = "") -> None:
        """Make an empty map; `epoch` is the id of its life until the next `reset`.

        `run` is the id of the process that writes it: another one may reach the same revision by other scans.
        """
        super().__init__(settings, epoch, run)
        self.max_bytes = settings.max_bytes
        """What the map may hold from now on; less than it holds: it gets no new tiles."""
        self._one_call = OneCall.into(settings, self.model)
        self.threads: UpdateThreads | None = None
        """What updates the cells of large scans, if not this thread alone; who gives it closes it."""

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
        if extent.clip is None or extent.stretched is None:
            return False
        reached = Reached.by(placed, self.lattice, settings.distances[2])
        if reached.meets(extent.clip) or not reached.lies_in(extent.stretched):
            return False
        in_bounds = extent.whole_bounds is None or reached.lies_in(extent.whole_bounds)
        return in_bounds and not may_be_refused(placed.scan, settings)

    def _add_at_once(self, placed: PlacedScan) -> int | None:
        """Add a scan for whose cells there is room, if it is a simple one; else None."""
        one_call, threads, beams = self._one_call, self.threads, placed.scan.ranges.size
        if one_call is None:
            return None
        team, lines = None, one_call.into_plane
        if threads is not None:
            if lines is not None:
                team = threads.team(self._store, beams, *lines)
            elif threads.wanted(beams):
                return None
        place = self._extent, self._store, self.max_bytes, self.revision + 1
        try:
            updates = one_call.integrate(placed, *place, team)
        except MemoryError as error:
            if team is not None and team.settle():
                raise RuntimeError(SPOILT) from error
            raise
        if threads is not None and updates is not None:
            work = updates * one_call.cell_work
            if lines is None:
                threads.alone(beams, work)
            elif team is not None or work >= threads.worth_a_team:
                threads.finished(team, beams, work)
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
