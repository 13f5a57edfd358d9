"""`ogm build`: a map of recorded logs, without network.

A log goes through the same ScanPlacer as live messages do, in file order. Then the scans that made the map
are held against it, to judge how well it agrees with them: from memory, or in a second pass over logs that
are too large for that.
"""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import typer

from ogm_core.errors import BadInput, MapEmpty
from ogm_core.quality.figures import Consistency, quality_figures
from ogm_core.quality.truth import truth_figures
from ogm_core.simulation.catalogue import world_named
from ogm_core.simulation.worlds import World
from ogm_core.snapshot import MapSnapshot
from ogm_services.commands.batch.dask_workers import DaskWorkers
from ogm_services.commands.batch.mapping import files_of_build, map_by_workers
from ogm_services.commands.batch.workers import WorkerProcesses, Workers
from ogm_services.commands.build_request import BuildRequest
from ogm_services.commands.held_scans import HeldScans
from ogm_services.commands.log_report import LogReport
from ogm_services.commands.mapped_logs import MappedLogs, map_logs, readers_of
from ogm_services.results.figure_file import check_figure, format_of, write_figure
from ogm_services.results.map_folder import check_place, write_map


def run_build(request: BuildRequest) -> None:
    """Map logs, and tell of it: see `build_map`."""
    report, warnings = build_map(request)
    for line in warnings:
        typer.echo(line, err=True)
    typer.echo(report)


def build_map(request: BuildRequest) -> tuple[str, list[str]]:
    """Map logs and write map.png, map.pgm, map.yaml, map.npz and quality.json into the request's folder.

    Of several logs also logs.json, which says what became of each. The files are the same whoever works.
    Returns how it went, and what should be known of the logs.

    Raises:
        BadInput: the world is none, a log is given twice, or the folder or the figure cannot be written;
            nothing is written.
        BadRecording: a log cannot be read or holds no scan; nothing is written.
        MapEmpty: no scan changed the map; nothing is written.
    """
    logs, out, figure, world = request.logs, request.out, request.figure, request.world
    warnings: list[str] = []
    true_world = None if world is None else world_named(world, tell=warnings.append)
    check_place(out)
    if figure is not None:
        check_figure(figure, out)
    check_once(logs)
    with _mapped(request) as mapped:
        snapshot, reports = mapped.grid.snapshot(), mapped.reports
        warnings += _warnings(mapped, snapshot)
        finest = snapshot.finest()
        quality, report = _judged(mapped, finest, request.held), _in_words(out, reports)
    if true_world is not None:
        quality["truth"] = truth_figures(finest, true_world)
        report += f"\n{out}: {_truth_report(true_world, quality['truth'])}"
    drawn = None if figure is None else _drawn(figure, logs, finest, true_world, mapped)
    of_logs = {str(one.log): one.figures for one in reports} if len(logs) > 1 else None
    write_map(out, snapshot, quality, of_logs)
    if figure is not None and drawn is not None:
        write_figure(figure, drawn)
    return report, warnings


@contextmanager
def _mapped(request: BuildRequest) -> Iterator[MappedLogs]:
    """The map of the logs; inside, it can be judged."""
    with ExitStack() as stack:
        workers = workers_of(request)
        if workers is None:
            readers = readers_of(request.logs, request.read_as, request.settings)
            yield map_logs(readers, request.settings, request.held)
            return
        files = stack.enter_context(files_of_build(request.out))
        yield map_by_workers(request, stack.enter_context(workers), files)


def workers_of(request: BuildRequest) -> Workers | None:
    """Who works beside this process, None if nobody does."""
    if request.dask is not None:
        return DaskWorkers(request.dask)
    return None if request.workers == 1 else WorkerProcesses(request.workers)


def check_once(logs: Sequence[Path]) -> None:
    """Refuse logs whose scans would count twice."""
    files = [log.resolve() for log in logs]
    for n, log in enumerate(logs):
        if files[n] in files[:n]:
            raise BadInput(f"{log}: this log is given twice: its scans would count twice")


def _warnings(mapped: MappedLogs, snapshot: MapSnapshot) -> list[str]:
    """What should be known of the logs; MapEmpty if they gave no map."""
    reports = mapped.reports
    if snapshot.empty or not mapped.grid.cell_updates:
        complaints = [line for one in reports for line in one.complaints]
        said = "; ".join(f"{one.log}: no scan changed the map ({one.text})" for one in reports)
        raise MapEmpty("; ".join([said, *complaints[:3]]))
    several = len(reports) > 1
    return [
        f"{one.log}: {line.removeprefix(f'{one.log}: ')}" if several else line
        for one in reports
        for line in [*one.complaints, *one.doubts]
    ]


def _in_words(out: Path, reports: Sequence[LogReport]) -> str:
    if len(reports) == 1:
        return f"{out}: {reports[0].text}"
    scans, integrated = (sum(getattr(one, name) for one in reports) for name in ("scans", "integrated"))
    lines = [f"{one.log}: {one.text}" for one in reports]
    return "\n".join([*lines, f"{out}: {len(reports)} logs, {scans} scans read, {integrated} integrated"])


def _judged(mapped: MappedLogs, snapshot: MapSnapshot, held: HeldScans) -> dict[str, Any]:
    """The figures of a finished map."""
    grid = mapped.grid
    consistency = Consistency(snapshot, grid.settings)
    mapped.judge(consistency)
    quality = quality_figures(snapshot, consistency, grid.cell_updates)
    if held.hold_out is not None:
        # Here, because it loads SciPy, which takes a third of a second.
        from ogm_core.quality.held_out import held_out

        quality["held_out"] = held_out(snapshot, grid.settings, mapped.held)
    return quality


def _truth_report(world: World, figures: dict[str, float | None]) -> str:
    shares = (
        f"{name.replace('_', ' ')} {'none' if value is None else format(value, '.3f')}"
        for name, value in figures.items()
    )
    return f"against the true world {world.name}: {', '.join(shares)}"


def _drawn(
    file: Path, logs: Sequence[Path], snapshot: MapSnapshot, world: World | None, mapped: MappedLogs
) -> bytes:
    # Here, because it loads matplotlib, which need not be there.
    from ogm_services.results.figure import describe, draw_map, encode_figure

    name = logs[0].name if len(logs) == 1 else f"{logs[0].name} and {len(logs) - 1} more"
    figure = draw_map(snapshot, name, describe(snapshot, mapped.grid.settings), world, mapped.paths)
    return encode_figure(figure, format_of(file))
