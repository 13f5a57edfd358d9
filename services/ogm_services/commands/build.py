"""`ogm build`: a map of a recorded log, without network.

The log goes through the same ScanPlacer as live messages do, in file order. Then the scans that made the map
are held against it, to judge how well it agrees with them: from memory, or in a second pass over a log that
is too large for that.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import typer

from ogm_core.errors import MapEmpty
from ogm_core.grid import OccupancyGrid
from ogm_core.logs.decimals import read_decimals
from ogm_core.quality.figures import Consistency, hints_by, quality_figures
from ogm_core.quality.held_out import held_out
from ogm_core.quality.truth import truth_figures
from ogm_core.simulation.catalogue import world_named
from ogm_core.simulation.worlds import World
from ogm_core.snapshot import MapSnapshot
from ogm_core.types import PlacedScan, Pose, Scan, Sweep
from ogm_core.units import MEBIBYTE
from ogm_services.commands.held_scans import ALL_MAPPED, HeldScans
from ogm_services.commands.log_feed import LogFeed, LogSink
from ogm_services.commands.log_readers import AS_IT_SAYS, LogReader, ReadAs, log_reader
from ogm_services.commands.log_report import doubts, outcomes
from ogm_services.results.driven_paths import DrivenPath
from ogm_services.results.figure_file import check_figure, format_of, write_figure
from ogm_services.results.map_folder import check_place, write_map
from ogm_services.runtime.progress import progress_bar
from ogm_services.settings.settings import Settings

MAX_KEPT = 256 * MEBIBYTE
"""Bytes of scans that are kept to be judged; a log with more of them is read again."""
_SCAN_BYTES = 1000
"""What a scan takes beside its arrays, about."""


def run_build(
    log: Path,
    out: Path,
    settings: Settings,
    *,
    read_as: ReadAs = AS_IT_SAYS,
    held: HeldScans = ALL_MAPPED,
    world: str | None = None,
    figure: Path | None = None,
) -> None:
    """Map a log and write map.png, map.pgm, map.yaml, map.npz and quality.json into `out`.

    `held` keeps scans out of the map, and judges it by them.
    `world`, a name or path as of `world_named`, judges the map by the truth. `figure` is a file to draw in.

    Raises:
        BadInput: the world is none, or the folder or the figure cannot be written; nothing is written.
        BadRecording: the log cannot be read or holds no scan; nothing is written.
        MapEmpty: no scan changed the map; nothing is written.
    """
    max_beams = settings.mapper.max_beams
    true_world = None if world is None else world_named(world, tell=partial(typer.echo, err=True))
    check_place(out)
    if figure is not None:
        check_figure(figure, out)
    reader = log_reader(log, read_as, settings, max_beams=max_beams, decimals=read_decimals)
    grid = OccupancyGrid(settings.grid_settings())
    first, feed = _MapPass(grid), LogFeed(settings, held)
    with reader() as messages:
        feed.run(messages, first, "mapping", hints_by(grid.snapshot, grid.settings, lambda: grid.time.time))
    snapshot = grid.snapshot()
    report = outcomes(messages, feed, grid.revision, len(first.held))
    complaints = feed.complaints.lines()
    if snapshot.empty or not grid.cell_updates:
        raise MapEmpty("; ".join([f"{log}: no scan changed the map ({report})", *complaints[:3]]))
    for line in [*complaints, *doubts(log, messages, feed)]:
        typer.echo(line, err=True)
    finest = snapshot.finest()
    quality = _judged(reader, finest, first, held, settings)
    if true_world is not None:
        quality["truth"] = truth_figures(finest, true_world)
        report += f"\n{out}: {_truth_report(true_world, quality['truth'])}"
    drawn = None if figure is None else _drawn(figure, log, finest, true_world, first)
    write_map(out, snapshot, quality)
    if figure is not None and drawn is not None:
        write_figure(figure, drawn)
    typer.echo(f"{out}: {report}")


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
        self.paths.setdefault(self.robot, DrivenPath()).add(scan, pose)
        return updates


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


def _judged(
    reader: Callable[[], LogReader],
    snapshot: MapSnapshot,
    first: _MapPass,
    held: HeldScans,
    settings: Settings,
) -> dict[str, Any]:
    """The figures of a finished map."""
    grid = first.grid
    consistency = Consistency(snapshot, grid.settings)
    if first.kept.scans is None:
        with reader() as messages:
            second = _JudgePass(consistency, iter(first.accepted))
            LogFeed(settings, held).run(messages, second, "judging")
    else:
        with progress_bar("judging", len(first.kept.scans)) as show:
            for done, placed in enumerate(first.kept.scans, 1):
                consistency.add(placed)
                show(done)
    quality = quality_figures(snapshot, consistency, grid.cell_updates)
    if held.hold_out is not None:
        quality["held_out"] = held_out(snapshot, grid.settings, first.held)
    return quality


def _truth_report(world: World, figures: dict[str, float | None]) -> str:
    shares = (
        f"{name.replace('_', ' ')} {'none' if value is None else format(value, '.3f')}"
        for name, value in figures.items()
    )
    return f"against the true world {world.name}: {', '.join(shares)}"


def _drawn(file: Path, log: Path, snapshot: MapSnapshot, world: World | None, first: _MapPass) -> bytes:
    # Here, because it loads matplotlib, which need not be there.
    from ogm_services.results.figure import describe, draw_map, encode_figure

    figure = draw_map(snapshot, log.name, describe(snapshot, first.grid.settings), world, first.paths)
    return encode_figure(figure, format_of(file))
