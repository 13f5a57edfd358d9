"""How much sooner several workers make one map of several logs (`ogm build --workers`) than one process does.

"At best" is by CPU time: that of one process, over that of the parent and, in each stage, of the busiest of
so many workers, as if each had a core of its own, and started in no time. Beside it the time that the whole
command takes with two processes on this machine, start and compiled kernels included.
"""

import gzip
import os
import tempfile
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Any

from benchmarks.build_speed import FILE, NAME, Times, build
from benchmarks.table import Result
from benchmarks.workloads import BIG_SCANS, DATASETS, big
from ogm_core.logs.recordings import RecordedScan, write_jsonl
from ogm_core.quality.figures import Consistency
from ogm_services.commands.batch.mapping import files_of_build, map_by_workers
from ogm_services.commands.batch.tasks import Task, run_task
from ogm_services.commands.batch.workers import Workers
from ogm_services.commands.build_request import BuildRequest
from ogm_services.commands.held_scans import ALL_MAPPED
from ogm_services.commands.log_readers import ReadAs
from ogm_services.commands.mapped_logs import MappedLogs, map_logs, readers_of
from ogm_services.settings.settings import Settings
from ogm_services.settings.sources import load_settings

LOGS = 8
ROUNDS, QUICK_ROUNDS = 5, 1
AT_BEST = (2, 4)
READ_AS = ReadAs(80.0)


def run(quick: bool) -> list[Result]:
    """Measure on a recorded building and on the big world, in eight logs each; `quick`: once, fewer scans."""
    rounds = QUICK_ROUNDS if quick else ROUNDS
    settings = load_settings(config=None, flags={"map": {"clear_range": 25.0}}, environ={})
    results = []
    with tempfile.TemporaryDirectory() as folder:
        for name, logs in (("big", big_logs(Path(folder), quick)), (NAME, recorded_logs(Path(folder)))):
            if not logs:
                print(f"left out: batch of {name}, {DATASETS} names no folder with it")
                continue
            group = f"one map of {name} in {len(logs)} logs: times as fast as one process"
            best = [at_best(logs, settings, workers, rounds) for workers in AT_BEST]
            results += [
                Result(group, f"{count} workers, at best, by CPU time", value, "x")
                for count, value in zip(AT_BEST, best, strict=True)
            ]
            wall = wall_ratio(logs, Path(folder, "out"), rounds)
            results.append(Result(group, "the command, --workers 2, on this machine", wall, "x"))
    return results


def big_logs(folder: Path, quick: bool) -> list[Path]:
    """The scans of the big world, in logs."""
    scans = big(BIG_SCANS // 4 if quick else BIG_SCANS).scans
    edges = [len(scans) * number // LOGS for number in range(LOGS + 1)]
    logs = [folder / f"big{number}.jsonl" for number in range(LOGS)]
    for log, (first, end) in zip(logs, pairwise(edges), strict=True):
        write_jsonl(log, [RecordedScan("robot", "laser", placed.scan) for placed in scans[first:end]])
    return logs


def recorded_logs(folder: Path) -> list[Path]:
    """A recorded building, its log cut into several; none if it is not there."""
    packed = Path(os.environ.get(DATASETS, ""), NAME, FILE)
    if not packed.is_file():
        return []
    lines = gzip.decompress(packed.read_bytes()).splitlines(keepends=True)
    logs = [folder / f"part{number}.log" for number in range(LOGS)]
    for number, log in enumerate(logs):
        log.write_bytes(b"".join(lines[len(lines) * number // LOGS : len(lines) * (number + 1) // LOGS]))
    return logs


class CountedWorkers(Workers):
    """Workers that are none: tasks are run one after the other, their CPU time is shared out to so many."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.tasks = self.busiest = 0.0
        """CPU time of all tasks, and that of the busiest worker in each stage, s."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def run(self, text: str, tasks: Sequence[Task]) -> list[Any]:
        """Run them; each is given to the worker that is free first."""
        busy, results = [0.0] * self.count, []
        for task in tasks:
            began = time.process_time()
            results.append(run_task(task))
            spent = time.process_time() - began
            busy[busy.index(min(busy))] += spent
            self.tasks += spent
        self.busiest += max(busy)
        return results


def at_best(logs: list[Path], settings: Settings, count: int, rounds: int) -> float:
    """How many times as fast so many workers would be at best; the least times of several rounds, in turn."""
    alone, together = float("inf"), float("inf")
    request = BuildRequest(logs, logs[0].parent, settings, READ_AS)
    for _ in range(rounds + 1):  # the first one compiles
        began = time.process_time()
        judged(map_logs(readers_of(logs, READ_AS, settings), settings, ALL_MAPPED))
        alone = min(alone, time.process_time() - began)
        workers, began = CountedWorkers(count), time.process_time()
        with files_of_build(logs[0].parent) as files:
            judged(map_by_workers(request, workers, files))
        parent = time.process_time() - began - workers.tasks
        together = min(together, parent + workers.busiest)
    return alone / together


def judged(mapped: MappedLogs) -> None:
    """Hold the scans against the map."""
    mapped.judge(Consistency(mapped.grid.snapshot(), mapped.grid.settings))


def wall_ratio(logs: list[Path], out: Path, rounds: int) -> float:
    """Times of the command with one process and with two, the least of several rounds, in turn."""
    times = Times()
    for _ in range(rounds):
        times.of("alone", lambda: build(logs, out))
        times.of("together", lambda: build(logs, out, "--workers", "2"))
    return times.best["alone"] / times.best["together"]
