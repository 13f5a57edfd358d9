"""How much of the map's own speed is left behind Zenoh: scans sent as fast as a mapper takes them.

Two processes share the machine: this one sends, with BLOCK; a mapper decodes and integrates. The rate beside
it is that of the same map in this process, filled from memory by one thread while the mapper idles.
"""

import time
from dataclasses import replace

import zenoh

from benchmarks.running import HANDLED, mapper
from benchmarks.table import Result
from benchmarks.workloads import Workload, first_scans, settings_of, whole_big
from ogm_client import MapClient
from ogm_client.session import NetworkConfig, open_session
from ogm_core.grid import OccupancyGrid
from ogm_core.wire import messages
from ogm_core.wire.keys import MapKeys

LAPS, QUICK_LAPS = 3, 1
ROUNDS, QUICK_ROUNDS = 7, 2
AHEAD = 1024
"""Scans that may be on their way; a mapper's queue takes 4096."""
SELDOM, OFTEN = 0.02, 0.001
"""Pause between two questions how far the mapper is, s: meanwhile, and when it is nearly done."""
NEARLY = 100
"""Scans before the end from which it is asked often."""
TARGET = 0.75


def run(quick: bool) -> list[Result]:
    """Measure on workload `big`; `quick`: fewer and shorter rounds."""
    work = whole_big()
    scans, rounds = len(work.scans) * (QUICK_LAPS if quick else LAPS), QUICK_ROUNDS if quick else ROUNDS
    integrate(first_scans(work, 1), 1)  # compiles
    alone: list[float] = []
    served: list[float] = []
    with mapper() as running, open_session(NetworkConfig(connect=(running.endpoint,))) as session:
        client = MapClient(session=session)
        for number in range(rounds):
            alone.append(integrate(work, scans))
            run_name = f"round{number}"
            payloads = encoded(work, scans, run_name)
            client.reset()
            served.append(send(session, client, payloads, run_name))
        lost = scans * rounds - client.status().robots["robot1"].sources["laser"].integrated
    group = "from Zenoh into the map: big, as fast as it goes, two processes"
    name = "times the map's own rate on one core, in memory"
    return [
        Result(group, "scans a second", scans / min(served), "/s"),
        Result(group, "the map alone, in memory", scans / min(alone), "/s"),
        Result(group, name, min(alone) / min(served), "x", TARGET),
        Result(group, "scans lost", lost, "", 0, at_least=False),
    ]


def integrate(work: Workload, scans: int) -> float:
    """Time, s, in which a fresh map takes so many scans, lap after lap."""
    grid = OccupancyGrid(settings_of(work))
    begin = time.perf_counter()
    for n in range(scans):
        scan, pose, _ = work.scans[n % len(work.scans)]
        grid.integrate(scan, pose)
    return time.perf_counter() - begin


def encoded(work: Workload, scans: int, run: str) -> list[bytes]:
    """Messages of so many scans, lap after lap; `run` is the publisher's."""
    placed = (work.scans[n % len(work.scans)] for n in range(scans))
    return [messages.encode_scan(replace(scan, run=run, seq=n)) for n, (scan, _, _) in enumerate(placed)]


def send(session: zenoh.Session, client: MapClient, payloads: list[bytes], run: str) -> float:
    """Time, s, from the first put until the mapper has handled all of them.

    Raises:
        TimeoutError: the mapper does not get there.
    """
    key = MapKeys("default").scan("robot1", "laser")
    deadline = time.monotonic() + HANDLED
    with session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK) as publisher:
        begin = time.perf_counter()
        sent = taken = 0
        while taken < len(payloads):
            until = min(len(payloads), taken + AHEAD)
            for payload in payloads[sent:until]:
                publisher.put(payload)
            sent = until
            time.sleep(SELDOM if len(payloads) - taken > NEARLY else OFTEN)
            taken = handled(client, run)
            if time.monotonic() >= deadline:
                raise TimeoutError(f"{taken} of {len(payloads)} scans were handled within {HANDLED:g} s")
        return time.perf_counter() - begin


def handled(client: MapClient, run: str) -> int:
    """How many scans of a run are in the map, or were dropped; one less while the newest is in hand."""
    sources = [robot.sources["laser"] for robot in client.status().robots.values()]
    source = next((source for source in sources if source.run == run), None)
    if source is None or source.last_seq is None:
        return 0
    return source.last_seq + (source.pending == 0)
