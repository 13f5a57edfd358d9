"""What cutting a map into shares costs: thread-CPU of integrating, beside that of one mapper.

Every share is handed every scan, as the mapper of each is; what it takes to receive and place them comes on
top of that, and is in what processes take, measured last. *All* is the sum over the shares, *the busiest*
the share that has most to do: N of them on N cores take as long as that one. *Copies*: how many shares a
scan writes cells of, on average.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks import share_processes
from benchmarks.table import Result
from benchmarks.workloads import Workload, big, settings_of
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.shares import Cuts, Share

SCANS, QUICK_SCANS = 1000, 100
ROUNDS, QUICK_ROUNDS = 5, 2
REACHES = (10.0, 30.0)
CUTS = {1: Cuts(), 2: Cuts((0.0,)), 4: Cuts((0.0,), (0.0,))}
TARGETS = {1: 1.06, 2: 1.2, 4: 1.4}
"""Of all shares together, times one mapper."""


def run(quick: bool) -> list[Result]:
    """Integrate workload `big` into maps of 1, 2 and 4 shares, then by processes; `quick`: fewer scans."""
    work = big(QUICK_SCANS if quick else SCANS)
    rounds = QUICK_ROUNDS if quick else ROUNDS
    results = [result for reach in REACHES for result in of_reach(work, reach, rounds)]
    return results + share_processes.run(quick)


def of_reach(work: Workload, reach: float, rounds: int) -> list[Result]:
    """The same with one reach, m."""
    whole = replace(settings_of(work), reach=reach)
    settings = {
        (n, k): replace(whole, share=Share(cuts, k)) for n, cuts in CUTS.items() for k in range(cuts.count)
    }
    maps = [filled(work, each) for each in (whole, *settings.values())]
    times = best([partial(filled_again, work, grid) for grid, _ in maps], rounds)
    one, shares = times[0], dict(zip(settings, times[1:], strict=True))
    written = dict(zip(settings, (count for _, count in maps[1:]), strict=True))
    group = f"shares of big, reach {reach:g} m, CPU beside one mapper's"
    results = []
    for n, cuts in CUTS.items():
        own = [shares[n, k] / one for k in range(cuts.count)]
        copies = sum(written[n, k] for k in range(cuts.count)) / len(work.scans)
        results.append(Result(group, f"{n}: all", sum(own), "x", TARGETS[n], at_least=False))
        if n > 1:
            results.append(Result(group, f"{n}: the busiest", max(own), "x"))
            results.append(Result(group, f"{n}: copies of a scan", copies, "x"))
    return results


def filled(work: Workload, settings: GridSettings) -> tuple[OccupancyGrid, int]:
    """A map of all scans, and of how many of them it has a cell."""
    grid = OccupancyGrid(settings)
    updates = [grid.integrate(scan, pose) for scan, pose, _ in work.scans]
    return grid, int(np.count_nonzero(updates))


def filled_again(work: Workload, grid: OccupancyGrid) -> None:
    """All scans once more, into memory that is there."""
    for scan, pose, _ in work.scans:
        grid.integrate(scan, pose)


def best(tasks: Sequence[Callable[[], None]], rounds: int) -> list[float]:
    """The least thread-CPU of each, s: all of them in turn, in every round."""
    found = [float("inf")] * len(tasks)
    for _ in range(rounds):
        for n, task in enumerate(tasks):
            began = time.thread_time()
            task()
            found[n] = min(found[n], time.thread_time() - began)
    return found
