"""What a map takes of the memory: bytes for every known cell, as the map counts them and as the system does.

Every map is made in a fresh process, where nothing else is done meanwhile. What the system counts is how much
more of the memory belongs to that process alone ("private") than before the first scan.
"""

import gc
import re
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from benchmarks.corridors import corridors
from benchmarks.table import Result
from benchmarks.workloads import Workload, big, first_scans, mapped
from ogm_core.files.map_files import encode_png

SMAPS = Path("/proc/self/smaps_rollup")
WARM_SCANS = 50
MAPS: dict[str, tuple[str, Callable[[], Workload], float]] = {
    "big": ("big, 200 x 200 m, up to 30 m", big, 2.6),
    "corridors": ("corridors, 1500 m long and 2.5 m wide, up to 10 m", corridors, 6.0),
}
"""By name: what it is, its workload, and the most bytes of a known cell."""
DEADLINE = 300.0


@dataclass(frozen=True)
class Taken:
    """Bytes that a map of `cells` known cells takes: by its own count and the system's; with a picture."""

    cells: int
    counted: int
    private: int
    with_picture: int


def run(quick: bool) -> list[Result]:
    """Measure all MAPS; `quick`: only the last."""
    if not SMAPS.exists():
        print(f"left out: memory, there is no {SMAPS}")
        return []
    results = []
    for name, (what, _, target) in list(MAPS.items())[-1 if quick else 0 :]:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
            taken = process.submit(measured, name).result(DEADLINE)
        group = f"memory of a known cell: {what}; int16, {taken.cells:,} known cells"
        for kind, size, limit in (
            ("resident", taken.private, target),
            ("by the map's own count, that of whole tiles", taken.counted, None),
            ("resident, with a snapshot and a picture of it", taken.with_picture, None),
        ):
            results.append(Result(group, kind, size / taken.cells, "B", limit, at_least=False))
    return results


def measured(name: str) -> Taken:
    """Make a map of MAPS in this process, which should be a fresh one."""
    work = MAPS[name][1]()
    mapped(
        first_scans(work, WARM_SCANS)
    ).snapshot()  # compiles, and lets the heap grow as far as a scan needs
    before = private()
    grid = mapped(work)
    alone = private() - before
    snapshot = grid.snapshot()
    encode_png(snapshot)
    return Taken(snapshot.known_cells, grid.nbytes, alone, private() - before)


def private() -> int:
    """Bytes of memory that belong to this process alone."""
    gc.collect()
    return 1024 * sum(
        int(size) for size in re.findall(r"^Private_\w+:\s*(\d+) kB", SMAPS.read_text(), re.MULTILINE)
    )
