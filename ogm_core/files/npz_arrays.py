"""NumPy archives (.npz), read with care: an array is what its header announces, or nothing of it is unpacked.

numpy's own reader takes sizes on trust, unpacks before it looks, and evaluates headers as Python. The form is
that of numpy.lib.format, version 1.0, which numpy writes for all arrays of numbers.
"""

import math
import re
import struct
import zipfile
import zlib
from types import TracebackType
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from ogm_core.units import MEBIBYTE

UNREADABLE = (
    *(zipfile.BadZipFile, zlib.error, struct.error, LookupError, ValueError, TypeError, ArithmeticError),
    *(EOFError, OSError, RuntimeError, MemoryError, AttributeError),
)
"""What comes of a damaged archive; NotImplementedError is a RuntimeError."""
_MAGIC = b"\x93NUMPY\x01\x00"
_HEADER = re.compile(
    rb"\{'descr': '(?P<dtype>[<>|][a-zA-Z]\d{0,4})', 'fortran_order': (?P<fortran>True|False), "
    rb"'shape': \((?P<shape>[\d, ]{0,100})\), \} *\n"
)
_PIECE = MEBIBYTE
"""So many bytes are unpacked at once."""
_MAX_RATIO = 1100
"""Deflate packs 1032 bytes into one, and no more."""
_MAX_MEMBERS = 64
_END = struct.Struct("<4s4H2LH")
"""The end of central directory record of an archive without a comment (APPNOTE.TXT, section 4.3.16)."""
_LOCATOR = b"PK\x06\x07"
"""Before that record, only in archives that it is too small for; zipfile believes what it points at."""


class NpzArrays:
    """An archive's arrays by name; use it in a `with`, which leaves the file open.

    Whatever is wrong with the archive raises one of UNREADABLE, here and later.
    """

    def __init__(self, file: BinaryIO) -> None:
        """Look at what the archive lists; `file` is read from any place."""
        _check_end(file)
        self._archive = zipfile.ZipFile(file)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._archive.close()

    def __contains__(self, name: str) -> bool:
        return f"{name}.npy" in self._archive.namelist()

    def __getitem__(self, name: str) -> "PackedArray":
        return PackedArray(self._archive, name)


class PackedArray:
    """One array as its header announces it: `dtype`, `shape`, and the bytes that it takes, `nbytes`."""

    def __init__(self, archive: zipfile.ZipFile, name: str) -> None:
        member = archive.getinfo(f"{name}.npy")
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError(f"{name} is packed by method {member.compress_type}, deflate is needed")
        self._name = name
        self._content = archive.open(member)
        start = self._content.read(len(_MAGIC) + 2)
        length = int.from_bytes(start[len(_MAGIC) :], "little")
        header = self._content.read(length)
        match = _HEADER.fullmatch(header)
        if not start.startswith(_MAGIC) or match is None:
            raise ValueError(f"{name} does not begin as an array of numbers does")
        self.dtype = np.dtype(match["dtype"].decode())
        self.shape = tuple(int(side) for side in match["shape"].split(b",") if side.strip())
        self.nbytes = self.dtype.itemsize * math.prod(self.shape)
        self._by_columns = match["fortran"] == b"True"
        if len(start) + length + self.nbytes != member.file_size:
            raise ValueError(
                f"{name} announces {self.nbytes} bytes of numbers, and the archive {member.file_size} in all"
            )
        if member.file_size > _MAX_RATIO * member.compress_size:
            raise ValueError(
                f"{name} announces {member.file_size} bytes in {member.compress_size}, too many for deflate"
            )

    def read(self) -> NDArray[Any]:
        """Unpack it; dtype and shape, and `nbytes`, the memory that it takes, are looked at before."""
        content = np.empty(self.nbytes, np.uint8)
        at = 0
        while at < self.nbytes:
            part = self._content.read(min(_PIECE, self.nbytes - at))
            if not part:
                raise EOFError(f"{self._name} ends too early")
            content[at : at + len(part)] = np.frombuffer(part, np.uint8)
            at += len(part)
        return content.view(self.dtype).reshape(self.shape, order="F" if self._by_columns else "C")

    def __str__(self) -> str:
        return f"{self.dtype} of shape {self.shape}"


def _check_end(file: BinaryIO) -> None:
    """Refuse an archive that lists many members, before zipfile makes an object of each."""
    file.seek(0, 2)
    size = file.tell()
    file.seek(max(0, size - _END.size - 20))
    end = file.read()
    if len(end) < _END.size or not end[-_END.size :].startswith(b"PK\x05\x06"):
        raise zipfile.BadZipFile("File is not a zip file")
    _, _, _, _, members, directory, _, comment = _END.unpack(end[-_END.size :])
    if end.startswith(_LOCATOR) or comment or members > _MAX_MEMBERS or directory > 1024 * _MAX_MEMBERS:
        raise ValueError(f"it lists {members} members in {directory} bytes, too many for a map")
