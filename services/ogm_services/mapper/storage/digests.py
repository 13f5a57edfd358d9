"""Digests of a store's rows, and the root of them all: a row that is missing or older than the rest is seen.

A row has a digest of all that is in it, its name included. The root is the sum of the rows' digests modulo
2^128, so that a transaction costs by the rows that it changes. The sum is of strong hashes, so no other set
of rows that damage could make has the same.
"""

import struct
from collections.abc import Collection
from hashlib import blake2b

from ogm_core.tiles.checkpoint import NOBODY

DIGEST_BYTES = 16
_MODULUS = 1 << 8 * DIGEST_BYTES
_TILE = struct.Struct("<qqq")

TileName = tuple[int, int, str]
"""(tx, ty): the tile's place on the lattice; and whose it is in a map that keeps robots apart."""
RowName = TileName | str
"""Of a tile, or the key of a part of the placing state."""
Changes = dict[RowName, bytes | None]
"""The new digests of rows that are written, None of those that are there no more."""


def tile_digest(name: TileName, revision: int, record: bytes) -> bytes:
    """Digest of a tile's row."""
    tx, ty, robot = name
    place = _TILE.pack(tx, ty, revision)
    if robot == NOBODY:
        return _digest(b"ogm tile", place, record)
    whose = robot.encode()
    return _digest(b"ogm robot tile", len(whose).to_bytes(8, "little"), whose, place, record)


def part_digest(key: str, value: bytes) -> bytes:
    """Digest of a row of the placing state."""
    name = key.encode()
    return _digest(b"ogm placing", len(name).to_bytes(8, "little"), name, value)


def settings_digest(text: str) -> bytes:
    """Digest of the settings that the map was made with."""
    return _digest(b"ogm settings", text.encode())


def state_digest(text: str, root: bytes) -> bytes:
    """Digest of the state and the root."""
    return _digest(b"ogm state", root, text.encode())


def _digest(kind: bytes, *parts: bytes) -> bytes:
    digest = blake2b(digest_size=DIGEST_BYTES, person=kind)
    for part in parts:
        digest.update(part)
    return digest.digest()


class Root:
    """The sum of the digests of a store's rows, by their names."""

    def __init__(self) -> None:
        self._digests: dict[RowName, int] = {}
        self._sum = 0

    @property
    def tiles(self) -> int:
        """How many of the rows are tiles'."""
        return sum(isinstance(name, tuple) for name in self._digests)

    def tiles_of(self, robots: Collection[str]) -> list[RowName]:
        """The rows of these robots' tiles."""
        return [name for name in self._digests if isinstance(name, tuple) and name[2] in robots]

    def put(self, name: RowName, digest: bytes | None) -> None:
        """A row is there now, in place of one of this name if there was one; None: it is there no more."""
        self._sum -= self._digests.pop(name, 0)
        if digest is not None:
            self._digests[name] = number = int.from_bytes(digest, "little")
            self._sum += number
        self._sum %= _MODULUS

    def changed(self, changes: Changes, *, without_tiles: bool = False) -> "Root":
        """What it is after some changes; this one stays."""
        root = Root()
        root._digests, root._sum = self._digests.copy(), self._sum
        if without_tiles:
            for tile in [name for name in root._digests if isinstance(name, tuple)]:
                root.put(tile, None)
        for name, digest in changes.items():
            root.put(name, digest)
        return root

    def with_settings(self, digest: bytes) -> bytes:
        """The root: all rows, and the settings."""
        total: int = (self._sum + int.from_bytes(digest, "little")) % _MODULUS
        return total.to_bytes(DIGEST_BYTES, "little")
