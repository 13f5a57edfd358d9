"""Tile codec: the planes of a tile as checked bytes, and back. It needs no cell model.

A record has a part for each plane, in order:

    form      1 byte     0: the numbers as they are; 1: a palette of them, then one byte each (see palette)
    colours   2 bytes    how many numbers the palette has, 0 without one
    size      4 bytes    of what follows the checksum
    checksum  16 bytes   BLAKE2b of the plane's numbers
    packed    `size`     zlib data: the palette's numbers, if any, and one entry a number

Numbers and sizes are little-endian; a plane's numbers are row after row.
"""

import struct
import zlib
from collections.abc import Iterable, Mapping
from hashlib import blake2b
from typing import Any

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from ogm_core.cells.model import Plane
from ogm_core.errors import BadStore
from ogm_core.tiles.inflating import inflated
from ogm_core.tiles.palette import MAX_NUMBERS, find_palette
from ogm_core.tiles.store import TILE

_HEAD = struct.Struct("<BHI16s")
_AS_THEY_ARE, _PALETTE = 0, 1
_LEVEL = 1
"""Of 0 to 3: the higher ones take twice as long and gain a hundredth."""
_CHECKSUM_BYTES = 16


def encode_tile(planes: Mapping[str, NDArray[Any]]) -> bytes:
    """The record of a tile: its planes, each shape (cells of a tile,), in the order of the mapping."""
    return b"".join(_encoded(np.ascontiguousarray(cells)) for cells in planes.values())


def decode_tile(record: bytes, kinds: Iterable[Plane]) -> dict[str, NDArray[Any]]:
    """The planes of a record that was made of planes of these kinds, in this order.

    Raises:
        BadStore: it is damaged, or was made of other planes; the text says in which way.
    """
    planes, at = {}, 0
    for kind in kinds:
        planes[kind.name], at = _decoded(record, at, kind)
    if at != len(record):
        raise BadStore(f"{len(record) - at} bytes too many")
    return planes


def _encoded(cells: NDArray[Any]) -> bytes:
    dtype = cells.dtype.newbyteorder("<")
    numbers = cells.astype(dtype, copy=False).tobytes()
    form, colours, packed = _AS_THEY_ARE, 0, numbers
    if dtype.itemsize > 1:
        bits = cells.view(f"u{dtype.itemsize}")
        palette, index = np.empty(MAX_NUMBERS, bits.dtype), np.empty(len(bits), np.uint8)
        colours = int(find_palette(bits, palette, index))
        if colours:
            form = _PALETTE
            packed = palette[:colours].astype(palette.dtype.newbyteorder("<")).tobytes() + index.tobytes()
    data = isal_zlib.compress(packed, _LEVEL)
    return _HEAD.pack(form, colours, len(data), _checksum(numbers)) + data


def _decoded(record: bytes, at: int, kind: Plane) -> tuple[NDArray[Any], int]:
    if len(record) < at + _HEAD.size:
        raise BadStore(f"plane {kind.name}: it ends too early")
    form, colours, size, checksum = _HEAD.unpack_from(record, at)
    begin, end = at + _HEAD.size, at + _HEAD.size + size
    count, dtype = (TILE * kind.side) ** 2, np.dtype(kind.dtype).newbyteorder("<")
    if form == _AS_THEY_ARE and not colours:
        entry, head = dtype, 0
    elif form == _PALETTE and 0 < colours <= MAX_NUMBERS:
        entry, head = np.dtype(np.uint8), colours * dtype.itemsize
    else:
        raise BadStore(f"plane {kind.name}: form {form} with {colours} numbers is unknown")
    unpacked = _unpacked(record[begin:end], head + count * entry.itemsize, kind.name)
    cells = np.frombuffer(unpacked, entry, count, head)
    if form == _PALETTE:
        if int(cells.max()) >= colours:
            raise BadStore(f"plane {kind.name}: a cell has a number that its palette has not")
        cells = np.frombuffer(unpacked, dtype, colours)[cells]
    if _checksum(cells.tobytes()) != checksum:
        raise BadStore(f"plane {kind.name}: its checksum is another")
    return cells.astype(kind.dtype, copy=False), end


def _unpacked(data: bytes, size: int, name: str) -> bytes:
    """Exactly `size` bytes, whatever `data` claims to be."""
    try:
        unpacked = inflated(data, size)
    except zlib.error as error:
        raise BadStore(f"plane {name}: {error}") from error
    if unpacked is None:
        raise BadStore(f"plane {name}: it is not as long as a tile")
    return unpacked


def _checksum(numbers: bytes) -> bytes:
    return blake2b(numbers, digest_size=_CHECKSUM_BYTES).digest()
