"""Answers of the mapper, over HTTP and Zenoh alike: a name and its parameters in, bytes out."""

import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from ogm_core.lattice import Region
from ogm_core.placing.receipts import Receipts
from ogm_core.status import ShareInfo, Status, StoreInfo
from ogm_services.mapper.live.identity import Identity
from ogm_services.mapper.live.monitor import Monitor
from ogm_services.mapper.live.served_map import ServedMap
from ogm_services.mapper.serving.answer_cache import AnswerCache
from ogm_services.mapper.serving.answer_memory import AnswerMemory
from ogm_services.mapper.serving.encoded_maps import EncodedMaps
from ogm_services.mapper.serving.kept_status import KeptStatus
from ogm_services.mapper.serving.map_formats import MAP_FORMATS, UPDATES_FORMAT, map_format
from ogm_services.mapper.serving.map_parameters import AT, CELL_X, CELL_Y, FINE_FIRST, served
from ogm_services.mapper.serving.map_tiles import MapTile, MapTiles, palette_of, square_of
from ogm_services.mapper.serving.map_updates import MapUpdates
from ogm_services.mapper.serving.queries import Queries, Whole
from ogm_services.mapper.serving.query_parameters import Parameter, check_names
from ogm_services.mapper.serving.saved_maps import SavedMaps
from ogm_services.replies.answer import NO_SNAPSHOTS, Answer, NotStored, Parameters, Starting


