"""Robots that publish scans at a steady rate, all in one process of their own, and when each scan was put."""

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from itertools import count
from multiprocessing import get_context
from multiprocessing.connection import Connection

import numpy as np
from numpy.typing import NDArray

from benchmarks.running import STARTED, STOPPED
from ogm_client import RobotPublisher
from ogm_client.session import NetworkConfig, open_session
from ogm_core.types import Scan

ROBOTS, RATE, DRIFT = 4, 40.0, 1e-3
"""How many robots, scans a second of each, and by what share each one's clock is slower than the one before.

So over two minutes robots meet in every way: evenly spread at first, at the same moment now and then.
"""
WAIT = 10.0
"""How long they wait to be told to set out, and to leave, s."""


@dataclass(frozen=True)
class Drive:
    """What robots do: through `scans`, round and round, from different places, for `seconds`.

    So many `robots`, each of which puts `rate` scans a second.
    """

    endpoint: str
    scans: Sequence[Scan]
    seconds: float
    robots: int = ROBOTS
    rate: float = RATE


@contextmanager
def driving(drive: Drive) -> Iterator[Connection]:
    """Robots in a process of their own, connected; they set out when they are told anything.

    At their end the connection has the times of all puts, in their order: ns of the monotonic clock, which
    is the same for all processes. They leave when they are told anything again.
    """
    context = get_context("spawn")  # a fork of a process with a Zenoh session hangs
    ours, theirs = context.Pipe()
    process = context.Process(target=_drive, args=(drive, theirs), name="robots", daemon=True)
    process.start()
    theirs.close()
    try:
        if not ours.poll(STARTED) or ours.recv() != "ready":
            raise RuntimeError(f"the robots did not start within {STARTED:g} s")
        yield ours
    finally:
        ours.close()
        process.join(STOPPED)
        process.kill()


def timetable(seconds: float, robots: int = ROBOTS, rate: float = RATE) -> list[tuple[float, int]]:
    """When every scan is due, s from the start, and which robot's it is: in order."""
    due = []
    for robot in range(robots):
        period = (1.0 + DRIFT * robot) / rate
        for k in count():
            at = robot / (robots * rate) + k * period
            if at >= seconds:
                break
            due.append((at, robot))
    return sorted(due)


def _drive(drive: Drive, connection: Connection) -> None:
    with ExitStack() as opening:
        session = opening.enter_context(open_session(NetworkConfig(connect=(drive.endpoint,))))
        robots = [
            opening.enter_context(RobotPublisher(f"robot{k}", session=session)) for k in range(drive.robots)
        ]
        for robot in robots:
            robot.wait_for_mapper(STARTED)
        connection.send("ready")
        if connection.poll(WAIT):
            connection.recv()
            connection.send(_put_all(drive, robots))
        connection.poll(WAIT)  # leaving at once, they would take scans with them that are on their way


def _put_all(drive: Drive, robots: Sequence[RobotPublisher]) -> NDArray[np.int64]:
    due = timetable(drive.seconds, drive.robots, drive.rate)
    put, done = np.empty(len(due), np.int64), [0] * drive.robots
    begin = time.monotonic()
    for n, (at, k) in enumerate(due):
        place = (k * len(drive.scans) // drive.robots + done[k]) % len(drive.scans)
        scan = replace(drive.scans[place], run=robots[k].run, seq=done[k])
        done[k] += 1
        time.sleep(max(0.0, begin + at - time.monotonic()))
        put[n] = time.monotonic_ns()
        robots[k].put_scan("laser", scan)
    return put
