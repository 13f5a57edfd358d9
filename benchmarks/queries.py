"""How long questions about the map take: rays, in the mapper and in the client, checks, and distances.

CPU time of one thread in this process, the least of several rounds, from several places of the lap. What a
mapper's answer takes is all of it, from texts to JSON; the map has just changed and is laid out anew. The map
is `big`.
"""

import json
import math
import time
from collections.abc import Callable, Sequence

import numpy as np

from benchmarks.table import Result
from benchmarks.workloads import mapped, whole_big
from ogm_client import MapGrid
from ogm_core.grid import OccupancyGrid
from ogm_core.placing.receipts import Receipts
from ogm_core.types import Pose
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.live.monitor import Monitor
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.raycasts import Fan, FanCells

RAYS, RANGE = 1081, 30.0
FIRST, STEP = -0.75 * math.pi, 1.5 * math.pi / (RAYS - 1)
ROUNDS, QUICK_ROUNDS = 15, 3
FOOTPRINTS = 500
PLACES = 8
KERNEL_TARGET, CLIENT_TARGET = 5.0, 60.0
"""What is asked for of a scan's rays, ms."""


def run(quick: bool) -> list[Result]:
    """Measure on workload `big`; `quick`: in fewer rounds."""
    work, rounds = whole_big(), QUICK_ROUNDS if quick else ROUNDS
    grid = mapped(work)
    poses = [placed.pose for placed in work.scans[:: max(1, len(work.scans) // PLACES)]]
    return [*rays(grid, poses, rounds), *others(grid, poses, rounds)]


def rays(grid: OccupancyGrid, poses: Sequence[Pose], rounds: int) -> list[Result]:
    """Results of a scan's rays: in the kernel, in a mapper's answer, and in the client."""
    live, snapshot = LiveMap(grid), grid.snapshot()
    answers, copy = Answers("big", live, Receipts(), Monitor(live)), MapGrid.from_snapshot(grid.snapshot())
    kernel, whole, client = [], [], []
    for pose in poses:
        fan = Fan.read(asked(pose))
        part = FanCells.of(fan, snapshot)
        kernel.append(least(lambda: fan.cast(part), rounds))  # noqa: B023 - called here
        whole.append(least(lambda: answers.queries.raycast(asked(pose)), rounds))  # noqa: B023
        thetas = np.array(fan.bearings)
        client.append(least(lambda: copy.raycast(pose.x, pose.y, thetas, RANGE), max(1, rounds // 5)))  # noqa: B023
    group = f"{RAYS} rays of {RANGE:g} m through `big`: CPU time"
    return [
        Result(group, "the cells around and the kernel", float(np.mean(kernel)), "ms"),
        Result(group, "a mapper's answer, with its JSON", float(np.mean(whole)), "ms"),
        Result(group, "the slowest of them", max(whole), "ms", KERNEL_TARGET, at_least=False),
        Result(
            group, "MapGrid.raycast, of NumPy", float(np.mean(client)), "ms", CLIENT_TARGET, at_least=False
        ),
    ]


def others(grid: OccupancyGrid, poses: Sequence[Pose], rounds: int) -> list[Result]:
    """Results of checks of footprints along the way, and of distances of a part and of the whole map."""
    live = LiveMap(grid)
    queries = Answers("big", live, Receipts(), Monitor(live)).queries
    box = np.array([(-0.3, -0.2), (0.3, -0.2), (0.3, 0.2), (-0.3, 0.2)])
    at = np.random.default_rng(1).uniform(-10.0, 10.0, (FOOTPRINTS, 2)) + np.array(poses[0][:2])
    body = json.dumps({"footprints": (at[:, None] + box).round(3).tolist(), "margin": 0.1}).encode()
    x, y = poses[0].x, poses[0].y
    part = {"region": f"{x - 10},{y - 10},{x + 10},{y + 10}", "max_distance": "2"}
    cells = live.cells_in(None)

    def layer(given: dict[str, str]) -> bytes:
        queries._cache.let_go()
        return queries.distance("npz", given).body

    group = "checks and distances on `big`: CPU time"
    return [
        Result(
            group, f"a check of {FOOTPRINTS} footprints", least(lambda: queries.check({}, body), rounds), "ms"
        ),
        Result(group, "distances up to 2 m in 20 x 20 m", least(lambda: layer(part), rounds), "ms"),
        Result(
            group,
            f"distances of all {cells:,} cells, a cell",
            1e6 * least(lambda: layer({}), 1) / cells,
            "ns",
        ),
    ]


def asked(pose: Pose) -> dict[str, str]:
    """The parameters of a scan's rays from a pose."""
    numbers = {"x": pose.x, "y": pose.y, "theta": pose.theta, "angle_min": FIRST, "angle_increment": STEP}
    return {**{name: repr(value) for name, value in numbers.items()}, "n": str(RAYS), "range_max": str(RANGE)}


def least(work: Callable[[], object], rounds: int) -> float:
    """The least CPU time, ms, of doing it; the first time does not count."""
    work()
    times = []
    for _ in range(rounds):
        begin = time.thread_time()
        work()
        times.append(time.thread_time() - begin)
    return 1e3 * min(times)
