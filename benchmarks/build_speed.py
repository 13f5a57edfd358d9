"""How fast `ogm build` maps a recorded building: the whole command, and what its parts take."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from benchmarks.running import ROOT, STARTED, environment
from benchmarks.table import Result
from benchmarks.workloads import DATASETS, Workload, mapped, recorded
from ogm_core.grid import OccupancyGrid
from ogm_core.logs.decimals import read_decimals
from ogm_core.logs.recordings import RecordedScan, RecordingReader, write_jsonl
from ogm_core.quality.figures import Consistency, quality_figures
from ogm_core.snapshot import MapSnapshot
from ogm_services.results.map_folder import write_map

NAME, FILE = "freiburg-079", "freiburg-079-corrected.log.gz"
FLAGS = ("--range-max", "80", "--clear-range", "25")
"""What `benchmarks.workloads.recorded` takes the log to be."""
ROUNDS, QUICK_ROUNDS = 7, 1
TARGET = 200.0

T = TypeVar("T")


def run(quick: bool) -> list[Result]:
    """Measure on a recorded building; `quick`: once."""
    work = recorded(NAME, FILE)
    if work is None:
        print(f"left out: ogm build, {DATASETS} names no folder with {NAME}")
        return []
    log = Path(os.environ[DATASETS], NAME, FILE).resolve()
    times = Times()
    with tempfile.TemporaryDirectory() as folder:
        short, out = Path(folder, "short.jsonl"), Path(folder, "map")
        write_jsonl(short, first_scan(log))
        build([short], out)  # compiles, and warms the caches
        for _ in range(QUICK_ROUNDS if quick else ROUNDS):
            times.of("the whole command", lambda: build([log], out))
            times.of("start: the same of one scan", lambda: build([short], out))
            parts(log, work, out, times)
    span = (work.scans[-1].scan.stamp - work.scans[0].scan.stamp) / 1e9
    group = f"ogm build of {NAME}: {len(work.scans)} scans of {span:,.0f} s"
    speed = span / times.best["the whole command"]
    results = [Result(group, "times as fast as it was recorded", speed, "x", TARGET)]
    return results + [Result(group, name, 1e3 * seconds, "ms") for name, seconds in times.best.items()]


class Times:
    """The least wall time, s, of what was done in several rounds, by its name."""

    def __init__(self) -> None:
        self.best: dict[str, float] = {}

    def of(self, name: str, work: Callable[[], T]) -> T:
        """Do it once more; what it returns."""
        begin = time.perf_counter()
        done = work()
        self.best[name] = min(self.best.get(name, float("inf")), time.perf_counter() - begin)
        return done


def parts(log: Path, work: Workload, out: Path, times: Times) -> None:
    """Do in this process what the command does, part by part."""
    times.of("reading", lambda: read(log))
    grid = times.of("integrating", lambda: mapped(work))
    snapshot, quality = times.of("judging", lambda: judged(grid, work))
    times.of("writing", lambda: write_map(out, snapshot, quality))


def build(logs: Sequence[Path], out: Path, *flags: str) -> None:
    """Run the command."""
    command = [
        sys.executable,
        "-m",
        "ogm_services",
        "build",
        *map(str, logs),
        "--out",
        str(out),
        *FLAGS,
        *flags,
    ]
    done = subprocess.run(
        command, cwd=ROOT, env=environment(), timeout=STARTED, capture_output=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{command!r}: {done.stderr.decode()}")


def first_scan(log: Path) -> list[RecordedScan]:
    """The first scan of a log."""
    with RecordingReader(log, range_max=80.0) as messages:
        return [next(message for message in messages if isinstance(message, RecordedScan))]


def read(log: Path) -> int:
    """Read a log as the command does; the number of its messages."""
    with RecordingReader(log, range_max=80.0, decimals=read_decimals) as messages:
        return sum(1 for _ in messages)


def judged(grid: OccupancyGrid, work: Workload) -> tuple[MapSnapshot, dict[str, Any]]:
    """A snapshot of the map and its quality figures."""
    snapshot = grid.snapshot()
    consistency = Consistency(snapshot, grid.settings)
    for placed in work.scans:
        consistency.add(placed)
    return snapshot, quality_figures(snapshot, consistency, grid.cell_updates)
