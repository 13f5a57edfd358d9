"""One map of logs by many workers, cell for cell the one that `mapped_logs` makes of them in turn.

Stage 1, a task a log: its scans are read and placed, and written to files with the cells that each updates.
Then it is known which scans the map takes, and where the work lies. Stage 2, a task an area: the scans that
meet it are integrated, in order, in a map with a clip. The areas' tiles, put together, are the map. Stage 3:
parts of the scans are held against it.
"""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.model import Plane
from ogm_core.errors import LimitReached
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import TILE, CellRect
from ogm_core.quality.figures import Consistency
from ogm_core.tiles.checkpoint import KeptTile, MapState
from ogm_core.tiles.store import tile_bytes
from ogm_services.commands.batch.areas import areas_of
from ogm_services.commands.batch.placed_scans import ScanFiles, ScanIndex
from ogm_services.commands.batch.tasks import Task
from ogm_services.commands.batch.work import ACCEPTED, SIDES, AreaMapped, LogPlaced
from ogm_services.commands.batch.workers import Workers
from ogm_services.commands.build_request import BuildRequest
from ogm_services.commands.log_report import LogReport
from ogm_services.commands.mapped_logs import MappedLogs, path_name
from ogm_services.results.driven_paths import DrivenPath
from ogm_services.results.written import written
from ogm_services.settings.settings import Settings


class _Taken(NamedTuple):
    """What is known of a log before any scan is in the map."""

    log: Path
    placed: LogPlaced
    scans: ScanIndex
    accepted: NDArray[np.bool_]
    """Which of its scans the map takes."""


@contextmanager
def files_of_build(out: Path) -> Iterator[ScanFiles]:
    """A folder for the files of one build, beside `out` or in it, where all workers can read and write."""
    nearest = next(path for path in (out, *out.absolute().parents) if path.is_dir())
    with ExitStack() as stack:
        with written(nearest, "--out"):
            folder = stack.enter_context(
                tempfile.TemporaryDirectory(prefix=".ogm-build-", dir=nearest, ignore_cleanup_errors=True)
            )
        yield ScanFiles(Path(folder).absolute())


def map_by_workers(request: BuildRequest, workers: Workers, files: ScanFiles) -> MappedLogs:
    """Map logs, as `mapped_logs.map_logs` does; `files` are needed until they are judged.

    Raises:
        BadRecording: a log cannot be read or holds no scan.
        LimitReached: there is no room for the map.
        WorkerDied: a worker did, time and again.
    """
    grid = OccupancyGrid(request.settings.grid_settings())
    taken, known = _placed(request, workers, files)
    if known is not None:
        _map_areas(grid, taken, known, request.settings, workers, files)
    logs = len(request.logs)

    def judge(consistency: Consistency) -> None:
        _judge(consistency, grid, request.settings, logs, workers, files)

    held_out = (
        [] if request.held.hold_out is None else [held for log in range(logs) for held in files.held(log)]
    )
    return MappedLogs(grid, [_report(one, grid.settings) for one in taken], held_out, _paths(taken), judge)


def _placed(
    request: BuildRequest, workers: Workers, files: ScanFiles
) -> tuple[list[_Taken], CellRect | None]:
    """The logs with the scans that the map will take, and the cells that it will know, None if none."""
    logs, settings = request.logs, request.settings
    found = [log.absolute() for log in logs] if workers.elsewhere else logs
    tasks = [
        Task("place_log", (files.folder, number, log, settings, request.read_as, request.held), str(log))
        for number, log in enumerate(found)
    ]
    placed: list[LogPlaced] = workers.run("placing logs", tasks)
    grid_settings, known, taken = settings.grid_settings(), None, []
    for number, (log, one) in enumerate(zip(logs, placed, strict=True)):
        one.report.log = log
        index = files.index_of(number)
        accepted, known = accepted_by(grid_settings, index.extents, known)
        taken.append(_Taken(log, one, index, accepted))
    with written(files.folder, "--out"):
        files.write_arrays(ACCEPTED, {str(number): one.accepted for number, one in enumerate(taken)})
    return taken, known


def accepted_by(
    settings: GridSettings, extents: NDArray[np.int64], known: CellRect | None
) -> tuple[NDArray[np.bool_], CellRect | None]:
    """Which scans a map takes that knows the cells of `known`, and which it knows then.

    They update cells of these rectangles, rows of ix, iy, width, height, one scan after the other.
    """
    accepted = np.ones(len(extents), np.bool_)
    for number, row in enumerate(extents.tolist()):
        updated = CellRect(*row)
        if updated.cells:
            stretched = updated if known is None else known.union(updated)
            try:
                settings.check_known(stretched.width, stretched.height)
            except LimitReached:
                accepted[number] = False
            else:
                known = stretched
    return accepted, known


