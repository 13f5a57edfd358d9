"""What it costs to store the map: the mapper's rate and memory, its writer's time, the disk, the next start.

The rate is that of two mappers that are sent the same scans in turns, one with a stored map and one without,
as fast as they take them: then every tile changes between two commits, which is the most that there can be
to store. The writer's time is what its thread computes between two messages for the map to be stored, at the
same speed. Memory and disk are those of a map that is made more slowly; a fresh process restores it.
"""

import statistics
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import zenoh

from benchmarks.memory import WARM_SCANS, private
from benchmarks.running import line_after, ogm
from benchmarks.table import Result
from benchmarks.throughput import encoded, send
from benchmarks.workloads import WORKLOADS, Workload, first_scans, mapped, settings_of, whole_big
from ogm_client import MapClient
from ogm_client.session import NetworkConfig, open_session
from ogm_core.cells.log_odds import CellType
from ogm_core.grid import OccupancyGrid
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.storage.kept_map import KeptMap
from ogm_services.mapper.storage.map_store import MapStore

_T = TypeVar("_T")

MAPS: tuple[tuple[str, CellType], ...] = (("big", "int16"), ("big", "float64"), ("intel", "int16"))
LAPS, QUICK_LAPS = 15, 5
ROUNDS, QUICK_ROUNDS = 7, 2
SECONDS, QUICK_SECONDS = 10.0, 3.0
"""A map is written for so long, s: in one lap, or as fast as it goes."""
LOOK_EVERY = 100
"""Scans after which the map is looked at."""
DEADLINE = 600.0


def run(quick: bool) -> list[Result]:
    """Measure on `big`, and what is on disk on a recorded building, if there is one; `quick`: less."""
    results = _rate(quick)
    for name, cells in MAPS:
        with (
            TemporaryDirectory() as folder,
            ProcessPoolExecutor(1, mp_context=get_context("spawn"), max_tasks_per_child=1) as process,
        ):

            def alone(function: Callable[..., _T], *arguments: object) -> _T:
                return process.submit(function, name, cells, *arguments).result(DEADLINE)  # noqa: B023

            seconds = QUICK_SECONDS if quick else SECONDS
            stored = Path(folder, "lap")
            without, kept = alone(lap, seconds, None), alone(lap, seconds, stored)
            if without is None or kept is None:
                print(f"left out: the stored map of {name}, there is none")
                continue
            restored = alone(restore, stored)
            longest = alone(keep_pressed, seconds, Path(folder, "pressed"))
        group = f"stored map: {name}, {cells}, {kept.cells:,} known cells"
        more = 1e-6 * (kept.memory - without.memory)
        results += [
            Result(group, "more memory of the process", more, "MB", 30.0, at_least=False),
            Result(group, "longest time of the writer's thread", longest, "ms", 5.0, at_least=False),
            Result(group, "on disk, at most, a known cell", kept.most / kept.cells, "B", 0.7, at_least=False),
            Result(
                group, "on disk, at the end, a known cell", kept.at_end / kept.cells, "B", 0.7, at_least=False
            ),
            Result(group, "restored in, of CPU", restored, "s", 2.0, at_least=False),
        ]
    return results


@dataclass(frozen=True)
class Lap:
    """A map of `cells` known cells, and the memory and the disk that making it has taken, bytes."""

    cells: int
    memory: int
    most: int = 0
    at_end: int = 0


def lap(name: str, cells: CellType, seconds: float, folder: Path | None) -> Lap | None:
    """Map a workload once, in some seconds, while somebody looks at it; None where there is no such workload.

    It is stored in a folder, or nowhere.
    """
    work = WORKLOADS[name]()
    if work is None:
        return None
    mapped(first_scans(work, WARM_SCANS)).snapshot()  # compiles
    before, most = private(), 0
    with _kept(work, cells, folder) as (live, kept):
        for n, placed in enumerate(work.scans):
            live.integrate(placed.scan, placed.pose)
            if kept is not None:
                kept.offer()
                most = max(most, kept.info().bytes)
            if n % LOOK_EVERY == 0:
                live.snapshot()
            time.sleep(seconds / len(work.scans))
        known, memory = live.snapshot().known_cells, private() - before
    at_end = sum(path.stat().st_size for path in folder.iterdir()) if folder else 0
    return Lap(known, memory, max(most, at_end), at_end)


