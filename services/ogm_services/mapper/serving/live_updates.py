"""Live updates: the messages that tell a WebSocket client what has changed of its view, as MessagePack."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import msgpack
import numpy as np

from ogm_core.placing.receipts import Receipts
from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.pyramid import LEAST_Z, NATIVE_Z, Square, revisions_of
from ogm_core.units import MEBIBYTE
from ogm_services.mapper.live.identity import Identity
from ogm_services.mapper.live.newest_scans import NewestScans
from ogm_services.mapper.live.served_map import ServedMap
from ogm_services.mapper.serving.live_view import Life, Seen, View
from ogm_services.mapper.serving.map_tiles import MapTiles, tiled_view
from ogm_services.replies.answer import Busy

PROTOCOL: Final = 1
MAX_TILES: Final = 64
MAX_TILE_BYTES: Final = 4 * MEBIBYTE
"""An update has so many tiles, and so many bytes of them, at most; the others come with the next ones."""
INSTANT: Final = 0.025
"""So long a copy of the map will do for the next client, s: most tiles are then encoded once for all."""
_ROBOTS_LAST = 1.0
"""Robots that go, without a message, are told of so late, s."""

_Told = tuple[int, int, int, int, bytes]
"""A tile: z, x, y, its revision, its PNG."""


class Moment(NamedTuple):
    """What a client can see change."""

    life: Life
    revision: int
    moves: int
    """Of robots."""


class Update(NamedTuple):
    """A message, what a client has seen once it has it, and the moment of which that is."""

    body: bytes
    seen: Seen
    moment: "Moment | None"
    """None: there is more for the client already."""


class LiveUpdates:
    """Makes them for all clients, one at a time: what several want is made once. No thread of its own."""

    def __init__(
        self,
        map_name: str,
        live_map: ServedMap,
        tiles: MapTiles,
        receipts: Receipts,
        scans: NewestScans,
        instant: float = INSTANT,
    ) -> None:
        """`tiles` are those that HTTP serves, too; a copy of the map will do for so long, s."""
        self._map_name = map_name
        self._map = live_map
        self._tiles = tiles
        self._receipts = receipts
        self._scans = scans
        self._instant = instant
        self._shared = Identity("", "", -1, None)
        """Which copy of the map was taken last; and when, s. It is not kept here: that would take memory."""
        self._taken = -math.inf
        self._packed: dict[str, tuple[object, bytes]] = {}
        """Parts that are the same for all clients, with what they depend on."""

    def now(self) -> Moment:
        """This moment; any thread, and it waits for nobody."""
        now = self._map.now
        return Moment(now.life, now.revision, self._receipts.moves)

    def hello(self) -> tuple[bytes, Life]:
        """The first message, and which map it is of."""
        snapshot = self._map.snapshot().finest()
        meta = snapshot.meta()
        told = {name: meta[name] for name in ("epoch", "run", "revision", "resolution", "anchor")}
        extent = None if snapshot.empty else list(snapshot.lattice.region_of(snapshot.rect))
        message = {"type": "hello", "protocol": PROTOCOL, "map": self._map_name, **told}
        message |= {"minzoom": LEAST_Z, "maxzoom": NATIVE_Z, "extent": extent}
        return msgpack.packb(message), Identity.of(snapshot).life

    def update(self, view: View, seen: Seen) -> Update:
        """What a client is to be told that has seen so much of its view.

        Of another life of the map first that it has begun, and nothing else: the client forgets all.
        """
        snapshot, moves = self._snapshot().finest(), self._receipts.moves
        now = Identity.of(snapshot)
        if now.life != seen.life:
            return Update(self._message(now._replace(revision=0), view), Seen(now.life), None)
        if seen.revision > now.revision:
            seen = Seen(now.life)
        due = _due(snapshot, view, seen)
        told = self._told(snapshot, view.palette, due)
        more = len(told) < len(due)
        if more:
            sent = {Square(z, x, y): revision for z, x, y, revision, _ in told}
            after = replace(seen, tiles={**seen.tiles, **sent})
        else:
            after = Seen(now.life, now.revision)
        moment = None if more else Moment(now.life, now.revision, moves)
        return Update(self._message(now, view, told, more=more), after, moment)

    def _snapshot(self) -> MapSnapshot:
        """The map as it is, or was an instant ago: what clients ask for at the same time is one copy."""
        copy, now = self._map.newest_copy, time.monotonic()
        if copy is None or now - self._taken > self._instant or Identity.of(copy) != self._shared:
            copy, self._taken = self._map.snapshot(), now
            self._shared = Identity.of(copy)
        elif self._shared.life != self._map.now.life:
            return self._map.snapshot()
        return copy

    def _told(self, snapshot: MapSnapshot, palette: str, due: list[tuple[Square, int]]) -> list[_Told]:
        """The first of the tiles that are due, as many as there is room for."""
        told: list[_Told] = []
        size = 0
        for square, revision in due[:MAX_TILES]:
            try:
                png = self._tiles.tile_of(snapshot, square, palette, revision).png
            except Busy:
                break
            size += len(png)
            if told and size > MAX_TILE_BYTES:
                break
            told.append((*square, revision, png))
        return told

    def _message(
        self,
        now: Identity,
        view: View,
        tiles: Sequence[_Told] = (),
        *,
        more: bool = False,
    ) -> bytes:
        parts = {
            "type": msgpack.packb("update"),
            "epoch": msgpack.packb(now.epoch),
            "run": msgpack.packb(now.run),
            "revision": msgpack.packb(now.revision),
            "tiles": msgpack.packb(tiles),
            "more": msgpack.packb(more),
            "robots": self._kept("robots", (self._receipts.moves, _turn_of(_ROBOTS_LAST)), self._robots),
        }
        if view.scans:
            told = self._scans.noted, now.epoch
            parts["scans"] = self._kept("scans", told, lambda: self._shown_scans(now.epoch))
        return _packed_map(parts)

    def _kept(self, part: str, of: object, make: Callable[[], Any]) -> bytes:
        """A part's bytes, made anew if they depend on something else by now."""
        kept, packed = self._packed.get(part, (None, b""))
        if kept != of:
            packed = msgpack.packb(make())
            self._packed[part] = of, packed
        return packed

    def _robots(self) -> dict[str, dict[str, Any]]:
        places = self._receipts.places(time.monotonic())
        return {
            name: {"pose": robot.pose, "stamp": robot.stamp, "alive": robot.alive}
            for name, robot in places.items()
        }

    def _shown_scans(self, epoch: str) -> dict[str, dict[str, Any]]:
        return {
            f"{robot}/{sensor}": {
                "stamp": scan.stamp,
                "pose": scan.pose,
                "angle_min": scan.angle_min,
                "angle_increment": scan.angle_increment,
                "range_max": scan.range_max,
                "ranges": scan.ranges.tobytes(),
            }
            for (robot, sensor), scan in self._scans.of(epoch).items()
        }


def _due(snapshot: MapSnapshot, view: View, seen: Seen) -> list[tuple[Square, int]]:
    """Tiles of a view that have changed since they were seen, with their revisions.

    The longest unseen come first, then the inmost.
    """
    revisions = revisions_of(tiled_view(snapshot).tiles, snapshot.model, view.first, view.last)
    x0, y0, x1, y1 = view.tiles
    due = []
    for i, j in np.argwhere(revisions > seen.revision).tolist():
        square = Square(view.z, x0 + i, y0 + j)
        had = seen.revision_of(square)
        if revisions[i, j] > had:
            off_centre = abs(2 * square.x - x0 - x1) + abs(2 * square.y - y0 - y1)
            due.append((had, off_centre, square, int(revisions[i, j])))
    return [(square, revision) for *_, square, revision in sorted(due)]


def _packed_map(parts: Mapping[str, bytes]) -> bytes:
    """A MessagePack map of values that are packed already."""
    packer = msgpack.Packer()
    begun = [packer.pack_map_header(len(parts))]
    return b"".join(
        [*begun, *(piece for name, value in parts.items() for piece in (packer.pack(name), value))]
    )


def _turn_of(period: float) -> int:
    """Which period of the clock it is."""
    return int(time.monotonic() / period)
