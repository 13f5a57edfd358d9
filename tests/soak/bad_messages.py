"""Bad messages and requests by kind: what strangers, broken sensors and attackers send."""

import socket
from collections.abc import Callable
from random import Random
from typing import Any
from urllib.parse import urlsplit

import msgpack

from ogm_core.wire.messages import scan_fields
from tests.soak.robots import placed

Make = Callable[[Random], bytes]


def _scan(**changes: Any) -> Make:
    """A scan that would be good but for these fields; None takes a field away."""

    def make(rng: Random) -> bytes:
        fields = {**scan_fields(placed("honest-0", 0).scan), "run": "mallory", "seq": rng.getrandbits(30)}
        fields = {name: value for name, value in {**fields, **changes}.items() if value is not None}
        return msgpack.packb(fields)

    return make


def _nested(depth: int) -> bytes:
    return b"\x91" * depth + b"\xc0"


HOST = "Host: 127.0.0.1"
NAN = float("nan")
MESSAGES: dict[str, Make] = {
    "random bytes": lambda rng: rng.randbytes(rng.randrange(4000)),
    "empty": lambda _: b"",
    "cut off": lambda rng: _scan()(rng)[: rng.randrange(1000)],
    "bits flipped": lambda rng: _flipped(rng, _scan(run="m\x00")(rng)),
    "700,000 empty arrays": lambda _: b"\xdd" + (700_000).to_bytes(4, "big") + b"\x90" * 700_000,
    "nested 100,000 deep": lambda _: _nested(100_000),
    "a field missing": _scan(range_max=None),
    "text for a number": _scan(angle_min="0"),
    "a bool for a number": _scan(angle_min=True),
    "NaN": _scan(angle_increment=NAN),
    "infinite range_max": _scan(range_max=float("inf")),
    "negative seq": _scan(seq=-1),
    "negative stamp": _scan(stamp=-1),
    "ranges cut within a float": _scan(ranges=b"\x00" * 1001),
    "no beams": _scan(ranges=b""),
    "too many beams": _scan(ranges=bytes(4 * 200_001)),
    "run that is no name": _scan(run="../../etc"),
    "run of 1 MB": _scan(run="x" * 1_000_000),
    "pose with two numbers": _scan(pose=[1.0, 2.0]),
    "90,000 unknown fields": lambda _: msgpack.packb({str(n): 0 for n in range(90_000)}),
}
"""Scans that no mapper may take."""

GOOD_BUT_ODD: dict[str, Make] = {
    "stamp near 2^63": _scan(stamp=2**63 - 1),
    "seq near 2^63": _scan(seq=2**63 - 1),
    "range_max of 1 km without a pose": _scan(range_max=1000.0),
}
"""Scans that are well formed, and must do no harm: none of them has a pose."""


def _flipped(rng: Random, payload: bytes) -> bytes:
    at = rng.randrange(len(payload))
    return payload[:at] + bytes([payload[at] ^ 1 << rng.randrange(8)]) + payload[at + 1 :]


def _get(target: str, *headers: str) -> bytes:
    return "\r\n".join([f"GET {target} HTTP/1.1", *headers, "", ""]).encode("latin-1")


def _post(*headers: str) -> bytes:
    return "\r\n".join(["POST /reset HTTP/1.1", HOST, *headers, "", ""]).encode("latin-1")


REQUESTS: dict[str, bytes] = {
    "a URL of 1 MB": _get("/" + "a" * 1_000_000, HOST),
    "headers of 1 MB": _get("/status", HOST, *(f"X-{n}: {'a' * 1000}" for n in range(1000))),
    "no Host": _get("/status"),
    "two Hosts": _get("/status", HOST, "Host: evil.example"),
    "another's Host": _get("/status", "Host: evil.example"),
    "no HTTP": b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc" * 20 + b"\r\n\r\n",
    "unknown route": _get("/etc/passwd", HOST),
    "dots": _get("/../../etc/passwd", HOST),
    "unknown parameter": _get("/map.png?x=1", HOST),
    "a region without end": _get("/map.png?region=-1e300,-1e300,1e300,nan", HOST),
    "a method of its own": b"BREW / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    "a body of 1 MB": _post("Content-Length: 1000000") + bytes(10**6),
    "two lengths": _post("Content-Length: 5", "Content-Length: 6") + b"12345",
    "a page's write": _post("Origin: http://evil.example", "Content-Length: 0"),
}


def answered(url: str, request: bytes) -> str:
    """Status code that a request gets, or "closed" if its connection is closed without one."""
    address = urlsplit(url)
    with socket.create_connection((address.hostname, address.port), timeout=30.0) as connection:
        try:
            connection.sendall(request)
            line = connection.makefile("rb").readline(1000)
        except (ConnectionError, BrokenPipeError):
            return "closed"
    return line.split()[1].decode() if line.startswith(b"HTTP/") else "closed"
