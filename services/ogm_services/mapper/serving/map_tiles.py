"""Tiles of the live map: pictures of 256 x 256 pixels that stay the same until what is under them changes."""

import json
import re
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from ogm_core.cells.value_bytes import COLOURS, legend
from ogm_core.errors import BadParameter, cut
from ogm_core.pictures.tile_png import EMPTY_TILE, tile_png, tile_stream
from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.halved import tiled
from ogm_core.tiles.pyramid import (
    LEAST_Z,
    MAKING_BYTES,
    NATIVE_Z,
    PIXELS,
    Square,
    TilePyramid,
    revision_of,
)
from ogm_core.tiles.view import TiledView
from ogm_services.mapper.live.identity import Identity
from ogm_services.mapper.live.served_map import ServedMap
from ogm_services.mapper.serving.answer_cache import CACHE_BYTES
from ogm_services.mapper.serving.map_parameters import PALETTE
from ogm_services.mapper.serving.query_parameters import Schema, TextParameter, check_names
from ogm_services.replies.answer import Answer, Parameters, UnknownName
from ogm_services.replies.in_flight import InFlight

TILE_REV: Final = TextParameter(
    "rev",
    "the tile's ETag without its quotes: while it is that, caches may keep the answer for good",
    "5f2b-91c0-1200",
)
TILE_PARAMETERS: Final = (PALETTE, TILE_REV)
MAX_PLACE: Final = 2**26
"""Tiles are served from -MAX_PLACE + 1 to MAX_PLACE - 1."""
_BYTES_BESIDES = 512
"""What a stream that is kept takes besides its bytes, at most."""


@dataclass(frozen=True, slots=True)
class MapTile:
    """The picture of a tile, and what its response says."""

    png: bytes
    of: Identity
    """The map that was looked at."""
    revision: int | None
    """Since when it is so; None: it is empty."""
    resolution: float
    """Metres per pixel."""
    named: str | None = None
    """Its tag, where that is not made of its map and its revision."""

    @property
    def tag(self) -> str:
        """What its strong validator has between its quotes: another one once the tile has changed."""
        if self.named is not None:
            return self.named
        life = f"{self.of.epoch}-{self.of.run}"
        return f"{self.of.epoch}-empty" if self.revision is None else f"{life}-{self.revision}"


class MapTiles:
    """Tiles of a live map, with the streams of those that were asked for last. Any thread."""

    def __init__(
        self, live_map: ServedMap, room: int = CACHE_BYTES, in_flight: InFlight | None = None
    ) -> None:
        """`room`: bytes of streams that may be kept; `in_flight` counts what is being made."""
        self._map = live_map
        self._room = room
        self.tag: Callable[[MapSnapshot, Square], str] | None = None
        """What makes the tags of tiles that HTTP serves of a map, where they are not its own."""
        self._in_flight = in_flight or InFlight()
        self._pyramid = TilePyramid()
        self._lock = threading.Lock()
        self._streams: OrderedDict[Square, tuple[str, bytes]] = OrderedDict()
        """With the tag of each, the one that was not asked for for longest first."""
        self._size = 0

    @property
    def nbytes(self) -> int:
        """Bytes that are kept."""
        return self._size + self._pyramid.nbytes

    def let_go(self) -> None:
        """Keep nothing of what is kept."""
        self._pyramid.let_go()
        with self._lock:
            self._streams, self._size = OrderedDict(), 0

    def tile(self, square: Square, palette: str) -> MapTile:
        """A tile of the map as it is now.

        Raises:
            Busy: there is no memory left to make it.
        """
        copy = self._map.snapshot()
        snapshot = copy.finest()
        revision = revision_of(tiled_view(snapshot).tiles, snapshot.model, square)
        tile = self.tile_of(snapshot, square, palette, revision)
        if self.tag is None or revision is None:
            return tile
        return replace(tile, named=self.tag(copy, square))

    def tile_of(self, snapshot: MapSnapshot, square: Square, palette: str, revision: int | None) -> MapTile:
        """A tile of a copy of the map, which has that `revision_of`.

        Raises:
            Busy: there is no memory left to make it.
        """
        resolution = snapshot.resolution * 2 ** (NATIVE_Z - square.z)
        tile = MapTile(EMPTY_TILE, Identity.of(snapshot), revision, resolution)
        if revision is None:
            return tile
        stream = self._kept(square, tile.tag)
        if stream is None:
            with self._in_flight.making(MAKING_BYTES):
                stream = tile_stream(self._pyramid.pixels(tiled_view(snapshot), snapshot.model, square))
            self._keep(square, tile.tag, stream)
        return MapTile(tile_png(stream, palette), tile.of, revision, resolution)

    def description(self, map_name: str, base: str) -> Answer:
        """What a viewer has to know to show them, as TileJSON; `base` is the URL of all routes."""
        snapshot = self._map.snapshot().finest()
        meta = snapshot.meta()
        told = {name: meta[name] for name in ("epoch", "run", "revision", "resolution", "anchor")}
        region = None if snapshot.empty else list(snapshot.lattice.region_of(snapshot.rect))
        described: dict[str, Any] = {
            "tilejson": "3.0.0",
            "name": map_name,
            "scheme": "xyz",
            "tiles": [f"{base}tiles/{{z}}/{{x}}/{{y}}.png"],
            "minzoom": LEAST_Z,
            "maxzoom": NATIVE_Z,
            "tilesize": PIXELS,
            "ogm": {
                **told,
                "extent": region,
                "palettes": list(COLOURS),
                "legend": {palette: legend(palette) for palette in COLOURS},
            },
        }
        return Answer(json.dumps(described).encode(), "application/json", meta)

    def _kept(self, square: Square, tag: str) -> bytes | None:
        with self._lock:
            of, stream = self._streams.get(square, ("", b""))
            if of != tag:
                return None
            self._streams.move_to_end(square)
            return stream

    def _keep(self, square: Square, tag: str, stream: bytes) -> None:
        """Keep a stream in place of its tile's older one, and of those that nobody has asked for lately."""
        with self._lock:
            _, before = self._streams.pop(square, ("", None))
            if before is not None:
                self._size -= len(before) + _BYTES_BESIDES
            self._streams[square] = tag, stream
            self._size += len(stream) + _BYTES_BESIDES
            while self._size > self._room:
                _, (_, gone) = self._streams.popitem(last=False)
                self._size -= len(gone) + _BYTES_BESIDES