def _map_areas(
    grid: OccupancyGrid,
    taken: Sequence[_Taken],
    known: CellRect,
    settings: Settings,
    workers: Workers,
    files: ScanFiles,
) -> None:
    """Have the areas mapped, and put them together in `grid`, which is empty."""
    extents = np.concatenate([one.scans.extents[one.accepted] for one in taken])
    costs = np.concatenate([one.scans.costs[one.accepted] for one in taken])
    counted = extents[:, 2] > 0
    clips = areas_of(extents[counted], costs[counted], workers.count)
    if grid.bounds is not None:
        clips = [clip for clip in clips if grid.bounds.intersection(clip.rect).cells]
    tasks = [
        Task("map_area", (files.folder, number, clip, settings, len(taken)), f"area {number + 1} of the map")
        for number, clip in enumerate(clips)
    ]
    mapped: list[AreaMapped] = workers.run("mapping areas", tasks)
    stamps = np.concatenate([one.scans.stamps[one.accepted] for one in taken])
    updates = sum(area.cell_updates for area in mapped)
    state = MapState(
        "", len(stamps), int(stamps.max()), updates, known, grid.bounds or known, 0, mapped[0].time
    )
    _check_room(grid, sum(area.tiles for area in mapped), known)
    planes = grid.model.planes
    grid.restore(state, (tile for number in range(len(mapped)) for tile in _tiles(files, number, planes)))


def _tiles(files: ScanFiles, area: int, planes: Sequence[Plane]) -> Iterator[KeptTile]:
    of_planes = {plane.name: files.large(f"area-{area}-{plane.name}") for plane in planes}
    for number, (tx, ty, revision) in enumerate(files.large(f"area-{area}").tolist()):
        yield KeptTile(tx, ty, revision, {name: cells[number] for name, cells in of_planes.items()})


def _check_room(grid: OccupancyGrid, tiles: int, known: CellRect) -> None:
    """Refuse a map that, made of one scan after the other, might have had no room for some of them."""
    width, height = (
        2 * (side + 8192) for side in (known.width, known.height)
    )  # how far a store may have grown
    tables = 8 * (width // TILE + 2) * (height // TILE + 2) + 16 * width
    needed, most = tiles * tile_bytes(grid.model.planes) + tables, grid.settings.max_bytes
    if needed > most:
        raise LimitReached(
            f"the map needs up to {needed} bytes, more than mapper.max_bytes = {most}: raise it, or leave "
            "--workers and --dask out: then scans that have no room are left out, and counted",
            "max_bytes",
        )


def _report(taken: _Taken, settings: GridSettings) -> LogReport:
    """What became of a log's scans, with those that the map has not taken."""
    report, refused = taken.placed.report, int(np.count_nonzero(~taken.accepted))
    if refused:
        report.integrated -= refused
        report.dropped["limit"] += refused
        report.complaints.append(
            f"{refused} scans are dropped (limit): the map would be more than mapper.max_cells = "
            f"{settings.max_cells} cells: raise it, or keep far ends out (reach, bounds)"
        )
    return report


def _paths(taken: Sequence[_Taken]) -> dict[str, DrivenPath]:
    paths: dict[str, DrivenPath] = {}
    for log, placed, scans, accepted in taken:
        of_several = log.name if len(taken) > 1 else ""
        names = [path_name(robot, of_several) for robot in placed.robots]
        robots, bases = scans.robots[accepted].tolist(), scans.bases[accepted].tolist()
        for robot, (x, y) in zip(robots, bases, strict=True):
            paths.setdefault(names[robot], DrivenPath()).go_to((x, y))
    return paths


def _judge(
    consistency: Consistency,
    grid: OccupancyGrid,
    settings: Settings,
    logs: int,
    workers: Workers,
    files: ScanFiles,
) -> None:
    """Have the scans that are in the map held against it, as many by each worker."""
    beliefs = consistency.beliefs
    with written(files.folder, "--out"):
        files.write_large(SIDES, beliefs.sides)
    edges = [grid.revision * number // workers.count for number in range(workers.count + 1)]
    tasks = [
        Task(
            "judge_scans",
            (files.folder, first, end, beliefs.lattice, beliefs.window, settings, logs),
            f"scans {first} to {end - 1}, held against the map",
        )
        for first, end in pairwise(edges)
        if end > first
    ]
    for counts in workers.run("judging", tasks):
        consistency.take(counts)
