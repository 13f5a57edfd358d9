"""The occupancy map: scans and sensor poses in, snapshots out."""

from ogm_core import beams, bresenham
from ogm_core.errors import LimitReached, OutsideBounds
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.projection import Ends, end_cells
from ogm_core.snapshot import MapSnapshot
from ogm_core.strips import StripStore
from ogm_core.types import Pose, Scan


class OccupancyGrid:
    """A map built up by `integrate`, unbounded or bounded. One thread writes; readers get snapshots.

    Equal scans and poses in equal order give equal cells.
    """

    def __init__(self, settings: GridSettings, epoch: str = "") -> None:
        """Make an empty map; `epoch` is the id of its life until the next `reset`."""
        self.settings = settings
        self.model = settings.model
        self.lattice, self.bounds = settings.lattice()
        self.reset(epoch)

    def reset(self, epoch: str) -> None:
        """Forget every cell and begin again at revision 0 under a new `epoch`."""
        self.epoch = epoch
        self.revision = 0
        self.stamp: int | None = None
        self.cell_updates = 0
        self._known: CellRect | None = None
        self._store = StripStore(self.bounds or CellRect(0, 0, 0, 0), self.model.dtype)

    @property
    def nbytes(self) -> int:
        """Bytes that the map has allocated."""
        return self._store.nbytes

    @property
    def rect(self) -> CellRect:
        """What is served: the bounds, or else the smallest rectangle that holds every known cell."""
        return self.bounds or self._known or CellRect(0, 0, 0, 0)

    def integrate(self, scan: Scan, pose: Pose) -> int:
        """Add a scan taken at the sensor's `pose` in the map frame; return the number of cell updates.

        Raises:
            LimitReached: it would stretch the map past a limit; no cell has changed.
            OutsideBounds: every beam that counts leaves a map that drops such beams; no cell has changed.
        """
        ends, start = end_cells(scan, pose, self.lattice, self.settings)
        if self.bounds is not None and self.settings.outside == "drop":
            counted, dropped = beams.drop_outside(ends, *start, *self.bounds)
            if counted and dropped == counted:
                raise OutsideBounds(f"all {counted} beams start or end outside the bounds")
        updates = self._update(ends, start)
        self.revision += 1
        self.stamp = scan.stamp if self.stamp is None else max(self.stamp, scan.stamp)
        self.cell_updates += updates
        return updates

    def snapshot(self) -> MapSnapshot:
        """A copy of what is served, with the identity of its revision."""
        return MapSnapshot(
            cells=self._store.read(self.rect),
            model=self.model,
            lattice=self.lattice,
            offset=(self.rect.ix, self.rect.iy),
            epoch=self.epoch,
            revision=self.revision,
            stamp=self.stamp,
        )

    def _update(self, ends: Ends, start: tuple[int, int]) -> int:
        updated = CellRect(*bresenham.extent(ends, *start))
        if self.bounds is not None:
            updated = updated.intersection(self.bounds)
        if updated.cells == 0:
            return 0
        known = updated if self._known is None else self._known.union(updated)
        if known.cells > self.settings.max_cells:
            raise LimitReached(f"{known.width} x {known.height} cells would be more than max_cells")
        store = self._store
        if not store.rect.contains(updated):
            store = store.grown(updated)
        # From here on cells are counted from the store's corner.
        ends[0] -= store.rect.ix
        ends[1] -= store.rect.iy
        width, height = (self.bounds or store.rect)[2:]
        beams_in_store = ends, start[0] - store.rect.ix, start[1] - store.rect.iy, width, height
        self._check_bytes(store, updated, beams_in_store)
        if store is not self._store:
            store.take(self._store)
            self._store = store
        store.tiles_used += bresenham.touch_tiles(*beams_in_store, store.touched, self.revision + 1)
        updates = bresenham.update_cells(*beams_in_store, store.cells, store.column, self.model.update)
        self._known = known
        return int(updates)

    def _check_bytes(
        self, store: StripStore, updated: CellRect, beams_in_store: tuple[Ends, int, int, int, int]
    ) -> None:
        """Refuse a scan whose tiles would exceed `max_bytes`: first by a cheap bound, then exactly."""
        room = (self.settings.max_bytes - store.nbytes) // store.tile_bytes
        if store.untouched_tiles(updated) <= room:
            return
        fresh = bresenham.touch_tiles(*beams_in_store, store.touched.copy(), self.revision + 1)
        if fresh > room:
            raise LimitReached(f"{fresh} more tiles of {store.tile_bytes} bytes would exceed max_bytes")
