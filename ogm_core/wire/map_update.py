"""Map updates: the tiles of a map that have changed since a revision, for programs that follow it.

A message is a MessagePack map (docs/protocol.md, "Follow the map"). Applied to a copy of the map at any
revision from `prev` to `revision` it gives `revision` exactly; where it is `whole`, to none at all.
"""

import math
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from ogm_core.cells.model import Plane
from ogm_core.errors import BadMessage, BadSetting, cut
from ogm_core.lattice import MAX_INDEX, CellRect, Lattice
from ogm_core.tiles.inflating import inflated
from ogm_core.tiles.store import TILE, tile_bytes
from ogm_core.units import MEBIBYTE
from ogm_core.wire.keys import MAX_NAME
from ogm_core.wire.messages import INT_END

MEDIA_TYPE = "application/vnd.ogm.tiles"
MAX_CELL_BYTES = 16 * MEBIBYTE
"""The cells of one message take so many bytes at most: a larger set is sent in parts."""
MAX_PARTS = 2**20
_LEVEL = 1
"""Of 0 to 3: the higher ones take twice as long and gain a hundredth."""
_MAX_ITEMS = 64
_MAX_TEXT = 128
_MAX_PLANES = 8
_DTYPES = frozenset(f"{kind}{size}" for kind in ("int", "uint") for size in (8, 16, 32, 64)) | {
    "float32",
    "float64",
}
_PLACE = np.dtype("<i8")


@dataclass(frozen=True, slots=True, eq=False)
class MapUpdate:
    """One message: which tiles a map has changed from `prev` to `revision`, and their cells."""

    epoch: str
    run: str
    prev: int
    revision: int
    stamp: int | None
    """Of the newest integrated scan, ns since the Unix epoch, None if there is none."""
    lattice: Lattice
    planes: tuple[Plane, ...]
    model: Mapping[str, str | float]
    """The cell model's name, and its constants."""
    extent: CellRect
    """The cells that the map serves; all others are unknown."""
    tiles: NDArray[np.int64]
    """Which tiles of the lattice, (tx, ty): shape (n, 2)."""
    cells: Mapping[str, NDArray[Any]]
    """By plane, shape (n, cells of a tile), row after row, row 0 south."""
    whole: bool = False
    """Whether all that was ever written is there: what a copy had before does not matter."""
    part: int = 0
    parts: int = 1
    """The same change in so many messages, which are applied together."""


