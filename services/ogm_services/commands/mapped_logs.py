"""Logs that were mapped, one after the other into one map: each is placed by itself, as if it were alone.

Robots of two logs have nothing to do with each other, be their names the same: a log's seqs, clocks, poses
and robots that hide each other from a LiDAR are its own.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from ogm_core.grid import OccupancyGrid
from ogm_core.logs.decimals import read_decimals
from ogm_core.quality.figures import Consistency, hints_by
from ogm_core.sensor_models.update_threads import UpdateThreads
from ogm_core.types import PlacedScan, Pose, Scan, Sweep
from ogm_core.units import MEBIBYTE
from ogm_services.commands.held_scans import HeldScans
from ogm_services.commands.log_feed import LogFeed, LogSink
from ogm_services.commands.log_readers import LogReader, ReadAs, log_reader
from ogm_services.commands.log_report import LogReport
from ogm_services.results.driven_paths import DrivenPath
from ogm_services.runtime.progress import progress_bar
from ogm_services.settings.settings import Settings

MAX_KEPT = 256 * MEBIBYTE
"""Bytes of scans that are kept to be judged; logs with more of them are read again."""
_SCAN_BYTES = 1000
"""What a scan takes beside its arrays, about."""


class MappedLogs(NamedTuple):
    """A finished map of logs, and what is to be told of it."""

    grid: OccupancyGrid
    reports: Sequence[LogReport]
    """One a log."""
    held: Sequence[PlacedScan]
    """The scans that were held out, log by log."""
    paths: dict[str, DrivenPath]
    """The ways of the robots, by what a figure calls them."""
    judge: Callable[[Consistency], None]
    """Holds the scans that are in the map against it."""


Readers = Sequence[tuple[Path, Callable[[], AbstractContextManager[LogReader]]]]
"""Logs, and what opens each anew."""


def readers_of(logs: Sequence[Path], read_as: ReadAs, settings: Settings) -> "Readers":
    """What reads the logs.

    Raises:
        BadRecording: what was said of them is for another kind of log.
        MissingExtra: what decompresses an MCAP is not installed.
    """
    most = settings.mapper.max_beams
    return [(log, log_reader(log, read_as, settings, max_beams=most, decimals=read_decimals)) for log in logs]


def map_logs(readers: Readers, settings: Settings, held: HeldScans) -> MappedLogs:
    """Map logs, one after the other.

    Raises:
        BadRecording: a log cannot be read or holds no scan.
    """
    grid = OccupancyGrid(settings.grid_settings())
    first, reports = _MapPass(grid), []
    with UpdateThreads(settings.mapper.thread_count) as threads:
        grid.threads = threads if threads.count > 1 else None
        for log, reader in readers:
            feed = LogFeed(settings, held)
            first.log = "" if len(readers) == 1 else log.name
            before = grid.revision, len(first.held)
            hints = hints_by(grid.snapshot, grid.settings, lambda: grid.time.time)
            with reader() as messages:
                feed.run(messages, first, f"mapping {first.log}".rstrip(), hints)
            counts = grid.revision - before[0], len(first.held) - before[1]
            reports.append(LogReport.of(log, messages, feed, *counts))

    def judge(consistency: Consistency) -> None:
        if first.kept.scans is None:
            _judge_again(readers, settings, held, _JudgePass(consistency, iter(first.accepted)))
            return
        with progress_bar("judging", len(first.kept.scans)) as show:
            for done, placed in enumerate(first.kept.scans, 1):
                consistency.add(placed)
                show(done)

    return MappedLogs(grid, reports, first.held, first.paths, judge)


def path_name(robot: str, log: str) -> str:
    """What a figure calls a robot's way; `log` is the name of its log if there are several, else ""."""
    return f"{robot} in {log}" if log else robot


class _Kept:
    """The scans that the map took, in order, as long as there is room for them."""

    def __init__(self) -> None:
        self.scans: list[PlacedScan] | None = []
        """None once there was no room: not one of them is kept then."""
        self._size = 0

    def add(self, placed: PlacedScan) -> None:
        """Keep a scan, or none at all."""
        if self.scans is None:
            return
        sweep = 0 if placed.sweep is None else placed.sweep.beams.nbytes
        self._size += _SCAN_BYTES + placed.scan.ranges.nbytes + sweep
        if self._size <= MAX_KEPT:
            self.scans.append(placed)
        else:
            self.scans = None


@dataclass
class _MapPass(LogSink):
    """First pass: scans go into the map, or aside if they are held out."""

    grid: OccupancyGrid
    withheld: set[Scan] = field(default_factory=set)
    held: list[PlacedScan] = field(default_factory=list)
    accepted: list[bool] = field(default_factory=list)
    """Of every scan that was placed and not held out, in order: whether the map took it."""
    kept: _Kept = field(default_factory=_Kept)
    log: str = ""
    robot: str = ""
    paths: dict[str, DrivenPath] = field(default_factory=dict)

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None) -> int:
        """Put a scan into the map, or aside."""
        if scan in self.withheld:
            self.withheld.remove(scan)
            self.held.append(PlacedScan(scan, pose, sweep))
            return 0
        self.accepted.append(False)
        updates = self.grid.integrate(scan, pose, sweep)
        self.accepted[-1] = True
        self.kept.add(PlacedScan(scan, pose, sweep))
        self.paths.setdefault(path_name(self.robot, self.log), DrivenPath()).add(scan, pose)
        return updates


def _judge_again(readers: Readers, settings: Settings, held: HeldScans, second: "_JudgePass") -> None:
    """Read the logs again, and hold the scans that are in the map against it."""
    for _, reader in readers:
        with reader() as messages:
            LogFeed(settings, held).run(messages, second, "judging")


@dataclass
class _JudgePass(LogSink):
    """Second pass: the scans that are in the map are held against it."""

    consistency: Consistency
    accepted: Iterator[bool]
    withheld: set[Scan] = field(default_factory=set)
    robot: str = ""

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None) -> int:
        """Judge a scan, if the map took it."""
        if scan in self.withheld:
            self.withheld.remove(scan)
        elif next(self.accepted):
            self.consistency.add(PlacedScan(scan, pose, sweep))
        return 0
