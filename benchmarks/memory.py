"""What a map takes of the memory: bytes for every known cell, as the map counts them and as the system does.

Of a map of counts also for every metre of wall, along which it keeps cells half as wide.

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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.corridors import corridors
from benchmarks.table import Result
from benchmarks.workloads import WORKLOADS, Workload, big, first_scans, mapped
from ogm_core.cells.classes import OCCUPIED, trinary
from ogm_core.cells.rate import Rate
from ogm_core.files.map_files import encode_png

SMAPS = Path("/proc/self/smaps_rollup")
WARM_SCANS = 50
MAPS: dict[str, tuple[str, Callable[[], Workload], float]] = {
    "big": ("big, 200 x 200 m, up to 30 m", big, 2.6),
    "corridors": ("corridors, 1500 m long and 2.5 m wide, up to 10 m", corridors, 6.0),
}
"""By name: what it is, its workload, and the most bytes of a known cell."""
WALLS = ("lab", "intel", "freiburg-079")
"""Workloads whose walls are measured."""
PAGE = 4096
DEADLINE = 300.0


@dataclass(frozen=True)
class Taken:
    """Bytes that a map of `cells` known cells takes: by its own count and the system's; with a picture."""

    cells: int
    counted: int
    private: int
    with_picture: int


@dataclass(frozen=True)
class Walls:
    """Bytes that a map of counts takes of `cells` known cells, and those of its planes of halves."""

    cells: int
    metres: float
    """Of wall: occupied cells of log odds, most of them in rows one cell wide, side by side."""
    private: int
    halves: int


def run(quick: bool) -> list[Result]:
    """Measure all MAPS, and WALLS that are there; `quick`: only the last, and the first."""
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
    return results + [result for name in WALLS[: 1 if quick else None] for result in along_walls(name)]


def along_walls(name: str) -> list[Result]:
    """What a map of counts takes of a workload, in a process of its own."""
    if WORKLOADS[name]() is None:
        print(f"left out: memory of {name}, a recording that is not here")
        return []
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        walls = process.submit(walled, name).result(DEADLINE)
    group = f"memory of a map of counts: {name}; {walls.cells:,} known cells, {walls.metres:.0f} m of wall"
    return [
        Result(group, "resident, a known cell", walls.private / walls.cells, "B"),
        Result(group, "resident, a metre of wall", walls.private / walls.metres / 1000, "kB"),
        Result(group, "of that along walls, in halves", walls.halves / walls.metres / 1000, "kB"),
    ]


def walled(name: str) -> Walls:
    """Make a map of counts in this process, which should be a fresh one, and one that tells its walls."""
    work = WORKLOADS[name]()
    if work is None:
        raise ValueError(f"there is no workload {name}")
    mapped(first_scans(work, WARM_SCANS), Rate()).snapshot()
    before = private()
    grid = mapped(work, Rate())
    alone = private() - before
    halves = sum(pages(plane.cells) for plane in grid._store.planes.values() if plane.side == 2)
    occupied = int(np.count_nonzero(mapped(work).snapshot().encode(trinary) == OCCUPIED))
    return Walls(grid.snapshot().known_cells, occupied * work.resolution, alone, PAGE * halves)


def pages(cells: NDArray[Any]) -> int:
    """How many pages of memory hold a number that is not 0."""
    return int(np.count_nonzero(cells.view(np.uint8).reshape(-1, PAGE).any(axis=1)))


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
