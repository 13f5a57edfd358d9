"""What clients that watch the map live cost, and how soon they see a scan.

Three processes share the machine: four robots (see benchmarks.robots), a mapper, and 50 WebSocket clients in
one process, with views at three levels of detail and in two palettes, ten updates a second each. What the
mapper takes for them is its CPU time, without that which the same robots cost while nobody looks. A client's
latency is the time from a scan's put to the update whose revision counts it, unpacked, tiles and all.
"""

import asyncio
import itertools
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection

import httpx
import msgpack
import numpy as np
from numpy.typing import NDArray
from websockets.asyncio.client import connect

from benchmarks.latency import SETTLED, as_results, latencies
from benchmarks.robots import RATE, ROBOTS, Drive, driving
from benchmarks.running import STARTED, STOPPED, RunningMapper, mapper, wait_for_revision
from benchmarks.table import Result
from benchmarks.workloads import Workload, whole_big
from ogm_client import MapClient
from ogm_core.units import MEBIBYTE

SECONDS, QUICK_SECONDS = 60.0, 5.0
CLIENTS = 50
CLIENT_RATE = 10.0
SHARE_TARGET = 40.0
"""Of a core, %."""
LATENCY_TARGETS = {99: 150.0}
"""Percentiles, ms at most."""
VIEWS = {16: (-2, -2, 1, 0), 15: (-1, -2, 2, 0), 14: (-1, -1, 1, 1)}
"""By z, tiles of which each client sees twelve, or nine, beside each other."""


@dataclass(frozen=True)
class Watched:
    """What a client has seen: when it heard of which revision, and what it was sent."""

    seen: NDArray[np.int64]
    revisions: NDArray[np.int64]
    messages: int
    tiles: int
    size: int


def run(quick: bool) -> list[Result]:
    """Measure on workload `big`; `quick`: for a shorter time."""
    work, seconds = whole_big(), QUICK_SECONDS if quick else SECONDS
    with mapper() as running:
        _driven(running, work, QUICK_SECONDS, 0)  # what is compiled, and allocated, once
        alone, *_ = _driven(running, work, seconds, 0)
        taken, put, before, watched, dropped = _driven(running, work, seconds, CLIENTS)
    group = (
        f"{CLIENTS} WebSocket clients x {CLIENT_RATE:g} Hz beside {ROBOTS} robots x {RATE:g} scans a second"
    )
    share = 100 * (taken - alone) / seconds
    rate = sum(client.messages for client in watched) / seconds
    ms = np.concatenate([latencies(put, client.seen, client.revisions - before) for client in watched])
    return [
        Result(group, "CPU time of the mapper for them, of a core", share, "%", SHARE_TARGET, at_least=False),
        Result(group, "CPU time of the mapper for the scans, of a core", 100 * alone / seconds, "%"),
        Result(group, "updates a second", rate, "/s"),
        Result(group, "tiles a second", sum(client.tiles for client in watched) / seconds, "/s"),
        Result(group, "sent a second", sum(client.size for client in watched) / seconds / MEBIBYTE, "MiB"),
        Result(group, "scans dropped", dropped, "", 0, at_least=False),
        *as_results(f"{group}: from a scan to the update that has it", ms, LATENCY_TARGETS),
    ]


def _driven(
    running: RunningMapper, work: Workload, seconds: float, clients: int
) -> tuple[float, NDArray[np.int64], int, list[Watched], int]:
    """The mapper's CPU time while robots drive, s; the puts, ns; the revision before; what clients saw."""
    drive = Drive(running.endpoint, [placed.scan for placed in work.scans], seconds)
    with ExitStack() as opening:
        client = opening.enter_context(MapClient(running.endpoint))
        before, lost = client.status().revision, _lost(client)
        robots = opening.enter_context(driving(drive))
        watching = opening.enter_context(_watching(running.url, clients))
        begun = _cpu_time(running)
        robots.send("go")
        if not robots.poll(seconds + STARTED):
            raise RuntimeError("the robots did not come back")
        taken, put = _cpu_time(running) - begun, robots.recv()
        wait_for_revision(client, before + put.size)
        time.sleep(2 / CLIENT_RATE)  # the last update
        watching.send("done")
        if not watching.poll(SETTLED):
            raise RuntimeError("the clients did not come back")
        watched = watching.recv()
        robots.send("go home")
        return taken, put, before, watched, _lost(client) - lost


def _lost(client: MapClient) -> int:
    scans = client.status().scans
    return sum(scans.dropped.values()) + scans.lost


def _cpu_time(running: RunningMapper) -> float:
    """What the mapper's process has taken so far, s."""
    text = httpx.get(f"{running.url}metrics").text
    (line,) = (line for line in text.splitlines() if line.startswith("process_cpu_seconds_total "))
    return float(line.split()[1])


@contextmanager
def _watching(url: str, clients: int) -> Iterator[Connection]:
    """So many clients in a process of their own, all of which have seen all of their views."""
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_watch, args=(url, clients, theirs), name="clients", daemon=True)
    process.start()
    theirs.close()
    try:
        if not ours.poll(STARTED) or ours.recv() != "ready":
            raise RuntimeError(f"the clients did not start within {STARTED:g} s")
        yield ours
    finally:
        ours.close()
        process.join(STOPPED)
        process.kill()


def _watch(url: str, clients: int, connection: Connection) -> None:
    asyncio.run(_watch_all(url, clients, connection))


async def _watch_all(url: str, clients: int, connection: Connection) -> None:
    address = url.replace("http", "ws", 1) + "ws"
    kinds = itertools.cycle(itertools.product(VIEWS, ("ros", "dark")))
    logs: list[_Log] = [_Log() for _ in range(clients)]
    tasks = [asyncio.create_task(_one(address, *kind, log)) for log, kind in zip(logs, kinds, strict=False)]
    await asyncio.gather(*(log.ready.wait() for log in logs))
    for log in logs:
        log.clear()
    connection.send("ready")
    await asyncio.to_thread(connection.poll, None)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    connection.send([log.watched() for log in logs])


class _Log:
    """What a client notes."""

    def __init__(self) -> None:
        self.ready = asyncio.Event()
        self.clear()

    def clear(self) -> None:
        """Begin to count."""
        self.seen: list[int] = []
        self.revisions: list[int] = []
        self.messages = self.tiles = self.size = 0

    def note(self, body: bytes) -> None:
        """Note an update."""
        update = msgpack.unpackb(body)
        if not update["more"]:
            self.ready.set()
            self.seen.append(time.monotonic_ns())
            self.revisions.append(update["revision"])
        self.messages += 1
        self.tiles += len(update["tiles"])
        self.size += len(body)

    def watched(self) -> Watched:
        """All that was noted."""
        return Watched(np.array(self.seen), np.array(self.revisions), self.messages, self.tiles, self.size)


async def _one(address: str, z: int, palette: str, log: _Log) -> None:
    async with connect(address, compression=None, max_size=8 * MEBIBYTE) as socket:
        await socket.recv()
        view = {
            "type": "view",
            "z": z,
            "tiles": VIEWS[z],
            "palette": palette,
            "rate": CLIENT_RATE,
            "scans": True,
        }
        await socket.send(msgpack.packb(view))
        async for body in socket:
            assert isinstance(body, bytes)
            log.note(body)
