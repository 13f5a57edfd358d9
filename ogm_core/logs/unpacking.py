"""The content of a gzip file, by way of ISA-L, which unpacks a log several times as fast as zlib."""

import gzip
import io
from typing import BinaryIO

from isal import igzip_lib

_CHUNK = 64 * 1024
"""Bytes of the file that are read at once, so that its position tells how much of it is done."""
_MAGIC = b"\x1f\x8b"
_HEADER = 4096
"""So many bytes of a member, if there are, come at once: ISA-L stumbles over parts of some headers."""


class GzipContent(io.RawIOBase):
    """Reads what a gzip file holds, its members one after the other; zeros may follow them.

    Reading raises EOFError if the file ends too early, and gzip.BadGzipFile if it is corrupt or not gzip.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._packed = b""
        """Was read, and not unpacked yet."""
        self._member: igzip_lib.IgzipDecompressor | None = None

    def readable(self) -> bool:
        """Yes: io.BufferedReader asks."""
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]  # as io.BufferedReader calls it
        """Fill a buffer as far as one step goes; return how many bytes these are, 0 at the end."""
        while (member := self._member or self._next_member()) is not None:
            if content := self._unpacked(member, len(buffer)):
                buffer[: len(content)] = content
                return len(content)
        return 0

    def _next_member(self) -> igzip_lib.IgzipDecompressor | None:
        """What unpacks the next member; None if there is none."""
        packed = self._packed.lstrip(b"\0")
        while len(packed) < _HEADER and (more := self._file.read(_CHUNK)):
            packed = (packed + more).lstrip(b"\0")
        if packed and not packed.startswith(_MAGIC):
            raise gzip.BadGzipFile(f"no gzip begins with {packed[:2]!r}")
        self._packed = packed
        self._member = igzip_lib.IgzipDecompressor(flag=igzip_lib.DECOMP_GZIP) if packed else None
        return self._member

    def _unpacked(self, member: igzip_lib.IgzipDecompressor, size: int) -> bytes:
        """Up to `size` bytes of the member in hand; none may mean that one more step is needed."""
        if member.needs_input and not self._packed:
            self._packed = self._file.read(_CHUNK)
            if not self._packed:
                raise EOFError
        packed, self._packed = self._packed, b""
        try:
            content = member.decompress(packed, size)
        except igzip_lib.IsalError as error:  # type: ignore[misc]  # its stub calls it an instance
            raise gzip.BadGzipFile(str(error)) from error
        if member.eof:
            self._packed, self._member = member.unused_data, None
        return content
