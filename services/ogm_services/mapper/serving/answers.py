"""Answers of the mapper, over HTTP and Zenoh alike: a name and its parameters in, bytes out."""

import json
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from ogm_core.errors import BadParameter, cut
from ogm_core.files.map_files import (
    DEFAULT_PALETTE,
    PALETTES,
    encode_json,
    encode_npz,
    encode_pgm,
    encode_png,
    encode_yaml,
)
from ogm_core.lattice import Region
from ogm_core.pictures.map_picture import MapPicture
from ogm_core.placing.receipts import Receipts
from ogm_core.snapshot import MapSnapshot
from ogm_core.status import Status, StoreInfo
from ogm_services.mapper.live.live_map import Identity, LiveMap
from ogm_services.mapper.live.monitor import Monitor
from ogm_services.mapper.serving.answer_cache import CACHE_BYTES, AnswerCache, Cache
from ogm_services.mapper.serving.kept_status import KeptStatus
from ogm_services.replies.answer import Answer, Busy, Parameters, Starting, UnknownName
from ogm_services.replies.in_flight import InFlight
from ogm_services.runtime.memory import MemoryUse
from ogm_services.settings.values import parse_number

LARGE = 10_000_000
"""Answers that look at more cells take seconds."""
LARGE_AT_ONCE = 4
"""So many of them are made or waited for at a time: half of the threads that a protocol has for maps."""


@dataclass(frozen=True, slots=True)
class _MapFormat:
    media_type: str
    parameters: frozenset[str]
    cost: float
    """Bytes that are held for each byte of the map's cells while it is made, with its body, at most."""
    encode: Callable[[MapSnapshot, str, Parameters], bytes]


MAP_FORMATS: dict[str, _MapFormat] = {
    "png": _MapFormat(
        "image/png",
        frozenset({"region", "palette", "max_size"}),
        4.0,  # cells of a block by their levels, while it is shrunk; else 2
        lambda snapshot, _, given: encode_png(snapshot, given.get("palette", DEFAULT_PALETTE)),
    ),
    "json": _MapFormat(
        "application/json",
        frozenset({"region", "values"}),
        4.0,  # text of 4 bytes a cell, twice
        lambda snapshot, name, given: encode_json(snapshot, name, given.get("values", "percent")),
    ),
    "pgm": _MapFormat(
        "image/x-portable-graymap",
        frozenset({"region", "palette"}),
        1.5,  # 3 bytes a cell
        lambda snapshot, _, given: encode_pgm(snapshot, given.get("palette", DEFAULT_PALETTE)),
    ),
    "yaml": _MapFormat(
        "application/yaml", frozenset({"region"}), 1.5, lambda snapshot, *_: encode_yaml(snapshot, "map.pgm")
    ),
    "npz": _MapFormat(
        "application/x-npz", frozenset({"region"}), 6.0, lambda snapshot, *_: encode_npz(snapshot)
    ),
}


