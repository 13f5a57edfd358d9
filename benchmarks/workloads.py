"""What is mapped when speed is measured: seeded simulations, and recorded buildings where there are any.

| workload | scans | beams | cells |
|---|---|---|---|
| lab | 220 | 360 over 360 degrees, up to 8 m | 0.1 m, preset `lab` |
| big | 1000 | 1081 over 270 degrees, up to 30 m | 0.05 m, a world of 200 x 200 m |
| intel, freiburg-079 | 910, 4791 | 180, 360 over 180 degrees, up to 80 m | 0.05 m |
"""

import functools
import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.log_odds import CellType, LogOdds
from ogm_core.cells.model import CellModel
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings, Outside, SensorModel, Traversal
from ogm_core.lattice import Region
from ogm_core.logs.recordings import RecordedScan, RecordingReader
from ogm_core.simulation.lidar import Lidar, measure
from ogm_core.simulation.trajectories import WaypointPath
from ogm_core.simulation.worlds import World, lab
from ogm_core.types import PlacedScan, Pose, Scan

DATASETS = "OGM_DATASETS"
"""Environment variable: the folder with recorded buildings."""
BIG_SCANS, BIG_BEAMS, BIG_RANGE_MAX, BIG_LAP = 1000, 1081, 30.0, 1163.0
CLEARANCE = 1.0
"""How far obstacles of the big world stay from the robot's path, m."""


@dataclass(frozen=True, eq=False)
class Workload:
    """Scans at their sensors' poses, and what every mapper must be told: m."""

    name: str
    scans: list[PlacedScan]
    resolution: float
    alpha: float
    bounds: Region | None = None
    outside: Outside = "clip"
    clear_range: float | None = None


def big_lap() -> list[Pose]:
    """1000 poses along a closed curve of 1163 m that crosses itself: some places are seen often."""
    fine = np.linspace(0.0, 2.0 * math.pi, 20_000)
    curve = np.stack((np.sin(2.0 * fine + math.pi / 4.0), np.sin(3.0 * fine)), axis=1)
    way = np.concatenate(([0.0], np.hypot(*np.diff(curve, axis=0).T).cumsum()))
    size = BIG_LAP / way[-1]
    at = np.interp(np.arange(BIG_SCANS) / BIG_SCANS * way[-1], way, fine)
    x, y = size * np.sin(2.0 * at + math.pi / 4.0), size * np.sin(3.0 * at)
    headings = np.arctan2(3.0 * np.cos(3.0 * at), 2.0 * np.cos(2.0 * at + math.pi / 4.0))
    return [Pose(*pose) for pose in np.stack((x, y, headings), axis=1).tolist()]


def big_world(lap: list[Pose], rng: np.random.Generator) -> World:
    """200 x 200 m with 600 circles and 120 walls that keep clear of a lap."""
    way = np.array(lap)[:, :2]

    def clear(points: NDArray[np.float64], distance: float) -> bool:
        return bool(np.hypot(*(way[:, None] - points).transpose(2, 0, 1)).min() > distance + CLEARANCE)

    circles: list[tuple[float, float, float]] = []
    while len(circles) < 600:
        x, y, radius = rng.uniform((-100.0, -100.0, 0.4), (100.0, 100.0, 2.8))
        if clear(np.array([[x, y]]), radius):
            circles.append((x, y, radius))
    walls: list[tuple[float, float, float, float]] = []
    while len(walls) < 120:
        x, y, bearing, half = rng.uniform((-100.0, -100.0, 0.0, 5.0), (100.0, 100.0, math.pi, 15.0))
        dx, dy = half * math.cos(bearing), half * math.sin(bearing)
        if clear(np.linspace((x - dx, y - dy), (x + dx, y + dy), 100), 0.0):
            walls.append((x - dx, y - dy, x + dx, y + dy))
    corners = tuple((x, y) for x, y, _ in lap)
    return World("big", np.array(circles), np.array(walls), WaypointPath(corners, BIG_LAP / BIG_SCANS))


def big(scans: int = BIG_SCANS, seed: int = 1) -> Workload:
    """The first `scans` scans of a lap through `big_world`."""
    rng = np.random.default_rng(seed)
    lap = big_lap()
    world = big_world(lap, rng)
    lidar = Lidar(beams=BIG_BEAMS, fov=math.radians(270.0), range_max=BIG_RANGE_MAX, noise=0.02)
    return Workload("big", simulated(world, lap[:scans], lidar, rng), resolution=0.05, alpha=0.1)


@functools.cache
def whole_big() -> Workload:
    """All of `big`, simulated once a process; nobody changes it."""
    return big()


def lab_exercise(seed: int = 1) -> Workload:
    """The textbook exercise: one lap of 220 scans inside bounds that drop what leaves them."""
    bounds = Region(-10.0, -10.0, 10.0, 10.0)
    world = lab()
    lap = [world.path.pose(k) for k in range(world.path.count)]
    scans = simulated(world, lap, Lidar.lab(), np.random.default_rng(seed))
    return Workload("lab", scans, resolution=0.1, alpha=0.2, bounds=bounds, outside="drop")


def recorded(name: str, file: str) -> Workload | None:
    """A recorded building of the folder that OGM_DATASETS names; None where there is none."""
    folder = os.environ.get(DATASETS)
    if not folder:
        return None
    with RecordingReader(Path(folder, name, file), range_max=80.0) as messages:
        scans = [
            PlacedScan(message.message, message.message.pose.compose(message.message.mount))
            for message in messages
            if isinstance(message, RecordedScan) and message.message.pose is not None
        ]
    return Workload(name, scans, resolution=0.05, alpha=0.1, clear_range=25.0)


WORKLOADS: dict[str, Callable[[], Workload | None]] = {
    "lab": lab_exercise,
    "big": big,
    "intel": lambda: recorded("intel", "intel-corrected.log.gz"),
    "freiburg-079": lambda: recorded("freiburg-079", "freiburg-079-corrected.log.gz"),
}


def simulated(world: World, lap: list[Pose], lidar: Lidar, rng: np.random.Generator) -> list[PlacedScan]:
    """One scan a pose, 20 a second; each carries its pose."""
    period = 50_000_000
    limits = lidar.angle_min, lidar.angle_increment, 0.0, lidar.range_max
    return [
        PlacedScan(Scan(k * period, *limits, measure(world, pose, lidar, rng), pose=pose, seq=k), pose)
        for k, pose in enumerate(lap)
    ]


def settings_of(
    work: Workload,
    *,
    cells: CellType = "int16",
    cell_model: CellModel | None = None,
    sensor_model: SensorModel = "beam",
    traversal: Traversal = "bresenham",
) -> GridSettings:
    """The settings of a map that takes the workload's scans."""
    return GridSettings(
        resolution=work.resolution,
        cell_model=cell_model or LogOdds(cells),
        sensor_model=sensor_model,
        traversal=traversal,
        alpha=work.alpha,
        clear_range=work.clear_range,
        bounds=work.bounds,
        outside=work.outside,
    )


def first_scans(work: Workload, count: int) -> Workload:
    """The workload without its later scans."""
    return replace(work, scans=work.scans[:count])


def mapped(work: Workload, cell_model: CellModel | None = None) -> OccupancyGrid:
    """A fresh map, with the workload's own settings, of its scans."""
    grid = OccupancyGrid(settings_of(work, cell_model=cell_model))
    for scan, pose, _ in work.scans:
        grid.integrate(scan, pose)
    return grid
