"""What clients that watch the map live cost, and how soon they see a scan.

Three processes share the machine: four robots (see benchmarks.robots), a mapper, and 50 WebSocket clients in
one process, with views at three levels of detail and in two palettes, ten updates a second each. What the
mapper takes for them is its CPU time, without that which the same robots cost while nobody looks. A client's
latency is the time from a scan's put to the update whose revision counts it, unpacked, tiles and all.

What a map of counts costs that is shown as it grows: one page that shows all of a recorded building, beside a
robot that goes through it; left out without OGM_DATASETS.
"""

import asyncio
import itertools
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

import httpx
import msgpack
import numpy as np
from numpy.typing import NDArray
from websockets.asyncio.client import connect

from benchmarks.latency import SETTLED, as_results, latencies
from benchmarks.robots import RATE, ROBOTS, Drive, driving
from benchmarks.running import STARTED, STOPPED, RunningMapper, map_scans, mapper, wait_for_revision
from benchmarks.table import Result
from benchmarks.workloads import WORKLOADS, whole_big
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
COUNTED = "intel"
COUNTED_FLAGS = ("--cell-model", "rate", "--clear-range", "25")
COUNTED_Z = 14
"""A page of 1400 x 900 pixels shows all of the building at this z."""
COUNTED_RATES = (10.0, 40.0)
"""Scans a second."""
COUNTED_TARGET = 20.0
"""Of a core, %."""


@dataclass(frozen=True)
class Watched:
    """What a client has seen: when it heard of which revision, and what it was sent."""

    seen: NDArray[np.int64]
    revisions: NDArray[np.int64]
    messages: int
    tiles: int
    size: int


def run(quick: bool) -> list[Result]:
    """Measure; `quick`: for a shorter time."""
    seconds = QUICK_SECONDS if quick else SECONDS
    return [*_many(seconds), *_counted(seconds)]


def _many(seconds: float) -> list[Result]:
    """Many clients of workload `big`."""
    kinds = itertools.cycle(itertools.product(VIEWS, ("ros", "dark")))
    views = [_view(z, VIEWS[z], palette) for z, palette in itertools.islice(kinds, CLIENTS)]
    with mapper() as running:
        drive = Drive(running.endpoint, [placed.scan for placed in whole_big().scans], seconds)
        _driven(running, replace(drive, seconds=QUICK_SECONDS), [])  # what is compiled, and allocated, once
        alone, *_ = _driven(running, drive, [])
        taken, put, before, watched, dropped = _driven(running, drive, views)
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


def _counted(seconds: float) -> list[Result]:
    """One page that shows all of a building whose map counts."""
    work, results = WORKLOADS[COUNTED](), []
    if work is None:
        print(f"live: a map of counts is left out, for there is no {COUNTED}")
        return []
    with mapper(*COUNTED_FLAGS) as running:
        map_scans(running, work.scans)
        view = _view(COUNTED_Z, _all_tiles(running, COUNTED_Z), "ros")
        for rate in COUNTED_RATES:
            drive = Drive(running.endpoint, [each.scan for each in work.scans], seconds, robots=1, rate=rate)
            _driven(running, replace(drive, seconds=QUICK_SECONDS), [view])
            alone, *_ = _driven(running, drive, [])
            taken, _, _, (watched,), dropped = _driven(running, drive, [view])
            group = f"a page of all of {COUNTED}, cell model rate, beside {rate:g} scans a second"
            share = 100 * CLIENT_RATE * (taken - alone) / watched.messages  # a busy machine sends fewer
            what = f"CPU time of the mapper for it, of a core, at {CLIENT_RATE:g} updates a second"
            results += [
                Result(group, what, share, "%", COUNTED_TARGET, at_least=False),
                Result(group, "updates a second", watched.messages / seconds, "/s"),
                Result(group, "tiles a second", watched.tiles / seconds, "/s"),
                Result(group, "scans dropped", dropped, "", 0, at_least=False),
            ]
    return results


def _view(z: int, tiles: Sequence[int], palette: str) -> dict[str, Any]:
    """What a client says that it shows."""
    return {
        "type": "view",
        "z": z,
        "tiles": list(tiles),
        "palette": palette,
        "rate": CLIENT_RATE,
        "scans": True,
    }


def _all_tiles(running: RunningMapper, z: int) -> tuple[int, int, int, int]:
    """The tiles that show all of the map at a z: x and y of the first and of the last."""
    told = httpx.get(f"{running.url}tiles.json").json()
    side = told["tilesize"] * told["ogm"]["resolution"] * 2 ** (told["maxzoom"] - z)
    (x, y), (west, south, east, north) = told["ogm"]["anchor"], told["ogm"]["extent"]
    first = math.floor((west - x) / side), -math.ceil((north - y) / side)
    return *first, math.ceil((east - x) / side) - 1, -1 - math.floor((south - y) / side)


def _driven(
    running: RunningMapper, drive: Drive, views: Sequence[Mapping[str, Any]]
) -> tuple[float, NDArray[np.int64], int, list[Watched], int]:
    """The mapper's CPU time while robots drive, s; the puts, ns; the revision before; what clients saw."""
    with ExitStack() as opening:
        client = opening.enter_context(MapClient(running.endpoint))
        before, lost = client.status().revision, _lost(client)
        watching = opening.enter_context(_watching(running.url, views))
        robots = opening.enter_context(driving(drive))
        begun = cpu_time(running)
        robots.send("go")
        if not robots.poll(drive.seconds + STARTED):
            raise RuntimeError("the robots did not come back")
        taken, put = cpu_time(running) - begun, robots.recv()
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


def cpu_time(running: RunningMapper) -> float:
    """What the mapper's process has taken so far, s."""
    text = httpx.get(f"{running.url}metrics").text
    (line,) = (line for line in text.splitlines() if line.startswith("process_cpu_seconds_total "))
    return float(line.split()[1])


@contextmanager
def _watching(url: str, views: Sequence[Mapping[str, Any]]) -> Iterator[Connection]:
    """Clients in a process of their own, each of which has seen all of its view."""
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_watch, args=(url, views, theirs), name="clients", daemon=True)
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


def _watch(url: str, views: Sequence[Mapping[str, Any]], connection: Connection) -> None:
    asyncio.run(_watch_all(url, views, connection))


async def _watch_all(url: str, views: Sequence[Mapping[str, Any]], connection: Connection) -> None:
    address = url.replace("http", "ws", 1) + "ws"
    logs: list[_Log] = [_Log() for _ in views]
    tasks = [asyncio.create_task(_one(address, view, log)) for log, view in zip(logs, views, strict=True)]
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


async def _one(address: str, view: Mapping[str, Any], log: _Log) -> None:
    async with connect(address, compression=None, max_size=8 * MEBIBYTE) as socket:
        await socket.recv()
        await socket.send(msgpack.packb(view))
        async for body in socket:
            assert isinstance(body, bytes)
            log.note(body)