@dataclass(frozen=True, slots=True)
class PlaceParameter:
    """A whole number in a tile's path: what is out of its range is no mistake, there is no tile there."""

    name: str
    said: str
    least: int
    most: int
    example: int

    @property
    def needed(self) -> bool:
        """A path has all of its parts."""
        return True

    def read(self, place: Mapping[str, str]) -> int:
        """The number.

        Raises:
            BadParameter: it is no whole number.
            UnknownName: there are no tiles there.
        """
        text = place[self.name]
        if re.fullmatch("-?[0-9]+", text) is None:
            raise BadParameter(f"{self.name}: a whole number is needed, got {cut(text)!r}")
        if len(text) > _DIGITS or not self.least <= int(text) <= self.most:
            raise UnknownName(
                f"{self.name}: there are tiles from {self.least} to {self.most}, not at {cut(text)}"
            )
        return int(text)

    def schema(self) -> Schema:
        """See `Parameter`."""
        limits = {"minimum": self.least, "maximum": self.most}
        return {"type": "integer", **limits, "examples": [self.example]}


_LIMITS = 1 - MAX_PLACE, MAX_PLACE - 1
PLACE: Final = (
    PlaceParameter("z", "16: a pixel a cell; half as many with each below", LEAST_Z, NATIVE_Z, NATIVE_Z),
    PlaceParameter("x", "tiles to the east of the map's anchor", *_LIMITS, 0),
    PlaceParameter("y", "tiles to the south of the one above the anchor, -1", *_LIMITS, -1),
)
"""What a tile's path names."""
_DIGITS = 12


def square_of(place: Mapping[str, str]) -> Square:
    """The tile that `z`, `x` and `y` name.

    Raises:
        BadParameter: one of them is no whole number.
        UnknownName: there are no tiles there.
    """
    return Square(*(part.read(place) for part in PLACE))


def palette_of(given: Parameters) -> str:
    """The palette that is asked for; `rev` may be anything.

    Raises:
        BadParameter: there is no such palette, or a parameter of another name.
    """
    check_names(given, TILE_PARAMETERS)
    return PALETTE.read(given)


def tiled_view(snapshot: MapSnapshot) -> TiledView:
    """The cells of a live map's snapshot, and the tiles that they lie in."""
    view = tiled(snapshot.stored)
    assert view is not None
    return view
