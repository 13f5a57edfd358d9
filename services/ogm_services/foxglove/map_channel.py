"""Map channel: the newest map as viewers draw it, for as long as one of them looks.

Of a map that counts it has the cells that the mapper was told, as a ROS topic has.
"""

import logging
import threading
from dataclasses import replace

import numpy as np
from foxglove import Channel, Context, Schema

from ogm_client import MapClient, MapFollower, MapGrid
from ogm_client.errors import CannotConnect, NobodyAnswered
from ogm_client.transport import Version
from ogm_core.cells.classes import UNKNOWN
from ogm_core.errors import OgmError
from ogm_core.ros2.cdr import OCCUPANCY_GRID, OccupancyGrid, encode_occupancy_grid
from ogm_core.ros2.mcap_recording import MAP_FRAME
from ogm_core.ros2.occupancy_grid import occupancy_grid
from ogm_core.ros2.recording_messages import definition
from ogm_services.runtime.limited_log import LimitedLog

TOPIC = "/map"
LARGEST = 2048
"""No side has more pixels: a larger map is shrunk by a whole factor, for viewers draw it as one texture."""
PERIOD = 1.0
"""Between two maps, s."""
LOOK = 0.2
"""How often is looked whether anybody still does, s."""
_CLOSING = 2.0

log = logging.getLogger(__name__)


class MapChannel:
    """A thread that follows the map while a viewer is subscribed to it, and sends it whenever it has changed.

    What a viewer has missed is not kept for it by the server: to one that comes later the map is sent again.
    """

    def __init__(self, context: Context, client: MapClient) -> None:
        self._client = client
        schema = Schema(name=OCCUPANCY_GRID, encoding="ros2msg", data=definition(OCCUPANCY_GRID).encode())
        self._channel = Channel(TOPIC, message_encoding="cdr", schema=schema, context=context)
        self._complaints = LimitedLog(log)
        self._subscribed = threading.Event()
        self._ending = threading.Event()
        self._last: OccupancyGrid | None = None
        self._thread = threading.Thread(target=self._run, name="foxglove-map", daemon=True)
        self._thread.start()

    def subscribed(self, topic: str) -> None:
        """Note that a viewer has subscribed to a topic; any thread."""
        if topic == TOPIC:
            self._subscribed.set()

    def close(self) -> None:
        """Send no more."""
        self._ending.set()
        self._subscribed.set()
        self._thread.join(_CLOSING)

    @property
    def _wanted(self) -> bool:
        return self._channel.has_sinks() and not self._ending.is_set()

    def _run(self) -> None:
        while not self._ending.is_set():
            self._subscribed.wait()
            if not self._wanted:
                self._subscribed.clear()
                continue
            try:
                with self._client.follow(interval=PERIOD, resolution="coarse") as follower:
                    self._show(follower)
            except (CannotConnect, NobodyAnswered):
                pass  # whoever asks for the status says so
            except OgmError as error:
                self._complaints.of_kind("map", error.slug, str(error))
            except Exception:  # noqa: BLE001 - it is logged, with its traceback
                self._complaints.failure("showing the map")  # a bug of ours: the next one may go well
            self._ending.wait(PERIOD)

    def _show(self, follower: MapFollower) -> None:
        """Send what the follower has, until nobody looks any more."""
        seen: Version | None = None
        payload = b""
        self._subscribed.set()  # who looks has nothing yet
        while self._wanted:
            change = follower.wait(after=seen, timeout=LOOK)
            if change is None and not self._subscribed.is_set():
                continue
            self._subscribed.clear()
            if change is not None:
                seen = change.version
                payload = self._encoded(follower.grid())
            if payload:
                self._channel.log(payload)
            self._ending.wait(PERIOD)

    def _encoded(self, grid: MapGrid) -> bytes:
        """The map, shrunk; one that was emptied is unknown where it was known; b"" before there is any."""
        snapshot = grid.to_snapshot()
        if not snapshot.empty:
            self._last = occupancy_grid(snapshot.shrink(LARGEST), frame=MAP_FRAME)
        elif self._last is not None:
            self._last = replace(self._last, data=np.full_like(self._last.data, UNKNOWN))
        return b"" if self._last is None else encode_occupancy_grid(self._last)
