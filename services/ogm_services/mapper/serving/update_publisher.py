"""Update publisher: tells who follows the map over Zenoh what has changed, while anybody does."""

import logging
import threading
import time
from typing import Any, Final

import zenoh

from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.changes import ChangedTiles
from ogm_core.tiles.store import tile_bytes
from ogm_core.units import MEBIBYTE
from ogm_core.wire.map_changes import updates_of
from ogm_core.wire.map_update import MEDIA_TYPE, encode_update
from ogm_services.mapper.live.identity import Identity
from ogm_services.mapper.live.served_map import ServedMap
from ogm_services.mapper.serving.map_updates import bytes_to_tell, tiles_of
from ogm_services.replies.answer import Busy
from ogm_services.replies.in_flight import InFlight
from ogm_services.runtime.limited_log import LimitedLog

PERIOD: Final = 0.1
"""Between the beginnings of two messages, s; where they take long, half of it is left to others."""
HEARTBEAT: Final = 1.0
"""Between two messages about a map that does not change, s."""
MAX_TOLD: Final = 4 * MEBIBYTE
"""Cells of one message, bytes: of more, followers hear that it has changed, and ask."""

log = logging.getLogger(__name__)


class UpdatePublisher:
    """Puts map updates on a key, on a thread of its own. Started once, stopped once.

    While nobody subscribes it makes no copy of the map, and computes nothing.
    """

    def __init__(self, live_map: ServedMap, in_flight: InFlight) -> None:
        """`in_flight` says whether there is memory to make a message."""
        self._map = live_map
        self._in_flight = in_flight
        self._told: Identity | None = None
        """What those who listen have heard of; None: nobody listens."""
        self._sent = 0.0
        self._complaints = LimitedLog(log)
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, session: zenoh.Session, key: str) -> None:
        """Declare the publisher, and begin to look for followers."""
        # Maps wait for scans, and for nobody: who has missed a message asks.
        publisher = session.declare_publisher(
            key,
            encoding=MEDIA_TYPE,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA_LOW,
        )
        self._thread = threading.Thread(target=self._run, args=(publisher,), name="ogm-updates")
        self._thread.start()

    def stop(self) -> None:
        """Finish the message in hand, and end."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()

    def _run(self, publisher: zenoh.Publisher) -> None:
        pause = PERIOD
        while not self._stopping.wait(pause):
            begun = time.monotonic()
            try:
                self._look(publisher)
            except Busy:
                pass  # what has changed meanwhile is told with the next message
            except Exception:  # noqa: BLE001 - it is logged, with its traceback
                # A bug of ours, or a session that closes: followers miss a message, and ask.
                self._complaints.failure("telling followers what has changed")
            pause = max(begun + PERIOD - time.monotonic(), PERIOD / 2)
        publisher.undeclare()  # type: ignore[no-untyped-call]

    def _look(self, publisher: zenoh.Publisher) -> None:
        status: Any = publisher.matching_status  # a MatchingStatus; Zenoh's stub says bool
        if not status.matching:
            self._told = None
            return
        told, now = self._told, time.monotonic()
        if told is not None and told[:3] == self._map.now[:3] and now - self._sent < HEARTBEAT:
            return
        snapshot = self._map.snapshot()
        publisher.put(self._message(snapshot, told))
        self._told, self._sent = Identity.of(snapshot), now

    def _message(self, snapshot: MapSnapshot, told: Identity | None) -> bytes:
        """What has changed since `told`; that it has, where that is much, or nobody has been told before."""
        whole = told is not None and told.life != Identity.of(snapshot).life
        prev = 0 if whole or told is None else told.revision
        changed = ChangedTiles.since(tiles_of(snapshot), prev)
        if told is None or len(changed) * tile_bytes(snapshot.model.planes) > MAX_TOLD:
            prev, whole = snapshot.revision, False
            changed = ChangedTiles(changed.copies, changed.tx[:0], changed.ty[:0])
        with self._in_flight.making(bytes_to_tell(snapshot, changed)):
            (update,) = updates_of(snapshot, changed, prev, whole=whole)
            return encode_update(update)
