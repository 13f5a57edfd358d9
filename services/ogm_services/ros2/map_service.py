"""Map service: nav_msgs/GetMap over Zenoh, answered with the map that is in force when it is asked for."""

import logging
import queue
import threading
from collections.abc import Iterable
from contextlib import ExitStack

from ogm_client.errors import ClientError
from ogm_core.ros2.cdr import encode_occupancy_grid
from ogm_core.ros2.services import GET_MAP
from ogm_services.ros2.map_fetch import MapFetch
from ogm_services.ros2.topic_source import Request, ServiceSource, TopicSource
from ogm_services.runtime.limited_log import LimitedLog

MAX_WAITING = 100
"""So many requests wait at most; who asks again and again gets no more of them in."""
_CLOSING = 2.0

log = logging.getLogger(__name__)


class MapService:
    """A service on all sources that can have one, but those where another node offers it; one thread answers.

    All who wait when a map begins to be fetched get that one.
    """

    def __init__(self, name: str, sources: Iterable[TopicSource], fetch: MapFetch) -> None:
        self._fetch = fetch
        self._waiting: queue.SimpleQueue[Request | None] = queue.SimpleQueue()
        self._complaints = LimitedLog(log)
        self._thread = threading.Thread(target=self._run, name="get_map", daemon=True)
        self._thread.start()
        self._offered = ExitStack()
        for source in sources:
            if not isinstance(source, ServiceSource):
                continue
            other = source.server_of(name)
            if other is not None:
                log.warning("%s is not offered: %s does so already (%s)", name, other, source.where)
                continue
            self._offered.callback(source.serve(name, GET_MAP, self._take).close)
            log.info("offering %s (%s, %s)", name, GET_MAP, source.where)

    def close(self) -> None:
        """Offer it no more."""
        self._offered.close()
        self._waiting.put(None)
        self._thread.join(_CLOSING)

    def _take(self, request: Request) -> None:
        if self._waiting.qsize() < MAX_WAITING:
            self._waiting.put(request)
        else:
            request.refuse(f"{MAX_WAITING} requests wait already")

    def _run(self) -> None:
        while (first := self._waiting.get()) is not None:
            asked = [first]
            while not self._waiting.empty():
                other = self._waiting.get()
                if other is None:  # who asked is not to wait for what will not come
                    _refuse(asked, "the map is offered no more")
                    return
                asked.append(other)
            self._answer(asked)

    def _answer(self, asked: list[Request]) -> None:
        try:
            # The reply's one field is an OccupancyGrid, so it is as that is.
            payload = encode_occupancy_grid(self._fetch.trinary() or self._fetch.without_cells())
        except ClientError as error:
            self._complaints.of_kind("get_map", error.slug, str(error))
            _refuse(asked, str(error))
        except Exception:  # noqa: BLE001 - it is logged, with its traceback
            # A bug of ours, or no memory: who asks later is answered all the same.
            self._complaints.failure("a request for the map")
            _refuse(asked, "the map could not be given: the gateway's log says why")
        else:
            for request in asked:
                request.answer(payload)


def _refuse(asked: Iterable[Request], why: str) -> None:
    for request in asked:
        request.refuse(why)