class Answers:
    """Everything that can be asked of a mapper. Any thread; nothing here waits for the network.

    Until it is `ready` every question gets Starting: an answer would have to wait for a compiler.
    """

    def __init__(
        self,
        map_name: str,
        live_map: ServedMap,
        receipts: Receipts,
        monitor: Monitor,
        ready: Callable[[], bool] = lambda: True,
        memory: AnswerMemory | None = None,
        store: Callable[[], StoreInfo] | None = None,
        saved: SavedMaps | None = None,
        share: ShareInfo | None = None,
        followed: ServedMap | None = None,
        threads: int = 1,
        restored: bool | None = None,
    ) -> None:
        """`store` tells of the map on disk, and `saved` of those that are saved; None: nothing is stored.

        `share` is the one that this is the map of. `followed` is the map under the name that it has for who
        follows it, where that is another one. So many `threads` update cells. `restored` is as in
        `Status`.
        """
        self._map_name = map_name
        self._map = live_map
        self._monitor = monitor
        self._receipts = receipts
        self._started = time.monotonic()
        self.memory = memory = memory or AnswerMemory()
        """What they take; who keeps answers elsewhere counts them there."""
        self._store, self._saved = store, saved
        self._share, self._threads, self._restored = share, threads, restored
        self._ready = ready
        self._status = KeptStatus(self._new_status, lambda: self._map.now.epoch)
        memory.in_all.add("status", lambda: self._status.nbytes)
        self._make_answers(followed or live_map)

    def _make_answers(self, followed: ServedMap) -> None:
        """What answers about the map, each about what it is made of."""
        memory, live_map = self.memory, self._map
        self._cache = told = AnswerCache(self.now, memory.cache_room)
        if followed is not live_map:
            told = AnswerCache(lambda: followed.now, memory.cache_room)
            memory.count(told)
        self._maps = EncodedMaps(self._map_name, live_map, self._cache, memory)
        self._updates = MapUpdates(followed, told, memory.large, memory.in_flight)
        self.map_tiles = MapTiles(followed, memory.cache_room, memory.in_flight)
        """The tiles of the live map, for all who want some."""
        self.queries = Queries(live_map, self._cache, memory, self.whole, lambda: self.saved)
        """What is computed from the map for who asks."""
        memory.count(self._cache, self.map_tiles)

    def check_started(self) -> None:
        """Refuse what needs a service that has started; waits for nobody.

        Raises:
            Starting: it has not.
        """
        if not self._ready():
            raise Starting("the mapper is starting: ask again in a few seconds")

    def check_ready(self) -> None:
        """The same before a question is answered."""
        self.check_started()

    def whole(self, region: Region | None = None) -> Whole:
        """The map, of which nothing is missing in a region, None: at all; here nothing ever is.

        Raises:
            Starting: the mapper has not started.
        """
        del region
        self.check_ready()
        return Whole(self._map.snapshot)

    @property
    def at_once(self) -> bool:
        """Whether `now` is the map that a question gets, so that what was sent once may be sent again."""
        return True

    @property
    def erases(self) -> bool:
        """Whether areas of the map can be erased."""
        return True

    def map_parameters(self, form: str) -> tuple[Parameter, ...]:
        """What a format of the map takes."""
        return MAP_FORMATS[form].parameters

    def map(self, form: str, given: Parameters) -> Answer:
        """The map in a format of MAP_FORMATS; with the parameter `at`, one that is saved under a name.

        In UPDATES_FORMAT what has changed of it, or all of it, tile by tile.

        Raises:
            UnknownName: there is no such format, or no map of that name.
            NotStored: there are no saved maps here.
            BadParameter: a parameter is unknown or ill-formed, or its region misses the map.
            MapEmpty: a picture of a map without a known cell.
            Busy: it is large, and there is no memory or no thread left for it.
        """
        self.check_started()
        return self._map_now(form, given)

    def map_of_all(self, form: str, given: Parameters) -> Answer:
        """`map`, where all have been asked who serve it: here it is one alone."""
        return self.map(form, given)

    def _map_now(self, form: str, given: Parameters) -> Answer:
        if form == UPDATES_FORMAT:
            answer = self._updates.answer(given)
            self.memory.make_room()
            return answer
        wanted, saved_as = map_format(form, given), AT.read(given)
        if saved_as is None:
            return self._maps.answer(form, given)
        rest = {name: value for name, value in given.items() if name != AT.name}
        return self.saved.map(saved_as, wanted, rest)

    def now(self) -> Identity:
        """Epoch, revision and stamp of the map at this moment; waits for nobody."""
        return self._map.now

    def tile(self, place: Mapping[str, str], given: Parameters) -> MapTile:
        """The tile of the map that `z`, `x` and `y` name.

        Raises:
            BadParameter: one of them is no whole number, or a parameter is unknown or wrong.
            UnknownName: there are no tiles there.
            Busy: there is no memory left to make it.
        """
        self.check_ready()
        tile = self.map_tiles.tile(square_of(place), palette_of(given))
        self.memory.make_room()
        return tile

    def tiles(self, base: str) -> Answer:
        """What a viewer has to know of the tiles, which are below the URL `base`."""
        self.check_ready()
        return self.map_tiles.description(self._map_name, base)

    @property
    def free_below(self) -> float:
        """Which probabilities mean free."""
        return self._map.free_below

    @property
    def saves(self) -> bool:
        """Whether maps can be saved here."""
        return self._saved is not None

    @property
    def keeps_robots(self) -> bool:
        """Whether the map keeps robots apart."""
        return self._map.info().robots is not None

    @property
    def saved(self) -> SavedMaps:
        """The maps that are saved.

        Raises:
            NotStored: there can be none.
        """
        if self._saved is None:
            raise NotStored(NO_SNAPSHOTS)
        return self._saved

    def snapshots(self, given: Parameters) -> Answer:
        """The maps that are saved, by name."""
        check_names(given, ())
        self.check_ready()
        return self.saved.list()

    def cell(self, given: Parameters) -> Answer:
        """One cell: indices, whether it is known, and its log odds and probability if so.

        Raises:
            BadParameter: x or y is missing or is not a coordinate.
        """
        self.check_started()
        check_names(given, (CELL_X, CELL_Y, FINE_FIRST))
        x, y = CELL_X.read(given), CELL_Y.read(given)
        snapshot = served(self._with_cell(x, y).take(), FINE_FIRST, given)
        ix, iy = snapshot.lattice.cell_of(x, y)
        column, row = ix - snapshot.offset[0], iy - snapshot.offset[1]
        reply: dict[str, Any] = {"x": x, "y": y, "ix": ix, "iy": iy, "known": False}
        reply |= {"log_odds": None, "probability": None}
        if 0 <= column < snapshot.width and 0 <= row < snapshot.height:
            here = slice(row, row + 1), slice(column, column + 1)
            probability, known = snapshot.published(*here)
            counts = snapshot.counted(*here)
            if counts is not None:
                passing = counts.pop("passing").item() * snapshot.resolution
                reply["counts"] = {"passing_m": passing, **{name: of.item() for name, of in counts.items()}}
            if known.item():
                log_odds = snapshot.log_odds(*here).item()
                reply |= {"known": True, "log_odds": log_odds, "probability": probability.item()}
        return _json(reply)

    def _with_cell(self, x: float, y: float) -> Whole:
        """The map, in which one cell is not missing."""
        del x, y
        return self.whole()

    def quality(self, given: Parameters) -> Answer:
        """The quality figures, those against the true world if there is one, and how they have settled."""
        check_names(given, ())
        return _json(self.quality_fields())

    def status(self, given: Parameters) -> Answer:
        """The mapper's status."""
        check_names(given, ())
        self.check_ready()
        return Answer(self._status.get().body, "application/json")

    def quality_fields(self, *, fresh: bool = False, within: float = math.inf) -> dict[str, Any]:
        """The quality figures, not yet encoded; those of the whole map may be a second old unless `fresh`.

        `fresh` ones that are not ready `within` so many seconds are None, and named in the list `missing`.
        """
        self.check_ready()
        world = self._monitor.truth.world
        figures = self._map.fresh_quality(world, within) if fresh else self._map.quality(world)
        series = self._monitor.series.columns(self._map.now.epoch)
        return {**figures, "series": series}

    def current_status(self) -> Status:
        """The mapper's status, not encoded: the same that `status` answers with."""
        self.check_ready()
        return self._status.get().status

    def status_since_start(self) -> Status:
        """The same with the counts of this process alone: what is told Prometheus begins anew with it."""
        counts = self._receipts.status(time.monotonic(), since_start=True)
        return replace(self.current_status(), scans=counts.scans, robots=counts.robots)

    def _new_status(self) -> Status:
        counts = self._receipts.status(time.monotonic())
        now = self._map.now
        return Status(
            map=self._map_name,
            epoch=now.epoch,
            run=now.run,
            revision=now.revision,
            stamp=now.stamp,
            scans=counts.scans,
            poses=counts.poses,
            other=counts.other,
            map_info=self._map.info(),
            robots=counts.robots,
            uptime_s=time.monotonic() - self._started,
            threads=self._threads,
            restored=self._restored,
            store=None if self._store is None else self._store(),
            share=self._share,
        )


def _json(value: dict[str, Any]) -> Answer:
    return Answer(json.dumps(value).encode(), "application/json")
