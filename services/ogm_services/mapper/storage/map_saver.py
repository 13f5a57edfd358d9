"""Map saver: the one thread that has the store, and stores the map once a second while it is mapped."""

import logging
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, wait
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Self, TypeVar

from ogm_core.errors import OgmError
from ogm_core.grid_settings import GridSettings
from ogm_core.status import SnapshotInfo
from ogm_core.tiles.checkpoint import Checkpoint
from ogm_services.mapper.storage.failures import StoreFails
from ogm_services.mapper.storage.map_store import MapStore
from ogm_services.runtime.limited_log import LimitedLog

PERIOD = 1.0
"""The map is stored at most so often, s."""
SHARE = 0.2
"""Of the time: a commit that takes longer than this part of a period is followed by a longer rest."""

_LOOK_PERIOD = 0.1
"""How often who has asked looks whether the store is closed, s."""

log = logging.getLogger(__name__)
_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class Taken:
    """What is stored in one transaction: the map after an exact scan, and what goes with it."""

    checkpoint: Checkpoint
    settings: GridSettings
    run: str
    placing: Mapping[str, bytes | None] = field(default_factory=dict)
    """The parts of the placing state that have changed since the last one that was taken."""


class MapSaver:
    """A store and its thread, as a context manager. Any thread asks it."""

    def __init__(self, folder: Path, period: float = PERIOD) -> None:
        self._folder = folder
        self._period = period
        self._jobs: SimpleQueue[tuple[Callable[[MapStore], Any], Future[Any]] | None] = SimpleQueue()
        self._opened: Future[None] = Future()
        self._thread = threading.Thread(target=self._run, name="ogm-store")
        self._take: Callable[[], Taken] | None = None
        self._failing: str | None = None
        self.revision: int | None = None
        """Of the map that was stored last; None before the first one. Any thread."""
        self.nbytes = 0
        """Of the store's files then. Any thread."""
        self._complaints = LimitedLog(log)

    def __enter__(self) -> Self:
        """Open the store.

        Raises:
            OgmError: as `MapStore`.
        """
        self._thread.start()
        try:
            self._opened.result()
        except BaseException:
            self._thread.join()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Store what is not stored yet, and close the store."""
        self.finish()
        self._thread.join()

    def finish(self) -> None:
        """Begin to do so, after what it is at; wait for nothing."""
        self._jobs.put(None)

    @property
    def failing(self) -> str | None:
        """Why the map is not stored at present; None if it is. It is mapped all the same, in memory."""
        return self._failing

    def keep(self, take: Callable[[], Taken]) -> None:
        """From now on store what `take` gives, once a period; it is called on the saver's thread.

        An `OgmError` that it raises is why nothing can be stored now.
        """
        self._take = take

    def do(self, job: Callable[[MapStore], _T]) -> _T:
        """What `job` makes of the store, on its thread, after what it is at; what it raises is raised.

        Raises:
            StoreFails: the store is closed.
        """
        done: Future[_T] = Future()
        self._jobs.put((job, done))
        while not wait([done], _LOOK_PERIOD).done:
            if not self._thread.is_alive() and not done.done():
                raise StoreFails(f"{self._folder}: the mapper is stopping, and the store is closed")
        return done.result()

    def store_now(self) -> None:
        """Store the map of this moment, if it is kept: it is on the disk when this returns.

        Raises:
            OgmError: it cannot be stored now.
        """
        self.do(self._stored_now)

    def save(self, name: str) -> SnapshotInfo:
        """Save the map of this moment under a name.

        Raises:
            OgmError: it cannot be stored now, or as `Snapshots.save`.
        """
        return self.do(lambda store: store.save(name, self._stored_now(store)))

    def _stored_now(self, store: MapStore) -> str | None:
        """Store the map of this moment; the run of who writes it, if it is kept."""
        if self._take is None:
            return None
        taken = self._take()
        self._commit(store, taken)
        return taken.run

    def _run(self) -> None:
        try:
            store = MapStore(self._folder)
        except BaseException as error:  # noqa: BLE001 (it is raised where the store is opened)
            self._opened.set_exception(error)
            return
        with store:
            self._opened.set_result(None)
            due = time.monotonic() + self._period
            while True:
                try:
                    item = self._jobs.get(timeout=max(0.0, due - time.monotonic()))
                except Empty:
                    began = time.monotonic()
                    self._look(store)
                    now = time.monotonic()
                    due = max(began + self._period, now + (now - began) * (1.0 / SHARE - 1.0))
                    continue
                if item is None:
                    break
                _done(*item, store)
            self._look(store)

    def _look(self, store: MapStore) -> None:
        """Store what is not stored yet, and say it when that does not work, or works again."""
        if self._take is None:
            return
        try:
            self._commit(store, self._take())
        except OgmError as error:
            self._failing = str(error)
            self._complaints.warning(
                "store", f"{error}: the map goes on in memory; storing it is tried again"
            )
        except Exception:  # noqa: BLE001 (logged with its traceback)
            self._failing = f"{self._folder}: storing the map has failed by a bug: the log has it"
            self._complaints.failure("storing the map")
        else:
            if self._failing is not None:
                log.info("%s: the map is stored again, with all that was not", self._folder)
            self._failing = None

    def _commit(self, store: MapStore, taken: Taken) -> None:
        if self._failing is not None or taken.placing or not store.holds(taken.checkpoint):
            store.commit(taken.checkpoint, taken.settings, taken.run, taken.placing)
        self.revision, self.nbytes = taken.checkpoint.state.revision, store.nbytes


def _done(job: Callable[[MapStore], Any], done: Future[Any], store: MapStore) -> None:
    try:
        done.set_result(job(store))
    except BaseException as error:  # noqa: BLE001 (it is raised where the job was asked for)
        done.set_exception(error)
