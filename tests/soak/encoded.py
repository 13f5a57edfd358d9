"""Scans of the soak as messages that are encoded beforehand: only stamp and seq are put in.

One process can then send many times what mappers take.
"""

from typing import NamedTuple

import msgpack

from ogm_core.types import Scan
from ogm_core.wire.messages import encode_scan


class Encoded(NamedTuple):
    """What stands before and after stamp and seq."""

    start: bytes
    rest: bytes

    @classmethod
    def of(cls, scan: Scan) -> "Encoded":
        """Of a message, whatever its stamp and seq are."""
        payload = encode_scan(scan)
        return cls(payload[:1], payload[1 + len(_first_fields(scan.stamp, scan.seq)) :])

    def message(self, stamp: int, seq: int) -> bytes:
        """The message with this stamp, ns, and seq."""
        return self.start + _first_fields(stamp, seq) + self.rest


def _first_fields(stamp: int, seq: int) -> bytes:
    return bytes(msgpack.packb({"stamp": stamp, "seq": seq}))[1:]
