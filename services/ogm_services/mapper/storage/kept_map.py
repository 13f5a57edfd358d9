"""Kept map: a mapper's map on disk, restored before all else, stored while the mapper works, closed last."""

import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from ogm_core.errors import BadSetting, printable
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.placing.state import StateParts, outcomes_of_gone, state_of
from ogm_core.status import SnapshotInfo, StoreInfo
from ogm_services.mapper.storage.checkpoints import Checkpoints, Encode, WrittenMap
from ogm_services.mapper.storage.failures import StoreFails
from ogm_services.mapper.storage.map_saver import MapSaver
from ogm_services.mapper.storage.map_store import MapStore
from ogm_services.mapper.storage.snapshots import Snapshots


class KeptMap:
    """The store of one mapper.

    The worker calls `offer`, any thread reads the properties; who starts and stops the mapper does the rest.
    """

    def __init__(self, folder: Path) -> None:
        """Open the store in `folder`; whoever does closes it.

        Raises:
            OgmError: as `MapStore`.
        """
        self._folder = folder
        self.snapshots = Snapshots(folder)
        """Any thread lists, reads and deletes them; `save` is below."""
        self._placing: Mapping[str, bytes] = {}
        self._saver = MapSaver(folder)
        self._saver.__enter__()
        self._checkpoints: Checkpoints | None = None
        self._closed = False

    @property
    def failing(self) -> str | None:
        """Why the map is not stored at present; None if it is."""
        return self._saver.failing

    @property
    def revision(self) -> int | None:
        """Of the map that was stored last; None before the first one."""
        return self._saver.revision

    def info(self) -> StoreInfo:
        """The status's `store`; waits for nobody."""
        failing = self.failing
        return StoreInfo(self.revision, None if failing is None else printable(failing), self._saver.nbytes)

    def restored(self, settings: GridSettings, run: str, start_map: Path | None) -> OccupancyGrid | None:
        """The map that is stored, now written by the process `run`; None if there is none.

        Raises:
            BadStore: the store is damaged.
            BadSetting: the settings contradict those that it was made with, or another map is to be started.
        """

        def read(store: MapStore) -> OccupancyGrid | None:
            if start_map is not None and not store.empty:
                raise BadSetting(
                    f"mapper.start_map: {start_map}: {self._folder} has a map already, which goes on: leave "
                    "mapper.start_map out, or give an empty folder as mapper.data"
                )
            restored = store.restore(settings)
            if restored is None:
                return None
            self._placing = restored.placing
            return restored.grid

        grid = self._saver.do(read)
        if grid is not None:
            grid.run = run
        return grid

    def go_on(self, live_map: WrittenMap, settings: GridSettings, run: str, placer: ScanPlacer) -> None:
        """Have the placer go on where the stored one was; from here on `offer` may be called.

        Raises:
            BadState: what is stored of a robot is damaged.
        """
        state, of_gone = state_of(self._placing), outcomes_of_gone(self._placing)
        placer.restore(state, time.monotonic(), outcomes_of_gone=of_gone)
        parts = StateParts(state, of_gone)
        self._placing = {}

        def take() -> Encode:
            return partial(parts.changes, placer.state(), placer.outcomes_of_gone)

        self._checkpoints = Checkpoints(live_map, settings, run, take)

    def offer(self) -> None:
        """Worker, between two messages: take a checkpoint if one is wanted."""
        if self._checkpoints is not None:
            self._checkpoints.offer()

    def keep(self) -> None:
        """Store the map once a second from now on; the worker runs."""
        if self._checkpoints is not None:
            self._saver.keep(self._checkpoints.take)

    def save(self, name: str) -> SnapshotInfo:
        """Save the map of this moment under a name. Any thread but the worker; the worker runs.

        Raises:
            OgmError: as `MapSaver.save`.
        """
        return self._saver.save(name)

    def store_now(self) -> None:
        """Store the map of this moment: it is on the disk when this returns. Any thread but the worker.

        Raises:
            OgmError: it cannot be stored now; that is tried again.
        """
        self._saver.store_now()

    def finish(self) -> None:
        """Begin to store what is not stored yet, if the map was kept; `close` waits for it.

        The worker runs no more, or never has.
        """
        if self._checkpoints is not None:
            self._checkpoints.worker_stopped()
        self._saver.finish()

    def close(self) -> None:
        """Store what is not stored yet, and let go of the store. Once is enough.

        The worker runs no more, or never has.

        Raises:
            StoreFails: what is not stored yet cannot be.
        """
        if self._closed:
            return
        self._closed = True
        self.finish()
        self._saver.__exit__()
        if self.failing is not None:
            raise StoreFails(
                f"the map is not stored as it was in the end, but as of revision {self.revision or 0}: "
                f"{self.failing}"
            )
