"""What processes of shares take, from Zenoh into the map: process-CPU of a scan, beside that of one mapper.

One, two or four `ogm mapper` processes on a router, to which a robot puts the same scans steadily, each with
its pose. Each process receives and places all of them. *Copies*: how many processes a scan has cells in.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

import httpx
import numpy as np

from benchmarks.live import cpu_time
from benchmarks.running import HANDLED, RunningMapper, line_after, ogm, router
from benchmarks.table import Result
from benchmarks.workloads import WORKLOADS, Workload
from ogm_client import RobotPublisher
from ogm_core.lattice import TILE
from ogm_core.types import PlacedScan

LOGS = ("big", "intel")
COUNTS = (1, 2, 4)
SCANS, QUICK_SCANS = 900, 100
RATE = 200.0
"""Scans a second: what two cores take in four processes, and a robot beside them."""
REACH = 10.0
WARM = 0.25
"""This part of the scans comes before what is measured: robots are met, caches filled."""


class Taken(NamedTuple):
    """By process: CPU time of a scan, ms, and the part of all scans that it has cells of."""

    cpu: list[float]
    copies: list[float]


def run(quick: bool) -> list[Result]:
    """Measure; `quick`: the smaller log, and less of it."""
    results = []
    for name in LOGS[1:] if quick else LOGS:
        work = WORKLOADS[name]()
        if work is not None:
            results += of_log(work, QUICK_SCANS if quick else SCANS)
    return results


def of_log(work: Workload, scans: int) -> list[Result]:
    """What 1, 2 and 4 processes take for so many scans of a log."""
    group = f"processes of shares of {work.name}, reach {REACH:g} m, CPU of a scan beside one mapper's"
    taken = {n: measured(work, work.scans[:scans], n) for n in COUNTS}
    (one,) = taken[1].cpu
    results = [Result(group, "1: one mapper", one, "ms")]
    for n in COUNTS[1:]:
        results += [
            Result(group, f"{n}: all", sum(taken[n].cpu) / one, "x"),
            Result(group, f"{n}: the busiest", max(taken[n].cpu) / one, "x"),
            Result(group, f"{n}: copies of a scan", sum(taken[n].copies), "x"),
        ]
    return results


def measured(work: Workload, scans: Sequence[PlacedScan], count: int) -> Taken:
    """Let so many processes map scans."""
    warm = round(WARM * len(scans))
    with (
        processes(work, count) as (endpoint, mappers),
        RobotPublisher("robot1", address=endpoint, reliable=True) as robot,
    ):
        robot.wait_for_mapper(HANDLED)
        _put(robot, scans[:warm], mappers, warm)
        before = [(cpu_time(mapper), _written(mapper)) for mapper in mappers]
        _put(robot, scans[warm:], mappers, len(scans))
        after = [(cpu_time(mapper), _written(mapper)) for mapper in mappers]
    cpu, written = ((np.subtract(after, before) / (len(scans) - warm)).T).tolist()
    return Taken([1e3 * each for each in cpu], written)


@contextmanager
def processes(work: Workload, count: int) -> Iterator[tuple[str, list[RunningMapper]]]:
    """So many mappers that are ready, and where their router is; cuts halve the places of scans."""
    flags = [f"--resolution={work.resolution}", f"--alpha={work.alpha}", f"--reach={REACH}"]
    flags += ["--http-port=0", "--log-level=error"]
    cut_x, cut_y = _cuts(work)
    flags += [f"--cuts-x={cut_x}"] * (count > 1) + [f"--cuts-y={cut_y}"] * (count > 2)
    with ExitStack() as opening:
        endpoint = opening.enter_context(router())
        flags += [f"--connect={endpoint}"]
        own = [[f"--share={k}"] * (count > 1) for k in range(count)]
        started = [opening.enter_context(ogm("mapper", *flags, *each)) for each in own]
        where = "status " if count > 1 else "live map "
        urls = [line_after(process, where).removesuffix("status") for process in started]
        yield endpoint, [RunningMapper(endpoint, url) for url in urls]


def _cuts(work: Workload) -> tuple[float, ...]:
    """Medians of where scans were taken, x and y, m, on edges of tiles."""
    tile = TILE * work.resolution
    medians = np.median([placed.pose[:2] for placed in work.scans], axis=0)
    return tuple(round(tile * round(at / tile), 9) for at in medians.tolist())


def _put(
    robot: RobotPublisher, scans: Sequence[PlacedScan], mappers: Sequence[RunningMapper], until: int
) -> None:
    """Put scans at RATE, and wait until every mapper has placed so many in all."""
    begin = time.monotonic()
    for n, (scan, pose, _) in enumerate(scans):
        time.sleep(max(0.0, begin + n / RATE - time.monotonic()))
        robot.publish_scan(
            scan.ranges,
            angle_min=scan.angle_min,
            angle_increment=scan.angle_increment,
            range_min=scan.range_min,
            range_max=scan.range_max,
            pose=pose,
        )
    deadline = time.monotonic() + HANDLED
    while any(_status(mapper)["revision"] < until for mapper in mappers):
        if time.monotonic() > deadline:
            raise RuntimeError(f"{until} scans were not placed within {HANDLED:g} s")
        time.sleep(0.1)


def _written(mapper: RunningMapper) -> int:
    """Scans of which a mapper has cells: its own, and those of others that reach it."""
    scans = _status(mapper)["scans"]
    return int(scans["integrated"] + scans.get("of_others", {}).get("border", 0))


def _status(mapper: RunningMapper) -> dict[str, Any]:
    return dict(httpx.get(f"{mapper.url}status", timeout=HANDLED).json())
