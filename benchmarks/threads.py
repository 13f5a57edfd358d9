"""How much faster two threads are than one, with a map each, or with one map whose scans they share.

Kernels release Python's global lock.
"""

import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from queue import SimpleQueue
from typing import TypeVar

from numba import njit

from benchmarks.table import Result
from benchmarks.workloads import WORKLOADS, Workload, big, first_scans, settings_of
from ogm_core.grid import OccupancyGrid
from ogm_core.sensor_models.update_threads import UpdateThreads

SCANS = 100
ROUNDS, QUICK_ROUNDS = 40, 6
"""Many short ones: some find both cores idle on a machine that has other things to do."""
TURNS = 20_000_000
TARGET = 1.7
"""Two cores allow 2."""
OF_TWO_MAPS = 0.75
"""What one map is to gain of what two gain."""
NOT_BELOW = 0.97
SMALL = ("lab", "intel", "freiburg-079")
SMALL_SCANS = 200
_T = TypeVar("_T")


def run(quick: bool) -> list[Result]:
    """Measure the ordinary map; `quick`: in fewer rounds."""
    rounds = QUICK_ROUNDS if quick else ROUNDS
    return [*_large(big(SCANS), rounds), *_small(rounds)]


def _large(work: Workload, rounds: int) -> list[Result]:
    settings = settings_of(work)
    known: SimpleQueue[OccupancyGrid] = SimpleQueue()
    for _ in range(2):
        known.put(_filled(OccupancyGrid(settings), work))

    def fill_map() -> None:
        grid = known.get()
        known.put(_filled(grid, work))

    def fill_new_map() -> None:
        _filled(OccupancyGrid(settings), work)

    def compute() -> None:
        arithmetic(TURNS)

    with UpdateThreads(2) as threads:
        shared = _filled(OccupancyGrid(settings), work)
        shared.threads = threads

        def share() -> None:
            _filled(shared, work)

        tasks = fill_map, fill_new_map, compute
        measured = [(task, count) for task in tasks for count in (1, 2)] + [(share, 1)]
        best = fastest({task: partial(wall_time, *task) for task in measured}, rounds)
    maps, new_maps, alone = (2.0 * best[task, 1] / best[task, 2] for task in tasks)
    one_map = best[fill_map, 1] / best[share, 1]
    group = "two threads, times the speed of one"
    return [
        Result(group, "integration of big, a map each", maps, "x", TARGET),
        Result(
            group, "the same into new memory, which the system gives to one thread at a time", new_maps, "x"
        ),
        Result(group, "integration of big, one map that both update (mapper.threads: 2)", one_map, "x"),
        Result(group, "that, as a part of the same with a map each", one_map / maps, "", OF_TWO_MAPS),
        Result(group, "arithmetic without any memory: what the machine had to give just then", alone, "x"),
    ]


def _small(rounds: int) -> list[Result]:
    """Scans that one thread takes alone, in its CPU time."""
    results = []
    for name in SMALL:
        work = WORKLOADS[name]()
        if work is None:
            continue
        work = first_scans(work, SMALL_SCANS)
        grids = [_filled(OccupancyGrid(settings_of(work)), work) for _ in range(2)]
        with UpdateThreads(2) as grids[1].threads:
            tasks = {k: partial(_cpu_time, grid, work) for k, grid in enumerate(grids)}
            one, two = fastest(tasks, rounds).values()
        group = "small scans with mapper.threads: 2, times the speed without"
        results.append(Result(group, f"integration of {name}", one / two, "x", NOT_BELOW))
    return results


def _filled(grid: OccupancyGrid, work: Workload) -> OccupancyGrid:
    for scan, pose, _ in work.scans:
        grid.integrate(scan, pose)
    return grid


def _cpu_time(grid: OccupancyGrid, work: Workload) -> float:
    begin = time.thread_time()
    _filled(grid, work)
    return time.thread_time() - begin


def fastest(tasks: Mapping[_T, Callable[[], float]], rounds: int) -> dict[_T, float]:
    """The shortest time, s, of each task, which measures itself; one after the other, round by round."""
    for task in tasks.values():
        task()  # compiles
    best = dict.fromkeys(tasks, float("inf"))
    for _ in range(rounds):
        for name, task in tasks.items():
            best[name] = min(best[name], task())
    return best


def wall_time(task: Callable[[], None], threads: int) -> float:
    """Time, s, in which every thread does the task once."""
    start = threading.Barrier(threads + 1)

    def once() -> None:
        start.wait()
        task()

    workers = [threading.Thread(target=once) for _ in range(threads)]
    for worker in workers:
        worker.start()
    start.wait()
    begin = time.perf_counter()
    for worker in workers:
        worker.join()
    return time.perf_counter() - begin


@njit(cache=True, nogil=True)
def arithmetic(turns: int) -> int:
    """A chain of multiplications that no compiler shortens."""
    x = 1
    for turn in range(turns):
        x = (x * 6364136223846793005 + turn) ^ (x >> 7)
    return x
