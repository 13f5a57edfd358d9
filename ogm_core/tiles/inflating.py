"""Inflating: packed cells whose length is known beforehand, whoever sends them."""

import zlib


def inflated(data: bytes, size: int) -> bytes | None:
    """Exactly `size` bytes, whatever `data` claims to be; None if it is not so long, or goes on after it.

    Raises:
        zlib.error: it is not packed by zlib.
    """
    unpacking = zlib.decompressobj()
    unpacked = unpacking.decompress(data, size + 1)
    return unpacked if len(unpacked) == size and unpacking.eof and not unpacking.unused_data else None
