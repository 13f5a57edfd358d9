"""How much faster two threads fill two maps than one thread does: kernels release Python's global lock."""

import threading
import time
from collections.abc import Sequence

from benchmarks.table import Result
from benchmarks.workloads import big, settings_of
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.types import PlacedScan

SCANS = 100
ROUNDS, QUICK_ROUNDS = 40, 15
"""Many short ones: some find both cores idle on a machine that has other things to do."""
TARGET = 1.7
"""Two cores allow 2."""


def run(quick: bool) -> list[Result]:
    """Measure the ordinary map on workload `big`; `quick`: in fewer rounds."""
    work = big(SCANS)
    settings = settings_of(work)
    fill_maps(work.scans[:1], settings, threads=1)  # compiles
    alone = together = float("inf")
    for _ in range(QUICK_ROUNDS if quick else ROUNDS):
        alone = min(alone, fill_maps(work.scans, settings, threads=1))
        together = min(together, fill_maps(work.scans, settings, threads=2))
    name = "two threads with a map each, times the speed of one"
    return [Result("threads, integration of big", name, 2.0 * alone / together, "x", TARGET)]


def fill_maps(scans: Sequence[PlacedScan], settings: GridSettings, threads: int) -> float:
    """Wall time, s, in which every thread maps the scans into a map of its own."""
    start = threading.Barrier(threads + 1)

    def fill() -> None:
        grid = OccupancyGrid(settings)
        start.wait()
        for scan, pose, _ in scans:
            grid.integrate(scan, pose)

    workers = [threading.Thread(target=fill) for _ in range(threads)]
    for worker in workers:
        worker.start()
    start.wait()
    begin = time.perf_counter()
    for worker in workers:
        worker.join()
    return time.perf_counter() - begin
