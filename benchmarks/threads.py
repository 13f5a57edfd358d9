"""How much faster two threads fill two maps than one thread does: kernels release Python's global lock."""

import threading
import time
from collections.abc import Callable
from queue import SimpleQueue

from numba import njit

from benchmarks.table import Result
from benchmarks.workloads import big, settings_of
from ogm_core.grid import OccupancyGrid

SCANS = 100
ROUNDS, QUICK_ROUNDS = 40, 6
"""Many short ones: some find both cores idle on a machine that has other things to do."""
TURNS = 20_000_000
TARGET = 1.7
"""Two cores allow 2."""


def run(quick: bool) -> list[Result]:
    """Measure the ordinary map on workload `big`; `quick`: in fewer rounds."""
    work = big(SCANS)
    settings = settings_of(work)

    def fill(grid: OccupancyGrid) -> None:
        for scan, pose, _ in work.scans:
            grid.integrate(scan, pose)

    def fill_new_map() -> None:
        fill(OccupancyGrid(settings))

    known: SimpleQueue[OccupancyGrid] = SimpleQueue()
    for _ in range(2):
        grid = OccupancyGrid(settings)
        fill(grid)
        known.put(grid)

    def fill_map() -> None:
        grid = known.get()
        fill(grid)
        known.put(grid)

    def compute() -> None:
        arithmetic(TURNS)

    tasks = (fill_map, fill_new_map, compute)
    maps, new_maps, alone = speedups(tasks, QUICK_ROUNDS if quick else ROUNDS)
    group = "two threads, times the speed of one"
    return [
        Result(group, "integration of big, a map each", maps, "x", TARGET),
        Result(
            group, "the same into new memory, which the system gives to one thread at a time", new_maps, "x"
        ),
        Result(group, "arithmetic without any memory: what the machine had to give just then", alone, "x"),
    ]


def speedups(tasks: tuple[Callable[[], None], ...], rounds: int) -> list[float]:
    """Of every task: how many times as much of it two threads do in the same wall time, at best."""
    best = {(task, threads): float("inf") for task in tasks for threads in (1, 2)}
    for task in tasks:
        task()  # compiles
    for _ in range(rounds):
        for task, threads in best:
            best[task, threads] = min(best[task, threads], wall_time(task, threads))
    return [2.0 * best[task, 1] / best[task, 2] for task in tasks]


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