class Answers:
    """Everything that can be asked of a mapper. Any thread; nothing here waits for the network.

    Until it is `ready` every question gets Starting: an answer would have to wait for a compiler.
    """

    def __init__(
        self,
        map_name: str,
        live_map: LiveMap,
        receipts: Receipts,
        monitor: Monitor,
        ready: Callable[[], bool] = lambda: True,
        memory: MemoryUse | None = None,
        in_flight: InFlight | None = None,
        store: Callable[[], StoreInfo] | None = None,
    ) -> None:
        """`memory`: what else is held; where it is short, no answer is kept for the next who asks.

        `in_flight` counts what is being made. `store` tells of the map on disk; None: it is not stored.
        """
        self._map_name = map_name
        self._map = live_map
        self._monitor = monitor
        self._receipts = receipts
        self._started = time.monotonic()
        self._memory = memory
        self._in_flight = in_flight or InFlight()
        self._store = store
        self._large = threading.Semaphore(LARGE_AT_ONCE)
        self.cache_room = CACHE_BYTES if memory is None else memory.share(CACHE_BYTES)
        """Bytes of answers that one cache may keep."""
        self._cache = AnswerCache(self.now, self.cache_room)
        self._status = KeptStatus(self._new_status, lambda: self._map.now.epoch)
        self._pictures = {name: MapPicture(encoder) for name, encoder in PALETTES.items()}
        self._ready = ready
        self._caches: list[Cache] = [self._cache, *self._pictures.values()]
        if memory is not None:
            memory.add("caches", self.cached_bytes, let_go=self._let_go)
            memory.add("status", lambda: self._status.nbytes)

    def count_cache(self, cache: Cache) -> None:
        """Count a cache of answers that lies elsewhere."""
        self._caches.append(cache)

    def cached_bytes(self) -> int:
        """Bytes of answers that are kept for the next who asks; a body in two caches counts twice."""
        return sum(cache.nbytes for cache in self._caches)

    def _let_go(self) -> None:
        for cache in self._caches:
            cache.let_go()

    def check_ready(self) -> None:
        """Refuse what needs a mapper that has started.

        Raises:
            Starting: it has not.
        """
        if not self._ready():
            raise Starting("the mapper is starting: ask again in a few seconds")

    def map(self, form: str, given: Parameters) -> Answer:
        """The map in a format of MAP_FORMATS.

        Raises:
            UnknownName: there is no such format.
            BadParameter: a parameter is unknown or ill-formed, or its region misses the map.
            MapEmpty: a picture of a map without a known cell.
            Busy: it is large, and there is no memory or no thread left for it.
        """
        self.check_ready()
        if form not in MAP_FORMATS:
            raise UnknownName(f"format: one of {', '.join(MAP_FORMATS)} is needed, got {cut(form)!r}")
        wanted = MAP_FORMATS[form]
        _check_names(given, wanted.parameters)
        asked = self._map.now
        key = (form, tuple(sorted(given.items())))
        answer = self._cache.find(key, asked)
        if answer is None:
            region = _region_of(given)
            with self._not_too_many(form, given, region), self._cache.turn(key):
                # Whoever had the turn before may have encoded a map that is new enough for this one too.
                answer = self._cache.find(key, asked) or self._encoded(wanted, given, region, key)
        return answer

    def now(self) -> Identity:
        """Epoch, revision and stamp of the map at this moment; waits for nobody."""
        return self._map.now

    @contextmanager
    def _not_too_many(self, form: str, given: Parameters, region: Region | None) -> Iterator[None]:
        """Let so few large answers be made, or waited for, that small ones always find a thread."""
        kept = form == "png" and given.keys() <= {"palette"}  # the picture that is kept up to date is quick
        large = not kept and self._map.cells_in(region) > LARGE
        if large and not self._large.acquire(blocking=False):
            raise Busy(
                f"{LARGE_AT_ONCE} answers of more than {LARGE} cells are being made: "
                "try again later, or ask for a smaller region"
            )
        try:
            yield
        finally:
            if large:
                self._large.release()

    def _encoded(self, wanted: _MapFormat, given: Parameters, region: Region | None, key: object) -> Answer:
        snapshot = self._map.snapshot()
        cropped = snapshot if region is None else snapshot.crop(region)
        picture = self._picture_of(wanted, cropped, given) if cropped is snapshot else None
        with self._in_flight.making(_bytes_to_make(wanted, cropped, picture)):
            shown = _shrunk(cropped, given)
            if picture is not None:
                body = picture.png(snapshot)
            else:
                body = wanted.encode(shown, self._map_name, given)
        answer = Answer(body, wanted.media_type, shown.meta())
        self._cache.keep(key, Identity.of(snapshot), answer)
        if self._memory is not None:
            self._memory.make_room()
        return answer

    def _picture_of(self, wanted: _MapFormat, whole: MapSnapshot, given: Parameters) -> MapPicture | None:
        """The picture of the whole map that is kept up to date, if that is what is wanted."""
        if wanted is not MAP_FORMATS["png"] or whole.empty or "max_size" in given:
            return None
        return self._pictures.get(given.get("palette", DEFAULT_PALETTE))

    def cell(self, given: Parameters) -> Answer:
        """One cell: indices, whether it is known, and its log odds and probability if so.

        Raises:
            BadParameter: x or y is missing or is not a coordinate.
        """
        self.check_ready()
        _check_names(given, {"x", "y"})
        x, y = (_number(name, given.get(name)) for name in "xy")
        snapshot = self._map.snapshot()
        ix, iy = snapshot.lattice.cell_of(x, y)
        column, row = ix - snapshot.offset[0], iy - snapshot.offset[1]
        reply: dict[str, Any] = {"x": x, "y": y, "ix": ix, "iy": iy, "known": False}
        reply |= {"log_odds": None, "probability": None}
        if 0 <= column < snapshot.width and 0 <= row < snapshot.height:
            here = slice(row, row + 1), slice(column, column + 1)
            probability, known = snapshot.published(*here)
            if known.item():
                log_odds = snapshot.log_odds(*here).item()
                reply |= {"known": True, "log_odds": log_odds, "probability": probability.item()}
        return _json(reply)

    def quality(self, given: Parameters) -> Answer:
        """The quality figures, those against the true world if there is one, and how they have settled."""
        _check_names(given, ())
        return _json(self.quality_fields())

    def status(self, given: Parameters) -> Answer:
        """The mapper's status."""
        _check_names(given, ())
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
            store=None if self._store is None else self._store(),
        )


def _check_names(given: Parameters, allowed: frozenset[str] | set[str] | tuple[()]) -> None:
    for name in given:
        if name not in allowed:
            listed = ", ".join(sorted(allowed)) or "none"
            raise BadParameter(f"{cut(name)}: unknown parameter; there are: {listed}")


def _bytes_to_make(wanted: _MapFormat, snapshot: MapSnapshot, picture: MapPicture | None) -> int:
    cells = snapshot.width * snapshot.height
    if picture is not None:  # only what has changed is encoded, and what was is put together
        return 2 * picture.nbytes + cells // 16
    cell = sum(np.dtype(plane.dtype).itemsize * plane.side**2 for plane in snapshot.model.planes)
    return int(wanted.cost * cell * cells)


def _region_of(given: Parameters) -> Region | None:
    if "region" not in given:
        return None
    parts = given["region"].split(",")
    if len(parts) != 4:
        raise BadParameter(f"region: xmin,ymin,xmax,ymax is needed, got {cut(given['region'])!r}")
    return Region(*(_number("region", part) for part in parts))


def _shrunk(snapshot: MapSnapshot, given: Parameters) -> MapSnapshot:
    if "max_size" not in given:
        return snapshot
    text = given["max_size"]
    if not (text.isascii() and text.isdigit() and len(text) <= 9 and int(text) > 0):
        raise BadParameter(f"max_size: a number of pixels, 1 or more, is needed, got {cut(text)!r}")
    return snapshot.shrink(int(text))


def _number(name: str, text: str | None) -> float:
    if text is None:
        raise BadParameter(f"{name}: missing")
    try:
        return parse_number(text)
    except ValueError as error:
        raise BadParameter(f"{name}: {error}") from None


def _json(value: dict[str, Any]) -> Answer:
    return Answer(json.dumps(value).encode(), "application/json")
