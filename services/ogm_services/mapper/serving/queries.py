"""Queries about the map: what its cells mean for who moves in it, over HTTP and Zenoh alike."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import orjson

from ogm_core.cells.classes import trinary
from ogm_core.files.map_files import check_not_empty
from ogm_core.lattice import CellRect, Region
from ogm_core.queries.distances import around
from ogm_core.snapshot import MapSnapshot
from ogm_core.wire.keys import Query
from ogm_services.mapper.live.identity import Identity
from ogm_services.mapper.live.served_map import ServedMap
from ogm_services.mapper.serving.answer_cache import AnswerCache
from ogm_services.mapper.serving.answer_memory import AnswerMemory
from ogm_services.mapper.serving.checks import read_check, words_of
from ogm_services.mapper.serving.layers import LAYER_FORMATS, Layer, layer_bytes, layer_of
from ogm_services.mapper.serving.map_parameters import AT, region_of
from ogm_services.mapper.serving.raycasts import Fan, FanCells
from ogm_services.mapper.serving.saved_maps import SavedMaps
from ogm_services.replies.answer import Answer, Parameters, refuse_parameters


class Whole(NamedTuple):
    """The map as it is to be looked at, of which nothing is missing there."""

    take: Callable[[], MapSnapshot]
    live: bool = True
    """Whether it is the map that answers are kept of, and not one that was gathered for a question alone."""


class Queries:
    """Everything that is computed from the map for who asks. Any thread; nothing waits for the network."""

    def __init__(
        self,
        live_map: ServedMap,
        cache: AnswerCache,
        memory: AnswerMemory,
        whole: Callable[[Region | None], Whole],
        saved: Callable[[], SavedMaps],
    ) -> None:
        """`whole` gives the map; it refuses while the mapper starts, or a region is not all there.

        `saved` gives the maps that are saved, or refuses where none are.

        Layers are kept in the `cache`, which others share, while `memory` has room.
        """
        self._map = live_map
        self._cache = cache
        self._memory = memory
        self._whole = whole
        self._saved = saved

    def raycast(self, given: Parameters) -> Answer:
        """What rays from a point read: their ranges, m, and how each of them ends.

        Raises:
            BadParameter: a parameter is unknown, ill-formed or out of range, or the point outside the map.
            MapEmpty: the map has no known cell, nor bounds.
            Busy: it looks at much of a large map, and there is no memory or no thread left for it.
        """
        fan = Fan.read(given)
        whole = self._whole(fan.region).take().finest()
        part = FanCells.of(fan, whole)
        cells = part.snapshot.rect.cells
        with self._memory.large.making(cells), self._memory.in_flight.making(_bytes_of_states(part.snapshot)):
            ranges, ends = fan.cast(part)
        return _json(whole, {"ranges": ranges, "ends": ends})

    def check(self, given: Parameters, body: bytes) -> Answer:
        """Whether points or footprints meet an occupied cell, or else one that is not known to be free.

        Raises:
            BadParameter: there are parameters, or the body is ill-formed or asks too much.
            Busy: it looks at much of a large map, and there is no memory or no thread left for it.
        """
        refuse_parameters(given, "check")
        asked = read_check(body, self._map.finest)
        whole = self._whole(self._map.finest.region_of(asked.rect)).take().finest()
        window = asked.rect.intersection(whole.rect)
        part = whole.part(window if window.cells else CellRect(*whole.offset, 0, 0))
        with self._memory.large.making(window.cells), self._memory.in_flight.making(_bytes_of_states(part)):
            return _json(whole, {"states": words_of(asked, part)})

    def distance(self, form: str, given: Parameters) -> Answer:
        """How far the nearest occupied cell is, of every cell, in a format of LAYER_FORMATS.

        With the parameter `at`, of a map that is saved under a name.

        Raises:
            UnknownName: there is no such format, or no map of that name.
            NotStored: there are no saved maps here.
            BadParameter: a parameter is unknown, ill-formed or out of range, or its region misses the map.
            MapEmpty: a picture of a map without a known cell.
            Busy: it is large, and there is no memory or no thread left for it.
        """
        return self._layer("distance", form, given)

    def inflate(self, form: str, given: Parameters) -> Answer:
        """The map with every cell occupied that is within a radius of an occupied one, likewise."""
        return self._layer("inflate", form, given)

    def _layer(self, name: Query, form: str, given: Parameters) -> Answer:
        layer, region, saved_as = layer_of(name, form, given), region_of(given), AT.read(given)
        # A cell more: what is looked at counts from whole cells on.
        found = self._whole(_grown(region, layer.reach + self._map.finest.resolution))
        if saved_as is not None:  # it is not kept, as no answer of saved maps is
            with self._saved().opened(saved_as) as whole:
                return self._made(layer, region, form, whole.finest())
        cells = self._map.cells_in(_grown(region, layer.reach), finest=True)
        if not found.live:
            with self._memory.large.making(cells):
                return self._made(layer, region, form, found.take().finest())
        key = (f"{name}.{form}", tuple(sorted(given.items())))
        return self._cache.answer(
            *(key, self._map.now),
            lambda: self._memory.large.making(cells),
            lambda: self._made_and_kept(layer, region, form, key, found.take().finest()),
        )

    def _made_and_kept(
        self, layer: Layer, region: Region | None, form: str, key: object, whole: MapSnapshot
    ) -> Answer:
        answer = self._made(layer, region, form, whole)
        self._cache.keep(key, Identity.of(whole), answer)
        self._memory.make_room()
        return answer

    def _made(self, layer: Layer, region: Region | None, form: str, whole: MapSnapshot) -> Answer:
        shown = whole if region is None else whole.crop(region)
        if form == "png":
            check_not_empty(shown)
        window = around(shown.rect, layer.reach / whole.lattice.resolution, whole.rect)
        with self._memory.in_flight.making(layer_bytes(window.cells, shown.rect.cells)):
            x, y, width, height = shown.rect
            states = whole.part(window).encode(trinary)
            body = layer.encoded(states, CellRect(x - window.ix, y - window.iy, width, height), shown)
        return Answer(body, LAYER_FORMATS[form], shown.meta())


def _grown(region: Region | None, more: float) -> Region | None:
    """A region with so many metres more on every side; None, everything, if that is without end."""
    if region is None or math.isinf(more):
        return None
    return Region(region.xmin - more, region.ymin - more, region.xmax + more, region.ymax + more)


def _bytes_of_states(snapshot: MapSnapshot) -> int:
    """What is held while the cells of a map become trinary: these, and a band of the cells at a time."""
    return snapshot.rect.cells


def _json(told: MapSnapshot, fields: dict[str, Any]) -> Answer:
    """An answer, and which map it is of."""
    of = {"epoch": told.epoch, "run": told.run, "revision": told.revision}
    return Answer(orjson.dumps({**of, **fields}), "application/json")