def tiles_at_once(planes: tuple[Plane, ...]) -> int:
    """How many tiles of these planes a message holds at most."""
    return max(1, MAX_CELL_BYTES // tile_bytes(planes))


def encode_update(update: MapUpdate) -> bytes:
    """MessagePack form of a message."""
    packing = isal_zlib.compressobj(_LEVEL)
    planes = [] if not len(update.tiles) else [update.cells[plane.name] for plane in update.planes]
    packed = [packing.compress(_little_endian(plane)) for plane in planes]
    fields = {
        "epoch": update.epoch,
        "run": update.run,
        "prev": update.prev,
        "revision": update.revision,
        "whole": update.whole,
        "part": update.part,
        "parts": update.parts,
        "stamp": update.stamp,
        "resolution": update.lattice.resolution,
        "anchor": list(update.lattice.anchor),
        "tile": TILE,
        "planes": [
            {"name": plane.name, "dtype": plane.dtype.name, "per_side": plane.side} for plane in update.planes
        ],
        "model": dict(update.model),
        "extent_cells": list(update.extent),
        "tiles": update.tiles.astype(_PLACE, copy=False).tobytes(),
        "data": b"".join((*packed, packing.flush())),
    }
    return bytes(msgpack.packb(fields))


def _little_endian(plane: NDArray[Any]) -> memoryview:
    return np.ascontiguousarray(plane, plane.dtype.newbyteorder("<")).reshape(-1).view(np.uint8).data


def decode_updates(payload: bytes) -> Iterator[MapUpdate]:
    """The messages of a payload, which follow one another, each unpacked when it is its turn.

    Raises:
        BadMessage: one of them is ill-formed, damaged or too large; the text names the field.
    """
    unpacker = msgpack.Unpacker(
        max_buffer_size=max(len(payload), 1),
        max_array_len=_MAX_ITEMS,
        max_map_len=_MAX_ITEMS,
        max_str_len=_MAX_TEXT,
        max_ext_len=0,
        strict_map_key=True,
    )
    unpacker.feed(payload)
    end = 0
    while end < len(payload):
        try:
            fields = unpacker.unpack()
        except (ValueError, TypeError, OverflowError, RecursionError, msgpack.UnpackException) as error:
            raise BadMessage(
                f"update: not MessagePack ({cut(str(error)) or type(error).__name__})"
            ) from error
        end = unpacker.tell()
        yield _update_of(fields)


def _update_of(fields: Any) -> MapUpdate:  # noqa: ANN401 - whatever was sent
    if not isinstance(fields, dict):
        raise BadMessage(f"update: a MessagePack map is needed, got {type(fields).__name__}")
    if fields.get("tile") != TILE:
        raise BadMessage(f"tile: tiles of {TILE} cells are read, not of {cut(repr(fields.get('tile')))}")
    planes = _planes_of(fields)
    tiles = _tiles_of(fields, planes)
    stamp, whole = fields.get("stamp"), fields.get("whole")
    if type(whole) is not bool:
        raise BadMessage(f"whole: true or false is needed, got {cut(repr(whole))}")
    update = MapUpdate(
        epoch=_text(fields, "epoch"),
        run=_text(fields, "run"),
        prev=_count(fields, "prev"),
        revision=_count(fields, "revision"),
        stamp=None if stamp is None else _count(fields, "stamp"),
        lattice=_lattice_of(fields),
        planes=planes,
        model=_model_of(fields),
        extent=_extent_of(fields),
        tiles=tiles,
        cells=_cells_of(fields, planes, len(tiles)),
        whole=whole,
        part=_count(fields, "part"),
        parts=_count(fields, "parts"),
    )
    if update.prev > update.revision:
        raise BadMessage(f"prev: {update.prev} is after the revision, {update.revision}")
    if not update.part < update.parts <= MAX_PARTS:
        raise BadMessage(f"part: {update.part} of {update.parts} cannot be")
    return update


def _planes_of(fields: Mapping[str, Any]) -> tuple[Plane, ...]:
    told = fields.get("planes")
    if not isinstance(told, list) or not 0 < len(told) <= _MAX_PLANES:
        raise BadMessage(f"planes: 1 to {_MAX_PLANES} planes are needed, got {cut(repr(told))}")
    planes = []
    for plane in told:
        match plane:
            case {"name": str(name), "dtype": str(dtype), "per_side": 1 | 2 as side} if (
                len(name) <= MAX_NAME and dtype in _DTYPES and type(side) is int
            ):
                planes.append(Plane(name, np.dtype(dtype), side))
            case _:
                raise BadMessage(
                    f"planes: name, dtype and per_side (1 or 2) are needed, got {cut(repr(plane))}"
                )
    if len({plane.name for plane in planes}) < len(planes):
        raise BadMessage("planes: two have the same name")
    return tuple(planes)


def _tiles_of(fields: Mapping[str, Any], planes: tuple[Plane, ...]) -> NDArray[np.int64]:
    tiles = _bytes(fields, "tiles")
    count, rest = divmod(len(tiles), 2 * _PLACE.itemsize)
    if rest:
        raise BadMessage(f"tiles: {len(tiles)} bytes are no whole number of (tx, ty)")
    size = count * tile_bytes(planes)
    # Before anything is made of them. A message of one tile may be larger: there is no smaller one.
    if size > MAX_CELL_BYTES and count > 1:
        raise BadMessage(f"tiles: {count} take {size} bytes, more than the {MAX_CELL_BYTES} of a message")
    places = np.frombuffer(tiles, _PLACE).reshape(-1, 2).astype(np.int64, copy=False)
    most = MAX_INDEX // TILE
    if not ((places >= -most) & (places < most)).all():
        raise BadMessage("tiles: one lies where there are no cells")
    if len(set(map(tuple, places.tolist()))) < len(places):
        raise BadMessage("tiles: one is there twice")
    return places


def _cells_of(fields: Mapping[str, Any], planes: tuple[Plane, ...], count: int) -> dict[str, NDArray[Any]]:
    unpacked = _inflated(_bytes(fields, "data"), count * tile_bytes(planes))
    cells, begin = {}, 0
    for plane in planes:
        each = (TILE * plane.side) ** 2
        numbers = np.frombuffer(unpacked, plane.dtype.newbyteorder("<"), count * each, begin)
        begin += numbers.nbytes
        cells[plane.name] = numbers.astype(plane.dtype, copy=False).reshape(count, each)
    return cells


def _inflated(data: bytes, size: int) -> bytes:
    """Exactly `size` bytes, whatever `data` claims to be."""
    try:
        unpacked = inflated(data, size)
    except zlib.error as error:
        raise BadMessage(f"data: {error}") from error
    if unpacked is None:
        raise BadMessage(f"data: it is not {size} bytes, as many as the tiles' cells take")
    return unpacked


def _lattice_of(fields: Mapping[str, Any]) -> Lattice:
    resolution, anchor = fields.get("resolution"), fields.get("anchor")
    if not isinstance(anchor, list) or len(anchor) != 2 or not all(map(_is_finite, anchor)):
        raise BadMessage(f"anchor: two finite numbers are needed, got {cut(repr(anchor))}")
    if not isinstance(resolution, int | float) or not _is_finite(resolution):
        raise BadMessage(f"resolution: a finite number is needed, got {cut(repr(resolution))}")
    try:
        return Lattice(float(resolution), (float(anchor[0]), float(anchor[1])))
    except BadSetting as error:
        raise BadMessage(str(error)) from error


def _model_of(fields: Mapping[str, Any]) -> dict[str, str | float]:
    model = fields.get("model")
    if not isinstance(model, dict) or not isinstance(model.get("name"), str):
        raise BadMessage(f"model: a map with a name is needed, got {cut(repr(model))}")
    for name, value in model.items():
        if not (isinstance(value, str) or _is_finite(value)):
            raise BadMessage(f"model: {cut(repr(name))} is {cut(repr(value))}, a finite number is needed")
    return model


def _extent_of(fields: Mapping[str, Any]) -> CellRect:
    extent = fields.get("extent_cells")
    if isinstance(extent, list) and len(extent) == 4 and all(type(value) is int for value in extent):
        rect = CellRect(*extent)
        low, high = min(rect), max(rect.ix + rect.width, rect.iy + rect.height)
        if low >= -MAX_INDEX and high <= MAX_INDEX and min(rect.width, rect.height) >= 0:
            return rect
    raise BadMessage(f"extent_cells: [ix, iy, width, height] is needed, got {cut(repr(extent))}")


def _text(fields: Mapping[str, Any], name: str) -> str:
    value = fields.get(name)
    if not isinstance(value, str) or not (value.isascii() and value.isprintable()):
        raise BadMessage(f"{name}: a plain text is needed, got {cut(repr(value))}")
    return value


def _count(fields: Mapping[str, Any], name: str) -> int:
    value = fields.get(name)
    if type(value) is not int or not 0 <= value < INT_END:
        raise BadMessage(f"{name}: a whole number from 0 is needed, got {cut(repr(value))}")
    return value


def _bytes(fields: Mapping[str, Any], name: str) -> bytes:
    value = fields.get(name)
    if not isinstance(value, bytes):
        raise BadMessage(f"{name}: bytes are needed, got {type(value).__name__}")
    return value


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
