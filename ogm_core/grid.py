"""The occupancy map: scans and sensor poses in, snapshots out."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.model import StoredCells
from ogm_core.errors import LimitReached
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.sensor_models.evidence import Evidence, observe
from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.copies import TileCopies, copy_tiles, room_for
from ogm_core.tiles.store import TileStore, tiles_met
from ogm_core.tiles.view import Pictures, TileView
from ogm_core.types import PlacedScan, Pose, Scan, Sweep


class OccupancyGrid:
    """A map built up by `integrate`, unbounded or bounded. One thread writes; readers get snapshots.

    Equal scans and poses in equal order give equal cells.
    """

    def __init__(self, settings: GridSettings, epoch: str = "") -> None:
        """Make an empty map; `epoch` is the id of its life until the next `reset`."""
        self.settings = settings
        self.model = settings.cell_model
        self.lattice, self.bounds = settings.lattice, settings.bounds_rect
        self._copies: TileCopies | None = None
        self._pictures: Pictures = {}
        self.reset(epoch)

    def reset(self, epoch: str) -> None:
        """Forget every cell and begin again at revision 0 under a new `epoch`."""
        self.epoch = epoch
        self.revision = 0
        self.stamp: int | None = None
        self.cell_updates = 0
        self._known: CellRect | None = None
        self._begin_store(TileStore(self.bounds or CellRect(0, 0, 0, 0), self.model.dtype))

    @property
    def nbytes(self) -> int:
        """Bytes that the map has allocated."""
        return self._store.nbytes

    @property
    def rect(self) -> CellRect:
        """What is served: the bounds, or else the smallest rectangle that holds every known cell."""
        return self.bounds or self._known or CellRect(0, 0, 0, 0)

    def begin_with(self, cells: StoredCells) -> None:
        """Fill a map without bounds: `cells` are stored cells, [iy, ix], the first one (0, 0) of the lattice.

        The revision stays 0: it counts scans.

        Raises:
            LimitReached: they are more than the map may hold; no cell has changed.
        """
        height, width = cells.shape
        rect = CellRect(0, 0, width, height)
        if rect.cells > self.settings.max_cells:
            raise LimitReached(
                f"{width} x {height} cells are more than max_cells = {self.settings.max_cells}"
            )
        store = TileStore(rect, self.model.dtype)
        store.write(rect, cells)
        if store.nbytes > self.settings.max_bytes:
            raise LimitReached(f"{store.nbytes} bytes are more than max_bytes = {self.settings.max_bytes}")
        known = self.model.known(cells)
        rows, columns = np.flatnonzero(known.any(axis=1)).tolist(), np.flatnonzero(known.any(axis=0)).tolist()
        self._known = None
        if rows:
            ix, iy = columns[0], rows[0]
            self._known = CellRect(ix, iy, columns[-1] - ix + 1, rows[-1] - iy + 1)
        self._begin_store(store)

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None) -> int:
        """Add a scan taken at the sensor's `pose` in the map frame; return the number of cell updates.

        With a `sweep` every beam starts where the sensor was then (model `beam`), or the whole scan at mid
        sweep (`sector`).

        Raises:
            LimitReached: it would stretch the map past a limit; no cell has changed.
            OutsideBounds: every beam that counts leaves a map that drops such beams; no cell has changed.
        """
        try:
            updates = self._update(observe(PlacedScan(scan, pose, sweep), self.settings))
        except MemoryError as error:
            raise LimitReached("the system has no memory left for the map") from error
        self.revision += 1
        self.stamp = scan.stamp if self.stamp is None else max(self.stamp, scan.stamp)
        self.cell_updates += updates
        return updates

    def room_for_snapshot(self) -> Callable[[], NDArray[Any]]:
        """What makes memory ready for the next snapshot: call it while another thread goes on writing."""
        return partial(room_for, self._store, self._copies)

    def snapshot(self, room: NDArray[Any] | None = None) -> MapSnapshot:
        """A copy of what is served, with the identity of its revision.

        Only tiles that were written since the last snapshot are copied, into `room` if it is large enough.
        """
        self._copies = copy_tiles(self._store, self.revision, self._copies, room)
        return MapSnapshot(
            stored=TileView(self._copies, self.rect, self.model.dtype, self._pictures),
            model=self.model,
            lattice=self.lattice,
            offset=(self.rect.ix, self.rect.iy),
            epoch=self.epoch,
            revision=self.revision,
            stamp=self.stamp,
        )

    def _begin_store(self, store: TileStore) -> None:
        """Take cells that have nothing to do with those of earlier snapshots."""
        self._store = store
        self._copies = None
        self._pictures = {}

    def _update(self, evidence: Evidence) -> int:
        updated = evidence.extent()
        if self.bounds is not None:
            updated = updated.intersection(self.bounds)
        if updated.cells == 0:
            return 0
        known = updated if self._known is None else self._known.union(updated)
        if known.cells > self.settings.max_cells:
            raise LimitReached(f"{known.width} x {known.height} cells would be more than max_cells")
        store = self._store
        if not store.rect.contains(updated):
            store = store.grown(updated, self.settings.max_bytes)
        inside = self.bounds or store.rect
        self._check_bytes(store, updated, evidence)
        if store is not self._store:
            store.take(self._store)
            self._store = store
        window = evidence.window(store, inside)
        updates = evidence.update_cells(store, window, self.revision + 1, self.model.constants)
        self._known = known
        return updates

    def _check_bytes(self, store: TileStore, updated: CellRect, evidence: Evidence) -> None:
        """Refuse a scan whose tiles would exceed `max_bytes`: first by a cheap bound, then exactly."""
        room = (self.settings.max_bytes - store.nbytes) // store.tile_bytes
        if tiles_met(updated) <= room or store.untouched_tiles(updated) <= room:
            return
        fresh = evidence.new_tiles(store, evidence.window(store, self.bounds or store.rect))
        if fresh > room:
            raise LimitReached(f"{fresh} more tiles of {store.tile_bytes} bytes would exceed max_bytes")
