"""Inflating: packed cells whose length is known beforehand, whoever sends them."""

import zlib

from isal import igzip_lib, isal_zlib


def inflated(data: bytes, size: int) -> bytes | None:
    """Exactly `size` bytes, whatever `data` claims to be; None if it is not so long, or goes on after it.

    Raises:
        zlib.error: it is not packed by zlib.
    """
    unpacking = isal_zlib.decompressobj()  # a fifth of zlib's time
    try:
        unpacked = unpacking.decompress(data, size + 1)
    except igzip_lib.IsalError as error:  # type: ignore[misc]  # its stub says that it is no error
        raise zlib.error(str(error)) from error
    return unpacked if len(unpacked) == size and unpacking.eof and not unpacking.unused_data else None
