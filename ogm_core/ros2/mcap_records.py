"""Records of MCAP files: their bytes in, their fields out; https://mcap.dev/spec.

Lengths that they claim are not trusted: nothing is held that is longer than its bytes, or than MAX_CHUNK.
"""

import struct
import sys
import zlib
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import NamedTuple

from ogm_core.errors import MissingExtra, OgmError, cut, printable
from ogm_core.units import MEBIBYTE

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = range(0x01, 0x07)
ATTACHMENT, METADATA, DATA_END = 0x09, 0x0C, 0x0F
"""Kinds of records; there are others, which are of no use here."""
HEAD = struct.Struct("<BQ")
"""Before each record: its kind, and its length."""
MAX_CHUNK = 256 * MEBIBYTE
"""A chunk's records take no more bytes."""
_MESSAGE = struct.Struct("<HIQQ")
MESSAGE_HEAD = _MESSAGE.size
"""What comes before a message's payload, bytes."""
_CHUNK = struct.Struct("<QQQI")


class DamagedRecord(OgmError):
    """A record is not what it claims to be; the text says which."""


class Channel(NamedTuple):
    """A channel, and the schema that its messages have; 0 for none."""

    id: int
    schema: int
    topic: str
    encoding: str
    metadata: dict[str, str]


class Message(NamedTuple):
    """A message; `time` is its log time, ns."""

    channel: int
    time: int
    payload: bytes


def records_in(data: bytes, *, whole: bool = True) -> Iterator[tuple[int, memoryview]]:
    """The records that a chunk holds, by kind; of one that is not whole those that are.

    Raises:
        DamagedRecord: one ends past the others.
    """
    at, view = 0, memoryview(data)
    while at < len(data):
        kind, length = HEAD.unpack_from(data, at) if at + HEAD.size <= len(data) else (0, len(data))
        begin, at = at + HEAD.size, at + HEAD.size + length
        if at > len(data):
            if whole:
                raise DamagedRecord("a record ends past its chunk")
            return
        yield kind, view[begin:at]


def schema(record: memoryview) -> tuple[int, str]:
    """A schema's number and name."""
    (number,), rest = _taken("<H", record)
    name, _ = _text(rest)
    return number, name


def channel(record: memoryview) -> Channel:
    """A channel."""
    (number, of_schema), rest = _taken("<HH", record)
    topic, rest = _text(rest)
    encoding, rest = _text(rest)
    (length,), rest = _taken("<I", rest)
    if length > len(rest):
        raise DamagedRecord("a channel's metadata end past its record")
    metadata, rest = {}, rest[:length]
    while rest:
        key, rest = _text(rest)
        metadata[key], rest = _text(rest)
    return Channel(number, of_schema, topic, encoding, metadata)


def message(record: memoryview) -> Message:
    """A message, or its head alone if no more of it is given."""
    (number, _, time, _), payload = _taken(_MESSAGE.format, record)
    return Message(number, time, bytes(payload))


def chunk(record: bytes, *, whole: bool = True) -> bytes:
    """The records of a chunk; of one that is not whole those that its bytes tell.

    Raises:
        DamagedRecord: it does not match its checksum or its length.
        MissingExtra: what decompresses it is not installed.
    """
    (_, _, size, checksum), rest = _taken(_CHUNK.format, memoryview(record))
    compression, rest = _text(rest)
    (length,), data = _taken("<Q", rest)
    if size > MAX_CHUNK:
        text = f"a chunk of {size} bytes: no more than {MAX_CHUNK} are read at once"
        raise DamagedRecord(text)
    if whole and length != len(data):
        raise DamagedRecord(f"a chunk of {length} bytes has {len(data)}")
    records = _decompressor(compression)(bytes(data), size)
    if not whole:
        return records
    if len(records) != size:
        raise DamagedRecord("a chunk does not decompress to the length that it gives")
    if checksum and zlib.crc32(records) != checksum:
        raise DamagedRecord("a chunk does not match its checksum")
    return records


def _taken(form: str, record: memoryview) -> tuple[tuple[int, ...], memoryview]:
    size = struct.calcsize(form)
    if size > len(record):
        raise DamagedRecord("a record is too short for its kind")
    return struct.unpack(form, record[:size]), record[size:]


def _text(record: memoryview) -> tuple[str, memoryview]:
    (length,), rest = _taken("<I", record)
    if length > len(rest):
        raise DamagedRecord("a text ends past its record")
    try:
        return str(rest[:length], "utf-8"), rest[length:]
    except UnicodeDecodeError:
        raise DamagedRecord("a text is not UTF-8") from None


def _decompressor(compression: str) -> Callable[[bytes, int], bytes]:
    if not compression:
        return lambda data, size: data[: size + 1]
    found = _decompressors().get(compression)
    if found is None:
        raise DamagedRecord(
            f"a chunk is compressed by {cut(printable(compression))!r}, which is none of lz4 and zstd"
        )
    return found


@lru_cache(maxsize=1)
def _decompressors() -> dict[str, Callable[[bytes, int], bytes]]:
    """What decompresses, up to a byte more than a size; loaded when the first chunk needs it."""
    try:
        if sys.version_info >= (3, 14):
            from compression.zstd import ZstdDecompressor, ZstdError
        else:
            from backports.zstd import ZstdDecompressor, ZstdError
        from lz4.frame import LZ4FrameDecompressor
    except ImportError as error:
        raise MissingExtra("bags need lz4 and zstd: pip install 'zenoh-ogm[ros2]'") from error

    def lz4(data: bytes, size: int) -> bytes:
        try:
            return bytes(LZ4FrameDecompressor().decompress(data, max_length=size + 1))
        except RuntimeError as error:
            raise DamagedRecord(f"a chunk does not decompress ({error})") from error

    def zstd(data: bytes, size: int) -> bytes:
        try:
            return bytes(ZstdDecompressor().decompress(data, max_length=size + 1))
        except ZstdError as error:
            raise DamagedRecord(f"a chunk does not decompress ({error})") from error

    return {"lz4": lz4, "zstd": zstd}
