"""`ogm quality`: maps of recorded logs, judged by scans that are held out of them.

Every log is read once: its scans go into a map of each variant, side by side.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import typer

from ogm_core.errors import BadInput, MapEmpty
from ogm_core.grid import OccupancyGrid
from ogm_core.logs.decimals import read_decimals
from ogm_core.quality.held_out_beams import beams_of
from ogm_core.quality.judged_map import JudgedMap
from ogm_core.quality.judgement import Judgement, judge_by
from ogm_core.quality.reliability import Reliability, reliability
from ogm_core.types import PlacedScan, Pose, Scan, Sweep
from ogm_services.commands.held_scans import HeldScans
from ogm_services.commands.log_feed import LogFeed, LogSink
from ogm_services.commands.log_readers import ReadAs, log_reader
from ogm_services.commands.log_report import LogReport
from ogm_services.results.figure_file import check_figure, format_of, write_figure
from ogm_services.results.quality_table import quality_table
from ogm_services.settings.settings import Settings


class _Judged(NamedTuple):
    """What is known of a variant's map of a log."""

    judgement: Judgement
    reliability: Reliability


@dataclass
class _SideBySide(LogSink):
    """Maps of several variants that take the same scans; held-out ones go aside."""

    grids: dict[str, OccupancyGrid]
    withheld: set[Scan] = field(default_factory=set)
    held: list[PlacedScan] = field(default_factory=list)
    robot: str = ""

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None) -> int:
        """Put a scan into every map, or aside."""
        if scan in self.withheld:
            self.withheld.remove(scan)
            self.held.append(PlacedScan(scan, pose, sweep))
            return 0
        return sum(grid.integrate(scan, pose, sweep) for grid in self.grids.values())


def run_quality(
    logs: Sequence[Path],
    variants: Mapping[str, Settings],
    held: HeldScans,
    *,
    read_as: ReadAs,
    as_json: bool = False,
    figure: Path | None = None,
) -> None:
    """Map every log in every variant, judge the maps by the scans that are `held` out, and print the figures.

    `figure` is a file to draw in how reliable the probabilities are.

    Raises:
        BadInput: a log is given twice, no scan of one is held out, or the figure cannot be written.
        BadRecording: a log cannot be read or holds no scan.
        MapEmpty: no scan of a log changed a map.
    """
    twice = [log for n, log in enumerate(logs) if log in logs[:n]]
    if twice:
        raise BadInput(f"{twice[0]}: this log is given twice")
    if figure is not None:
        check_figure(figure)
    judged: dict[str, dict[str, _Judged]] = {name: {} for name in variants}
    reports = []
    for log in logs:
        report, by_variant = _judge_log(log, variants, held, read_as)
        reports.append(f"{log}: {report}")
        for name, one in by_variant.items():
            judged[name][str(log)] = one
    if figure is not None:
        _draw(figure, judged)
    judgements = {name: {log: one.judgement for log, one in by.items()} for name, by in judged.items()}
    if as_json:
        figures = {name: {log: _figures(one) for log, one in by.items()} for name, by in judgements.items()}
        typer.echo(json.dumps(figures, indent=2))
    else:
        typer.echo("\n".join([*quality_table(judgements), "", *reports]))


def _judge_log(
    log: Path, variants: Mapping[str, Settings], held: HeldScans, read_as: ReadAs
) -> tuple[str, dict[str, _Judged]]:
    """Map a log, and judge the maps; also how it went, in a line."""
    settings = next(iter(variants.values()))
    reader = log_reader(log, read_as, settings, max_beams=settings.mapper.max_beams, decimals=read_decimals)
    sink = _SideBySide({name: OccupancyGrid(of.grid_settings()) for name, of in variants.items()})
    feed = LogFeed(settings, held)
    with reader() as messages:
        feed.run(messages, sink, "mapping")
    integrated = {name: grid.revision for name, grid in sink.grids.items()}
    report = LogReport.of(log, messages, feed, max(integrated.values()), len(sink.held))
    complaints = list(report.complaints)
    if not all(grid.cell_updates for grid in sink.grids.values()):
        raise MapEmpty("; ".join([f"{log}: no scan changed the map ({report.text})", *complaints[:3]]))
    if len(set(integrated.values())) > 1:
        complaints.append(f"{log}: the maps are not of the same scans: {integrated}")
    for line in [*complaints, *report.doubts]:
        typer.echo(line, err=True)
    if not sink.held:
        raise BadInput(
            f"{log}: no scan is held out: a longer log, or --hold-out 2, is needed ({report.text})"
        )
    return report.text, {name: _judge(grid, sink.held) for name, grid in sink.grids.items()}


def _judge(grid: OccupancyGrid, held: Sequence[PlacedScan]) -> _Judged:
    judged, beams = JudgedMap.of(grid.snapshot()), beams_of(held, grid.settings)
    return _Judged(judge_by(judged, beams), reliability(judged, beams.rays))


def _figures(judgement: Judgement) -> dict[str, Any]:
    return {
        "bits": judgement.bits,
        **judgement.walls._asdict(),
        "free_m2": judgement.free_m2,
        "occupied_m2": judgement.occupied_m2,
    }


def _draw(file: Path, judged: Mapping[str, Mapping[str, _Judged]]) -> None:
    # Here, because it loads matplotlib, which need not be there.
    from ogm_services.results.figure import encode_figure
    from ogm_services.results.reliability_figure import draw_reliability

    found = {name: [one.reliability for one in by_log.values()] for name, by_log in judged.items()}
    write_figure(file, encode_figure(draw_reliability(found), format_of(file)))
