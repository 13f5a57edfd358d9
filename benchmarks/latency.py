"""How long after a robot has put a scan the map shows it, with and without readers of the whole picture.

A scan's latency is the time from its put to the answer of a get of `status` whose revision counts it:
revision n is the nth scan put. Three processes share the machine: four robots (see benchmarks.robots), the
mapper, and this one, which asks again and again over Zenoh, with pauses of half a millisecond. The
readers, if any, are a fourth. Every question costs the mapper time; that is part of what is measured.
A follower is told ten times a second: its latency is until its copy of the map has the scan.
"""

import time
from collections.abc import Callable
from contextlib import ExitStack
from multiprocessing.connection import Connection

import numpy as np
from numpy.typing import NDArray

from benchmarks.http_clients import clients, name, rate_of
from benchmarks.robots import RATE, ROBOTS, Drive, driving
from benchmarks.running import RunningMapper, map_scans, mapper
from benchmarks.table import Result
from benchmarks.workloads import Workload, whole_big
from ogm_client import MapClient

SECONDS, QUICK_SECONDS = 120.0, 3.0
PAUSE = 0.0005
"""Between two questions, s."""
SETTLED = 5.0
"""How long after the last put scans may take to be in the map, s; those that are not then are lost."""
READERS = 8
BOUNDS = "--bounds=-100,-100,100,100"
"""A map of 4000 x 4000 cells."""
ALONE_TARGETS = {50: 3.0, 99: 15.0}
READ_TARGETS = {99: 60.0}
TOLD_TARGETS = {99: 130.0}
"""Percentiles, ms at most."""


def run(quick: bool) -> list[Result]:
    """Measure on workload `big`; `quick`: for a shorter time."""
    work = whole_big()
    seconds = QUICK_SECONDS if quick else SECONDS
    with mapper(BOUNDS) as running:
        map_scans(running, work.scans)
        alone, _ = followed(running, work, seconds, 0)
        read, rate = followed(running, work, seconds, READERS)
        told = told_of(running, work, seconds)
    group = f"latency of {ROBOTS} robots x {RATE:g} scans a second"
    beside = f"{group} for {seconds:g} s; {READERS} clients ({name()}) read the whole 4000 x 4000 picture"
    pictures = Result(beside, "pictures a second", rate, "/s")
    return [
        *as_results(f"{group} for {seconds:g} s", alone, ALONE_TARGETS),
        *as_results(beside, read, READ_TARGETS),
        pictures,
        *as_results(f"{group} for {seconds:g} s, to a follower", told, TOLD_TARGETS),
    ]


def as_results(group: str, ms: NDArray[np.float64], targets: dict[int, float]) -> list[Result]:
    """Percentiles of latencies, ms, inf if lost, with their targets at most."""
    results = [
        Result(group, f"p{share}", percentile(ms, share), "ms", targets.get(share), at_least=False)
        for share in (50, 90, 99, 100)
    ]
    lost = int(np.count_nonzero(np.isinf(ms)))
    return [*results, Result(group, f"scans lost, of {ms.size}", lost, "", 0, at_least=False)]


def percentile(values: NDArray[np.float64], share: float) -> float:
    """The smallest of the values that at least `share` percent of them do not exceed."""
    return float(np.percentile(values, share, method="inverted_cdf"))


def followed(
    running: RunningMapper, work: Workload, seconds: float, readers: int
) -> tuple[NDArray[np.float64], float]:
    """What robots meet beside so many readers.

    Returns the latency of every scan, ms, in the order of the puts, inf for as many as are lost; and how many
    pictures a second the readers got.
    """
    drive = Drive(running.endpoint, [placed.scan for placed in work.scans], seconds)
    with ExitStack() as opening:
        client = opening.enter_context(MapClient(running.endpoint))
        before = client.status().revision
        robots = opening.enter_context(driving(drive))
        reading = None
        if readers:
            reading = opening.enter_context(clients(f"{running.url}map.png", readers, seconds))
        robots.send("go")
        put, seen, revisions = follow(lambda: client.status().revision, robots, before)
        robots.send("go home")
        return latencies(put, seen, revisions - before), rate_of(reading, seconds) if reading else 0.0


def told_of(running: RunningMapper, work: Workload, seconds: float) -> NDArray[np.float64]:
    """The latency of every scan, ms, to a `MapFollower` in this process: until its copy of the map has it."""
    drive = Drive(running.endpoint, [placed.scan for placed in work.scans], seconds)
    with (
        MapClient(running.endpoint) as client,
        client.follow() as follower,
        driving(drive) as robots,
    ):
        before = follower.version.revision
        robots.send("go")
        put, seen, revisions = follow(lambda: follower.version.revision, robots, before)
        robots.send("go home")
        return latencies(put, seen, revisions - before)


def follow(
    revision_now: Callable[[], int], robots: Connection, before: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Ask for the revision, from `before` on, until all that was put is in the map, or SETTLED has passed.

    Returns the time of every put, and the time and revision of every answer that told a new revision, ns.
    """
    put: NDArray[np.int64] | None = None
    seen, revisions, deadline = [time.monotonic_ns()], [before], np.inf
    while time.monotonic() < deadline and (put is None or revisions[-1] < before + put.size):
        revision = revision_now()
        now = time.monotonic_ns()
        if revision != revisions[-1]:
            seen.append(now)
            revisions.append(revision)
        if put is None and robots.poll():
            put, deadline = robots.recv(), time.monotonic() + SETTLED
        time.sleep(PAUSE)
    assert put is not None
    return put, np.array(seen), np.array(revisions)


def latencies(
    put: NDArray[np.int64], seen: NDArray[np.int64], counts: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Time from every put to the first answer that counts it, ms; inf where there is none.

    `put` and `seen` are ns, in order; `counts` is how many scans the map had at each answer, rising.
    """
    first = np.searchsorted(counts, np.arange(1, put.size + 1))
    there = first < seen.size
    ms = np.full(put.size, np.inf)
    ms[there] = (seen[first[there]] - put[there]) / 1e6
    return ms
