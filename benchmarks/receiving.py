"""What a share takes to receive and place a scan that is another share's, above the floor.

The floor is a subscriber that does nothing, beside it: what Zenoh takes to hand a scan to Python. Both get
the same scans, each by itself, through a router: process-CPU of each, divided by the scans. Robots, router,
floor and share are four processes: on two cores they keep each other from running, and caches from being
warm. What a share takes to meet robots is left out: it asks each for scans that it has missed.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection

import httpx
import numpy as np
import zenoh

from benchmarks.live import cpu_time
from benchmarks.robots import WAIT, Drive, driving
from benchmarks.running import STARTED, STOPPED, RunningMapper, line_after, ogm, router
from benchmarks.table import Result
from benchmarks.workloads import lab_exercise
from ogm_client.session import NetworkConfig, open_session
from ogm_core.wire.keys import MapKeys

RATES = (400.0, 1000.0, 5000.0)
"""Scans a second, of all robots."""
ROBOTS = 50
SECONDS, QUICK_SECONDS = 10.0, 2.0
MET, SETTLED = 4.0, 1.0
"""After the first put, in which robots are met, and after the last one, s."""
TARGET = 10.0
"""Above the floor, us, at the highest rate."""
FLAGS = ("--share=1", "--cuts-x=480", "--reach=10", "--http-port=0", "--log-level=error")
"""No robot comes there."""


def run(quick: bool) -> list[Result]:
    """Measure; `quick`: for a shorter time."""
    seconds = QUICK_SECONDS if quick else SECONDS
    scans = [placed.scan for placed in lab_exercise().scans]
    results = []
    with (
        router() as endpoint,
        floor(endpoint) as nothing,
        ogm("mapper", *FLAGS, f"--connect={endpoint}") as process,
    ):
        share = RunningMapper(endpoint, line_after(process, "status ").removesuffix("status"))
        for rate in RATES:
            drive = Drive(endpoint, scans, MET + seconds, ROBOTS, rate / ROBOTS)
            results += of_rate(drive, nothing, share)
    return results


def of_rate(drive: Drive, nothing: Connection, share: RunningMapper) -> list[Result]:
    """What the floor and the share take at one rate."""
    with driving(drive) as robots:
        robots.send("go")
        time.sleep(MET)
        begun = time.monotonic_ns()
        before = _asked(nothing), cpu_time(share)
        put = robots.recv()
        time.sleep(SETTLED)
        after = _asked(nothing), cpu_time(share)
        robots.send("go home")
    scans = int(np.count_nonzero(put >= begun))
    least, whole = (1e6 * (late - early) / scans for early, late in zip(before, after, strict=True))
    rate = drive.robots * drive.rate
    group = f"scans of another share, {rate:g} a second: process-CPU of a scan"
    target = TARGET if rate == max(RATES) else None
    return [
        Result(group, "a subscriber that does nothing", least, "us"),
        Result(group, "a share", whole, "us"),
        Result(group, "a share, above that", whole - least, "us", target, at_least=False),
        Result(group, "scans that the share has dropped, of all so far", _dropped(share), ""),
    ]


@contextmanager
def floor(endpoint: str) -> Iterator[Connection]:
    """A process with a subscriber that does nothing; it tells its CPU time, s, when it is asked anything."""
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_subscribe, args=(endpoint, theirs), daemon=True)
    process.start()
    theirs.close()
    try:
        if not ours.poll(STARTED):
            raise RuntimeError(f"the subscriber did not start within {STARTED:g} s")
        ours.recv()
        yield ours
    finally:
        ours.close()
        process.join(STOPPED)
        process.kill()


def _subscribe(endpoint: str, connection: Connection) -> None:
    nothing = zenoh.handlers.Callback(_do_nothing, indirect=False)
    with open_session(NetworkConfig(connect=(endpoint,))) as session:
        session.declare_subscriber(MapKeys("default").robots, nothing)
        connection.send(time.process_time())
        try:
            while connection.recv():
                connection.send(time.process_time())
        except EOFError:  # nobody asks any more
            return


def _do_nothing(_: zenoh.Sample) -> None:
    pass


def _asked(nothing: Connection) -> float:
    nothing.send("how much?")
    if not nothing.poll(WAIT):
        raise RuntimeError("the subscriber does not answer")
    return float(nothing.recv())


def _dropped(share: RunningMapper) -> int:
    counts = httpx.get(f"{share.url}status").json()["scans"]
    return sum(counts["dropped"].values())
