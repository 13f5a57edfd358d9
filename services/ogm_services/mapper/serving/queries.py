"""Queries about the map: what its cells mean for who moves in it, over HTTP and Zenoh alike."""

from collections.abc import Callable
from typing import Any

import orjson

from ogm_core.lattice import CellRect
from ogm_core.snapshot import MapSnapshot
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.serving.checks import read_check, words_of
from ogm_services.mapper.serving.large_answers import LargeAnswers
from ogm_services.mapper.serving.raycasts import Fan, FanCells
from ogm_services.replies.answer import Answer, Parameters, refuse_parameters
from ogm_services.replies.in_flight import InFlight


class Queries:
    """Everything that is computed from the map for who asks. Any thread; nothing waits for the network."""

    def __init__(
        self,
        live_map: LiveMap,
        large: LargeAnswers,
        in_flight: InFlight,
        check_ready: Callable[[], None],
    ) -> None:
        """`check_ready` refuses while the mapper starts; `in_flight` counts what is being made."""
        self._map = live_map
        self._large = large
        self._in_flight = in_flight
        self._check_ready = check_ready

    def raycast(self, given: Parameters) -> Answer:
        """What rays from a point read: their ranges, m, and how each of them ends.

        Raises:
            BadParameter: a parameter is unknown, ill-formed or out of range, or the point outside the map.
            MapEmpty: the map has no known cell, nor bounds.
            Busy: it looks at much of a large map, and there is no memory or no thread left for it.
        """
        self._check_ready()
        fan, whole = Fan.read(given), self._map.snapshot()
        part = FanCells.of(fan, whole)
        cells = part.snapshot.rect.cells
        with self._large.making(cells), self._in_flight.making(_bytes_of_states(part.snapshot)):
            ranges, ends = fan.cast(part)
        return _json(whole, {"ranges": ranges, "ends": ends})

    def check(self, given: Parameters, body: bytes) -> Answer:
        """Whether points or footprints meet an occupied cell, or else one that is not known to be free.

        Raises:
            BadParameter: there are parameters, or the body is ill-formed or asks too much.
            Busy: it looks at much of a large map, and there is no memory or no thread left for it.
        """
        refuse_parameters(given, "check")
        self._check_ready()
        whole = self._map.snapshot()
        asked = read_check(body, whole.lattice)
        window = asked.rect.intersection(whole.rect)
        part = whole.part(window if window.cells else CellRect(*whole.offset, 0, 0))
        with self._large.making(window.cells), self._in_flight.making(_bytes_of_states(part)):
            return _json(whole, {"states": words_of(asked, part)})


def _bytes_of_states(snapshot: MapSnapshot) -> int:
    """What is held while the cells of a map become trinary: these, and a band of the cells at a time."""
    return snapshot.rect.cells


def _json(told: MapSnapshot, fields: dict[str, Any]) -> Answer:
    """An answer, and which map it is of."""
    of = {"epoch": told.epoch, "run": told.run, "revision": told.revision}
    return Answer(orjson.dumps({**of, **fields}), "application/json")
