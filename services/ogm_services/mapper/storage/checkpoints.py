"""Checkpoints of a map that is being written: the worker takes them between two messages, for the saver.

What has changed is copied by the saver's thread beforehand, while the worker goes on; the worker itself
copies what it has written meanwhile, if that is little, and else asks for more to be copied first.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import Future, wait
from typing import Protocol

from ogm_core.grid_settings import GridSettings
from ogm_core.tiles.checkpoint import Checkpoint
from ogm_core.tiles.copies import Tiles
from ogm_core.units import MEBIBYTE
from ogm_services.mapper.storage.failures import StoreFails
from ogm_services.mapper.storage.map_saver import Taken

LITTLE = MEBIBYTE
"""So much the worker copies itself, bytes: some tenths of a millisecond; twice that if that is too little."""
MUCH = 8 * MEBIBYTE
"""... and so on, up to so much: some milliseconds."""
TRIES = 12
"""So often no more is waited for; then the worker copies what there is."""
LOOK_PERIOD = 0.1
"""How often it is looked whether the worker has stopped, s."""
PATIENCE = 10.0
"""How long a message may keep the worker from a checkpoint, s."""

Encode = Callable[[], Mapping[str, bytes | None]]
_Taken = tuple[Checkpoint, Encode]


class WrittenMap(Protocol):
    """A map while it is written (a `live.live_map.LiveMap`)."""

    def copy_ahead(self) -> Tiles:
        """Copy what has changed while the writer goes on; memory for what the writer has to copy then."""

    def checkpoint(self, most: int | None = None, room: Tiles | None = None) -> Checkpoint | None:
        """Writer: the map as it is now; None if more than `most` bytes would have to be copied."""


class Checkpoints:
    """Where worker and saver meet."""

    def __init__(
        self, live_map: WrittenMap, settings: GridSettings, run: str, placing: Callable[[], Encode]
    ) -> None:
        """`placing`, called on the worker's thread, takes what has changed since it was last called.

        What it returns makes bytes of it, on the saver's thread.
        """
        self._live_map = live_map
        self._settings = settings
        self._run = run
        self._placing = placing
        self._most: int | None = LITTLE
        self._room: Tiles | None = None
        self._wanted: Future[_Taken | None] | None = None
        self._stopped = False

    def offer(self) -> None:
        """Worker, between two messages: take a checkpoint if one is wanted. Costs nothing if not."""
        wanted = self._wanted
        if wanted is None:
            return
        self._wanted = None
        if not wanted.set_running_or_notify_cancel():
            return
        try:
            wanted.set_result(self._taken())
        except BaseException as error:  # noqa: BLE001 (it is raised where it was asked for)
            wanted.set_exception(error)

    def worker_stopped(self) -> None:
        """Nobody writes the map any more: whoever takes a checkpoint does it alone."""
        self._stopped = True

    def take(self) -> Taken:
        """Saver: the map after an exact scan, and what goes with it.

        Raises:
            StoreFails: the worker has not come to it for PATIENCE.
        """
        for attempt in range(TRIES):
            self._most = min(LITTLE << attempt, MUCH) if attempt + 1 < TRIES else None
            self._room = self._live_map.copy_ahead()
            taken = self._asked_for()
            if taken is not None:
                checkpoint, encode = taken
                return Taken(checkpoint, self._settings, self._run, encode())
        raise AssertionError("the last try takes whatever there is")

    def _asked_for(self) -> _Taken | None:
        wanted: Future[_Taken | None] = Future()
        self._wanted = wanted
        waited = 0.0
        while True:
            if self._stopped:
                self.offer()
            if wait([wanted], LOOK_PERIOD).done:
                return wanted.result()
            waited += LOOK_PERIOD
            if waited >= PATIENCE and wanted.cancel():
                raise StoreFails(f"the mapper has been at one message for {PATIENCE:g} s")

    def _taken(self) -> _Taken | None:
        room, self._room = self._room, None
        checkpoint = self._live_map.checkpoint(self._most, room)
        return None if checkpoint is None else (checkpoint, self._placing())
