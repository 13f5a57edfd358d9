"""How long an HTTP client waits while others hold connections open for nothing.

The healthy one asks for the map's picture and the status in turn, on one kept connection, as fast as it is
answered. Beside it stand clients that never ask, that have sent half a request, and that have asked for a
large map and do not read it. Both situations take turns, each shorter than the mapper's deadlines.
"""

import http.client
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray

from benchmarks.running import RunningMapper, map_scans, mapper
from benchmarks.table import Result, as_text
from benchmarks.workloads import lab_exercise

IDLE, HALF, STALLED = 200, 200, 50
ROUNDS, QUICK_ROUNDS = 5, 1
SECONDS, QUICK_SECONDS = 8.0, 1.0
TARGET = 2.0
"""p99 beside them, at most so many times what it is without them."""
TIMEOUT = 30.0
BOUNDS = "--bounds=-29,-29,29,29"
"""A map of 1160 x 1160 cells: 4 MB of JSON, which no socket of RECEIVE_BUFFER takes in."""
RECEIVE_BUFFER = 4096
BEGUN = b"HTTP/1.1 200"


def run(quick: bool) -> list[Result]:
    """Measure; `quick`: once, for a shorter time."""
    rounds, seconds = (QUICK_ROUNDS, QUICK_SECONDS) if quick else (ROUNDS, SECONDS)
    alone, beside = [], []
    with mapper(BOUNDS) as running:
        map_scans(running, lab_exercise().scans)
        healthy(running, 1.0)
        for _ in range(rounds):
            alone.append(p99(healthy(running, seconds)))
            with hostile(running):
                beside.append(p99(healthy(running, seconds)))
    without, with_them = float(np.median(alone)), float(np.median(beside))
    beside_whom = f"{IDLE} idle, {HALF} half-sent and {STALLED} stalled clients"
    group = f"HTTP beside {beside_whom}, {rounds} x {seconds:g} s"
    return [
        Result(group, "p99 without them", without, "ms"),
        Result(group, "p99 with them", with_them, "ms"),
        Result(group, "p99 with them, times without", with_them / without, "x", TARGET, at_least=False),
    ]


def p99(ms: NDArray[np.float64]) -> float:
    """The 99th percentile."""
    return float(np.percentile(ms, 99))


def healthy(running: RunningMapper, seconds: float) -> NDArray[np.float64]:
    """How long each answer took, ms."""
    address = urlsplit(running.url)
    connection = http.client.HTTPConnection(address.hostname or "", address.port, timeout=TIMEOUT)
    took, end = [], time.monotonic() + seconds
    while time.monotonic() < end:
        for path in ("/map.png", "/status"):
            began = time.perf_counter()
            connection.request("GET", path)
            answer = connection.getresponse()
            answer.read()
            took.append(1000 * (time.perf_counter() - began))
            assert answer.status == 200, answer.status
    connection.close()
    return np.array(took)


@contextmanager
def hostile(running: RunningMapper) -> Iterator[None]:
    """Clients that hold connections open; all of them still do at the end.

    Raises:
        RuntimeError: a stalled client's map did not begin, or a connection was closed before its deadline.
    """
    with ExitStack() as stack:
        waiting = [connected(running, stack, b"") for _ in range(IDLE)]
        waiting += [connected(running, stack, b"GET /map.png HTTP/1.1\r\nHost: a") for _ in range(HALF)]
        ask = f"GET /map.json HTTP/1.1\r\nHost: {urlsplit(running.url).netloc}\r\n\r\n".encode()
        for stalled in [connected(running, stack, ask) for _ in range(STALLED)]:
            begun = stalled.recv(len(BEGUN), socket.MSG_WAITALL)
            if begun != BEGUN:
                raise RuntimeError(f"a client that was to stall got {begun!r}")
        yield
        for client in waiting:
            client.setblocking(False)
            try:
                said = client.recv(1)
            except BlockingIOError:
                continue
            raise RuntimeError(f"a waiting client was closed, or told {said!r}")


def connected(running: RunningMapper, stack: ExitStack, said: bytes) -> socket.socket:
    """A client with a small buffer that has said so much."""
    address = urlsplit(running.url)
    client = stack.enter_context(socket.socket())
    client.settimeout(TIMEOUT)
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
    client.connect((address.hostname, address.port))
    client.sendall(said)
    return client


if __name__ == "__main__":
    print(as_text(run(quick=False)))
