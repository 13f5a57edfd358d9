"""Map publisher: a mapper's map as robots and displays of ROS 2 read it, at most once a second."""

import logging
import threading
import time
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import replace

import numpy as np

from ogm_client.errors import ClientError
from ogm_core.cells.classes import UNKNOWN
from ogm_core.errors import BadSetting
from ogm_core.ros2.cdr import (
    OCCUPANCY_GRID,
    OCCUPANCY_GRID_UPDATE,
    OccupancyGrid,
    OccupancyGridUpdate,
    encode_occupancy_grid,
    encode_occupancy_grid_update,
)
from ogm_core.ros2.occupancy_grid import same_extents, update_of
from ogm_core.ros2.services import get_map_service
from ogm_services.ros2.map_fetch import MapFetch, MapVersion
from ogm_services.ros2.map_service import MapService
from ogm_services.ros2.topic_source import Latched, TopicSource
from ogm_services.runtime.limited_log import LimitedLog

PERIOD = 1.0
"""Between two messages, s."""
WHOLE_EVERY = 10.0
"""A map that goes on changing is sent whole this often, s; in between, what differs from it."""
LISTEN = 3.0
"""How long others that publish the topic are listened for before anything is sent, s."""
_CLOSING = 2.0

log = logging.getLogger(__name__)


class TopicTaken(BadSetting):
    """A topic that a map is to be published on is another node's."""

    slug = "topic-taken"


def updates_topic(name: str) -> str:
    """Where the changes of a topic's map are published."""
    return f"{name}_updates"


class MapTopic:
    """A map on one topic of all sources, and what has changed of it on another, NAME_updates.

    An update is of the last map that was sent whole, so that who has that one and any later update has the
    map of then. The last message of each is kept for those who come later: after a whole map an update of
    its first cell alone takes the place of the last one.
    """

    def __init__(self, name: str, sources: Iterable[TopicSource]) -> None:
        self.name = name
        sources = tuple(sources)
        self._whole = [source.publish_latched(name, OCCUPANCY_GRID) for source in sources]
        self._updates = [
            source.publish_latched(updates_topic(name), OCCUPANCY_GRID_UPDATE) for source in sources
        ]
        self._last: OccupancyGrid | None = None
        self._sent = 0.0
        self._update: OccupancyGridUpdate | None = None

    def whole_is_due(self, now: float) -> bool:
        """Whether updates alone have been sent for long; `now` in s."""
        return self._update is not None and now - self._sent >= WHOLE_EVERY

    def send(self, grid: OccupancyGrid | None, now: float) -> None:
        """Send a map, or what differs of it from the last whole one; None: a map without a known cell."""
        last = self._last
        if grid is None:
            if last is None:
                return
            grid = replace(last, data=np.full_like(last.data, UNKNOWN))
        if last is not None and same_extents(last, grid):
            update = update_of(last, grid)
            due = self.whole_is_due(now)
            if (self._tells(update) and not due) or (update is None and self._update is None):
                return
            if update is not None and not due and 2 * update.data.size < grid.data.size:
                self._update = update
                _put(self._updates, encode_occupancy_grid_update(update))
                return
        outdated = self._update is not None
        self._last, self._sent, self._update = grid, now, None
        _put(self._whole, encode_occupancy_grid(grid))
        if outdated:  # else who comes later would be given it after this map
            first = OccupancyGridUpdate(grid.stamp, grid.frame, 0, 0, grid.data[:1, :1])
            _put(self._updates, encode_occupancy_grid_update(first))

    def look(self) -> None:
        """Serve those who have come since."""
        for latched in (*self._whole, *self._updates):
            latched.look()

    def close(self) -> None:
        """Withdraw it."""
        for latched in (*self._whole, *self._updates):
            latched.close()

    def _tells(self, update: OccupancyGridUpdate | None) -> bool:
        """Whether the update that was sent last tells the same."""
        told = self._update
        if update is None or told is None or (update.x, update.y) != (told.x, told.y):
            return False
        return np.array_equal(update.data, told.data)


class MapPublisher:
    """A thread that fetches the map whenever it has changed, and publishes it."""

    def __init__(
        self,
        sources: Iterable[TopicSource],
        fetch: MapFetch,
        *,
        trinary: str | None,
        probabilities: str | None,
    ) -> None:
        """`trinary`, `probabilities`: the topics of either map; None: not published.

        Beside the first there is a service that gives the map: `get_map_service`.
        """
        self._sources = tuple(sources)
        self._fetch = fetch
        self._names = {"trinary": trinary, "probabilities": probabilities}
        self._complaints = LimitedLog(log)
        self._ending = threading.Event()
        self._failure: TopicTaken | None = None
        self._thread = threading.Thread(target=self._run, name="map", daemon=True)
        self._thread.start()

    def check(self) -> None:
        """Say what has kept it from publishing.

        Raises:
            TopicTaken: a topic is another node's.
        """
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """Publish no more."""
        self._ending.set()
        self._thread.join(_CLOSING)

    def _run(self) -> None:
        if self._ending.wait(LISTEN):
            return
        names = [name for name in self._names.values() if name is not None]
        try:
            for name in (*names, *map(updates_topic, names)):
                self._refuse_taken(name)
        except TopicTaken as error:
            self._failure = error
            return
        topics = {kind: MapTopic(name, self._sources) for kind, name in self._names.items() if name}
        for topic in topics.values():
            log.info("publishing the map on %s and %s", topic.name, updates_topic(topic.name))
        with ExitStack() as opened:
            for topic in topics.values():
                opened.callback(topic.close)
            if self._names["trinary"] is not None:
                name = get_map_service(self._names["trinary"])
                opened.callback(MapService(name, self._sources, self._fetch).close)
            self._publish(topics)

    def _publish(self, topics: dict[str, MapTopic]) -> None:
        seen: MapVersion | None = None
        while not self._ending.wait(PERIOD):
            now = time.monotonic()
            try:
                version = self._fetch.version()
                for kind, topic in topics.items():
                    if version != seen or topic.whole_is_due(now):
                        fetched = self._fetch.trinary if kind == "trinary" else self._fetch.probabilities
                        topic.send(fetched(), now)
                seen = version
            except ClientError as error:
                if not self._ending.is_set():
                    self._complaints.of_kind("map", error.slug, str(error))
            except Exception:  # noqa: BLE001 - it is logged, with its traceback
                self._complaints.failure("publishing the map")  # a bug of ours: the next one may go well
            for topic in topics.values():
                topic.look()

    def _refuse_taken(self, name: str) -> None:
        for source in self._sources:
            for topic in source.topics():
                if topic.publisher and topic.name == name:
                    node = topic.node or "another node"
                    raise TopicTaken(
                        f"{name}: {node} publishes it already ({source.where}), as who gives map -> odom "
                        "usually does; publish on another topic, such as /ogm/map"
                    )


def _put(everywhere: Iterable[Latched], payload: bytes) -> None:
    for latched in everywhere:
        latched.put(payload)
