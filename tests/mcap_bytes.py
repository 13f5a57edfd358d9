"""MCAP files written byte by byte, by no library: whole, damaged, or with what others never write."""

import struct
import zlib

import lz4.frame
from backports import zstd

MAGIC = b"\x89MCAP0\r\n"
PACK = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstd.compress}


def text(value):
    return struct.pack("<I", len(value.encode())) + value.encode()


def record(kind, body):
    return struct.pack("<BQ", kind, len(body)) + body


def header(profile="ros2"):
    return record(0x01, text(profile) + text("by hand"))


def schema(number, name):
    return record(0x03, struct.pack("<H", number) + text(name) + text("ros2msg") + text("int32 x"))


def channel(number, of_schema, topic, encoding="cdr"):
    fields = struct.pack("<HH", number, of_schema) + text(topic) + text(encoding)
    return record(0x04, fields + struct.pack("<I", 0))


def message(of_channel, time, payload):
    return record(0x05, struct.pack("<HIQQ", of_channel, 0, time, 0) + payload)


def chunk(records, compression="", size=None, checksum=None):
    data = PACK.get(compression, bytes)(records)
    size = len(records) if size is None else size
    checksum = zlib.crc32(records) if checksum is None else checksum
    head = struct.pack("<QQQI", 0, 0, size, checksum) + text(compression)
    return record(0x06, head + struct.pack("<Q", len(data)) + data)


def whole(*records, profile="ros2"):
    """A file of records, without a summary, as the format allows."""
    end = record(0x0F, struct.pack("<I", 0)) + record(0x02, struct.pack("<QQI", 0, 0, 0))
    return MAGIC + header(profile) + b"".join(records) + end + MAGIC
