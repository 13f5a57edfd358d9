"""What workers do for a build: a log is placed, an area is mapped, scans are held against the map.

Whatever a task needs is in its arguments or in the files of the build, and both are small enough to be sent:
it may run in another process, on another machine that has the same disk, and twice.
"""

from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.forgetting import MapTime
from ogm_core.errors import LimitReached, ScanRefused
from ogm_core.grid import OccupancyGrid
from ogm_core.lattice import CellRect, Clip, Lattice
from ogm_core.quality.figures import Beliefs
from ogm_core.sensor_models.evidence import observe
from ogm_core.tiles.extent import Extent
from ogm_core.types import PlacedScan, Pose, Scan, Sweep
from ogm_services.commands.batch.placed_scans import PlacedLog, ScanFiles
from ogm_services.commands.held_scans import HeldScans
from ogm_services.commands.log_feed import LogFeed, LogSink
from ogm_services.commands.log_readers import ReadAs
from ogm_services.commands.log_report import LogReport
from ogm_services.commands.mapped_logs import readers_of
from ogm_services.results.driven_paths import base_of
from ogm_services.results.written import written
from ogm_services.settings.settings import Settings

ACCEPTED = "accepted"
"""Name of the file that says of every log which of its scans the map takes."""
SIDES = "sides"
"""Name of the file with what is believed of the finished map's cells."""
_PLACING = 500.0
"""What a scan costs an area beside its cells, in cells."""


class LogPlaced(NamedTuple):
    """A log of which all scans are placed."""

    report: LogReport
    robots: list[str]


class _Place(LogSink):
    """Scans are written down, with the cells that each will update; what a map would refuse is refused."""

    def __init__(self, settings: Settings, placed: PlacedLog) -> None:
        self.withheld: set[Scan] = set()
        self.robot = ""
        self._settings = settings.grid_settings()
        self._extent = Extent(self._settings.bounds_rect, None)
        self._placed = placed

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None) -> int:
        """Write a scan down."""
        placed = PlacedScan(scan, pose, sweep)
        if scan in self.withheld:
            self.withheld.remove(scan)
            self._placed.held.append(placed)
            return 0
        extent = self._extent.counted(observe(placed, self._settings).extent())
        # As many cells a beam as its rectangle is wide, about.
        cost = _PLACING + 0.3 * scan.ranges.size * (extent.width + extent.height)
        self._placed.add(placed, extent, cost, self.robot, base_of(scan, pose))
        return 0


def place_log(
    folder: Path, number: int, log: Path, settings: Settings, read_as: ReadAs, held: HeldScans
) -> LogPlaced:
    """Read a log, and place its scans, by themselves.

    Raises:
        BadRecording: it cannot be read or holds no scan.
        BadInput: the files of the build cannot be written.
    """
    files = ScanFiles(folder)
    ((_, reader),) = readers_of([log], read_as, settings)
    part, feed = files.new(), LogFeed(settings, held)
    with written(folder, "--out"):
        with part.open("wb") as file:
            placed = PlacedLog(file)
            with reader() as messages:
                feed.run(messages, _Place(settings, placed), "placing")
        files.write_log(number, part, placed)
    return LogPlaced(LogReport.of(log, messages, feed, len(placed), len(placed.held)), placed.robots)


class AreaMapped(NamedTuple):
    """An area of a map that is finished: its tiles are in a file."""

    time: MapTime
    cell_updates: int
    tiles: int


def map_area(folder: Path, area: int, clip: Clip, settings: Settings, logs: int) -> AreaMapped:
    """Integrate all scans of so many logs, in order, in the map of one area.

    Raises:
        LimitReached: it is more than the map may hold.
        BadInput: the files of the build cannot be written.
    """
    files, grid = ScanFiles(folder), OccupancyGrid(replace(settings.grid_settings(), clip=clip))
    accepted = files.arrays(ACCEPTED)
    for log in range(logs):
        index = files.index_of(log)
        taken = accepted[str(log)]
        here = taken & meets(index.extents, clip.rect)
        others = _Others(grid, taken & ~here, index.stamps)
        for number, placed in files.scans(log, index, here):
            others.pass_over(number)
            _integrate(grid, placed)
        others.pass_over(len(taken))
    tiles = list(grid.checkpoint().tiles_since(0))
    places = np.array([(tile.tx, tile.ty, tile.revision) for tile in tiles], np.int64).reshape(-1, 3)
    with written(folder, "--out"):
        files.write_large(f"area-{area}", places)
        for plane in grid.model.planes:
            cells = [np.empty(0, plane.dtype), *(tile.planes[plane.name] for tile in tiles)]
            side = 64 * plane.side
            files.write_large(f"area-{area}-{plane.name}", np.concatenate(cells).reshape(-1, side * side))
    return AreaMapped(grid.time, grid.cell_updates, len(tiles))


class _Others:
    """The scans of a log that are in the map, not in this area: a map that forgets has to know of them."""

    def __init__(self, grid: OccupancyGrid, which: NDArray[np.bool_], stamps: NDArray[np.int64]) -> None:
        forgets = grid.settings.tick is not None
        self._grid = grid
        self._left = deque(np.flatnonzero(which).tolist() if forgets else ())
        self._stamps = stamps

    def pass_over(self, end: int) -> None:
        """Count those before scan number `end`."""
        while self._left and self._left[0] < end:
            self._grid.pass_over(int(self._stamps[self._left.popleft()]))


def _integrate(grid: OccupancyGrid, placed: PlacedScan) -> None:
    try:
        grid.integrate(*placed)
    except ScanRefused as refusal:
        raise LimitReached(
            f"{refusal}; or leave --workers and --dask out: then what has no room is left out, and counted"
        ) from refusal


def meets(extents: NDArray[np.int64], rect: CellRect) -> NDArray[np.bool_]:
    """Which of these rectangles of cells, rows of ix, iy, width, height, share a cell with `rect`."""
    ix, iy, width, height = extents.T
    across = (ix < rect.ix + rect.width) & (rect.ix < ix + width)
    up = (iy < rect.iy + rect.height) & (rect.iy < iy + height)
    return np.asarray(across & up & (width > 0))


def judge_scans(
    folder: Path, first: int, end: int, lattice: Lattice, window: CellRect, settings: Settings, logs: int
) -> NDArray[np.int64]:
    """Hold scans `first` to `end`, of those that are in the map, against it; see `Consistency.take`."""
    files, grid_settings = ScanFiles(folder), settings.grid_settings()
    beliefs = Beliefs(lattice, window, files.large(SIDES))
    accepted, counts, before = files.arrays(ACCEPTED), np.zeros(4, np.int64), 0
    for log in range(logs):
        taken = accepted[str(log)]
        number = before + np.cumsum(taken) - 1
        before += int(np.count_nonzero(taken))
        wanted = taken & (first <= number) & (number < end)
        if wanted.any():
            for _, placed in files.scans(log, files.index_of(log), wanted):
                counts += beliefs.judged(placed, grid_settings)
    return counts