def keep_pressed(name: str, cells: CellType, seconds: float, folder: Path) -> float:
    """Longest time, ms, of the writer's thread for one checkpoint, as fast as a workload is mapped."""
    work = WORKLOADS[name]()
    assert work is not None
    longest, end = 0.0, time.monotonic() + seconds
    with _kept(work, cells, folder) as (live, kept):
        assert kept is not None
        for placed in work.scans:  # compiles
            live.integrate(placed.scan, placed.pose)
            kept.offer()
        while time.monotonic() < end:
            for placed in work.scans:
                live.integrate(placed.scan, placed.pose)
                begin = time.thread_time()
                kept.offer()
                longest = max(longest, time.thread_time() - begin)
    return 1e3 * longest


def restore(name: str, cells: CellType, folder: Path) -> float:
    """CPU time, s, in which this process, a fresh one, restores a map that is stored."""
    work = WORKLOADS[name]()
    assert work is not None
    begin = time.process_time()
    with MapStore(folder) as store:
        assert store.restore(settings_of(work, cells=cells)) is not None
    return time.process_time() - begin


@contextmanager
def _kept(work: Workload, cells: CellType, folder: Path | None) -> Iterator[tuple[LiveMap, KeptMap | None]]:
    settings, kept = settings_of(work, cells=cells), None if folder is None else KeptMap(folder)
    if kept is None:
        yield LiveMap(OccupancyGrid(settings, "epoch", "run")), None
        return
    grid = kept.restored(settings, "run", None) or OccupancyGrid(settings, "epoch", "run")
    live = LiveMap(grid)
    kept.go_on(live, settings, "run", ScanPlacer(live, Receipts(), lambda *_: None))
    kept.keep()
    try:
        yield live, kept
    finally:
        kept.close()


@dataclass
class _Mapper:
    pid: int
    session: zenoh.Session
    seconds: list[float]

    def take(self, payloads: list[bytes], run: str) -> None:
        client = MapClient(session=self.session)
        client.reset()
        self.seconds.append(send(self.session, client, payloads, run))


def _rate(quick: bool) -> list[Result]:
    work = whole_big()
    scans, rounds = len(work.scans) * (QUICK_LAPS if quick else LAPS), QUICK_ROUNDS if quick else ROUNDS
    with TemporaryDirectory() as folder, ExitStack() as running:

        def started(*flags: str) -> _Mapper:
            listen = ("--http-port", "0", "--listen", "tcp/127.0.0.1:0", "--log-level", "warning")
            process = running.enter_context(ogm("mapper", *listen, *flags))
            endpoint = line_after(process, "on Zenoh at ")
            line_after(process, "live map ")
            session = running.enter_context(open_session(NetworkConfig(connect=(endpoint,))))
            return _Mapper(process.pid, session, [])

        without, with_data = started(), started("--data", folder)
        for number in range(rounds + 1):  # the first one warms up
            payloads = encoded(work, scans, f"round{number}")
            for mapper in (without, with_data) if number % 2 else (with_data, without):
                mapper.take(payloads, f"round{number}")
    group, rate = "stored map (--data): big, as fast as it goes, times without", "scans a second, "
    return [
        Result(group, rate + "best of the rounds", _ratio(min, without, with_data), "x", 0.95),
        Result(group, rate + "median of the rounds", _ratio(statistics.median, without, with_data), "x"),
    ]


def _ratio(of: Callable[[list[float]], float], without: _Mapper, with_data: _Mapper) -> float:
    return of(without.seconds[1:]) / of(with_data.seconds[1:])
