"""Who maps a workload, round by round: the map of this project, and its peers."""

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.process import NoPeer, Peer, build
from benchmarks.workloads import Workload
from ogm_core.errors import OutsideBounds
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings


class Contender(Protocol):
    """Maps a workload as often as it is told to, each time into a fresh map."""

    @property
    def name(self) -> str:
        """What it is called in results."""

    @property
    def pid(self) -> int:
        """The process that does the work; 0 is this one."""

    def round(self) -> NDArray[np.float64]:
        """CPU time of every scan, us."""


class Ours:
    """An `OccupancyGrid`, fed as the mapper feeds it: scan after scan into an unbounded map.

    The peers have their whole map in memory before their clocks start, so this one begins with memory that it
    has used before and that is blank again. With `new_memory` it takes its memory from the system on the way.
    """

    pid = 0

    def __init__(
        self, name: str, work: Workload, settings: GridSettings, *, new_memory: bool = False
    ) -> None:
        """Compile what the settings need, and take the memory."""
        self.name = name
        self.settings = settings
        self.work = work
        self.new_memory = new_memory
        self.grid = OccupancyGrid(settings)
        for n in range(1 if new_memory else len(work.scans)):
            self._add(n)

    def round(self) -> NDArray[np.float64]:
        """Map the workload; `grid` is the map then."""
        self._begin()
        seconds = np.empty(len(self.work.scans))
        for n in range(seconds.size):
            begin = time.thread_time()
            self._add(n)
            seconds[n] = time.thread_time() - begin
        return 1e6 * seconds

    def _begin(self) -> None:
        old, self.grid = self.grid, OccupancyGrid(self.settings)
        if not self.new_memory:
            store = old._store
            for plane in store.planes.values():
                for strip, column in zip(store.touched, plane.tiles(store.touched.shape), strict=True):
                    column[strip != 0] = 0
            self.grid._store = store

    def _add(self, n: int) -> None:
        scan, pose, _ = self.work.scans[n]
        try:
            self.grid.integrate(scan, pose)
        except OutsideBounds:
            return  # as the mapper does: the scan is dropped


def peers(names: Sequence[str], workload: Path, folder: Path) -> list[Peer]:
    """The peers that can be built here, each with the workload file loaded; says which cannot."""
    found = []
    for name in names:
        try:
            found.append(Peer(build(name, folder), workload))
        except NoPeer as reason:
            print(f"left out: {reason}")
    return found


def interleaved(contenders: Sequence[Contender], rounds: int) -> dict[str, float]:
    """CPU time of a scan by contender's name, us: the mean over the scans of each one's best round.

    All take turns, so that a slow minute of the machine is everybody's, and every round all are on the same
    core, the next one in the next round: cores of a shared machine differ. Other programs' load comes and
    goes within a round; that is why every scan has its own best round.
    """
    best: dict[str, NDArray[np.float64]] = {}
    for n in range(rounds):
        for contender in contenders:
            with _on_one_core(n, contender.pid):
                times = contender.round()
            best[contender.name] = np.minimum(best.get(contender.name, times), times)
    return {name: float(times.mean()) for name, times in best.items()}


@contextmanager
def _on_one_core(n: int, pid: int) -> Iterator[None]:
    """Have a process run on core `n` of those that it may use, counted round and round, if the system can."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(pid)
    os.sched_setaffinity(pid, {sorted(cores)[n % len(cores)]})
    try:
        yield
    finally:
        os.sched_setaffinity(pid, cores)
