"""Drives of the soak: what a robot publishes, by its number and that of its scan, and the map of it all.

Every robot drives in a place of its own. Of what is `near` no other sees anything, so that the map does not
depend on whose scans came first; what is `far` several see.
"""

import functools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ogm_core.files.map_files import NpzMap, encode_npz, read_npz
from ogm_core.grid import OccupancyGrid
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.types import Pose, PoseStamped, Scan
from ogm_services.settings.settings import Settings
from tests.soak.encoded import Encoded

T0 = 1_700_000_000_000_000_000
SENSOR = "laser"
_APART = 10.0
"""From one robot's place to the next, m: two of them see nothing in common that is near."""
_SHAKES = np.random.default_rng(14).uniform(-0.1, 0.1, (59, 3)).tolist()


@dataclass(frozen=True)
class Sight:
    """What robots see: so many beams all around, that reach so far, and walls at up to `farthest`, m."""

    beams: int
    reach: float
    farthest: float

    @property
    def sweep(self) -> dict[str, float]:
        """What every scan says of its beams."""
        step = math.tau / self.beams
        return {"angle_min": -math.pi, "angle_increment": step, "range_min": 0.1, "range_max": self.reach}

    @cached_property
    def ranges(self) -> np.ndarray:
        """Of 61 scans, m, float32, shape (61, beams); what lies beyond the reach is no return."""
        drawn = np.random.default_rng(13).uniform(0.5, self.farthest, (61, self.beams))
        return np.minimum(drawn, self.reach).astype(np.float32)


SIGHTS = {"near": Sight(90, 4.0, 3.0), "far": Sight(180, 10.0, 11.0)}


def pose_stamp(number: int, rate: float) -> int:
    """When a pose was taken, ns; that of number 0 comes before the first scan, which is number 1."""
    return T0 + round(number * 1e9 / rate)


def pose(robot: int, number: int) -> Pose:
    """Where a robot is then: it shakes, so that each pose matters."""
    x, y = _APART * (robot % 10), _APART * (robot // 10)
    turn, (shake_x, shake_y, shake_turn) = 0.02 * number, _SHAKES[(5 * robot + number) % len(_SHAKES)]
    return Pose(
        x + 0.8 * math.sin(0.6 * turn) + shake_x,
        y + 0.8 * math.cos(0.8 * turn + robot) + shake_y,
        turn + shake_turn,
    )


def scan_stamp(number: int, rate: float) -> int:
    """When a scan was taken, ns: before the pose of its number, so that both poses beside it matter."""
    return T0 + round((number - 0.3) * 1e9 / rate)


def scan(robot: int, number: int, run: str, rate: float, sight: str = "near") -> Scan:
    """What it measures then: walls are hit now here, now there, so that the order matters, too."""
    seen = SIGHTS[sight]
    ranges = seen.ranges[_row(robot, number)]
    return Scan(scan_stamp(number, rate), ranges=ranges, **seen.sweep, seq=number - 1, run=run)


def encoded_scan(robot: int, number: int, run: str, rate: float, sight: str) -> bytes:
    """The same as its message."""
    return _encoded(_row(robot, number), run, sight).message(scan_stamp(number, rate), number - 1)


@functools.cache
def _encoded(row: int, run: str, sight: str) -> Encoded:
    return Encoded.of(Scan(0, ranges=SIGHTS[sight].ranges[row], **SIGHTS[sight].sweep, run=run))


def _row(robot: int, number: int) -> int:
    return (7 * robot + number) % 61


def messages(
    robot: int, count: int, run: str, rate: float, sight: str = "near"
) -> Iterator[PoseStamped | Scan]:
    """What it publishes: so many scans, each before the pose that it waits for."""
    yield PoseStamped(pose_stamp(0, rate), pose(robot, 0), 0, run)
    for number in range(1, count + 1):
        yield scan(robot, number, run, rate, sight)
        yield PoseStamped(pose_stamp(number, rate), pose(robot, number), number, run)


def mapped(drives: Iterable[tuple[int, Iterable[PoseStamped | Scan]]], flags: dict[str, object]) -> NpzMap:
    """The map of messages, by robot, in this order."""
    return read_npz(encode_npz(mapped_grid(drives, flags).snapshot()))


def mapped_grid(
    drives: Iterable[tuple[int, Iterable[PoseStamped | Scan]]], flags: dict[str, object]
) -> OccupancyGrid:
    """The same, not yet encoded."""
    settings = Settings.model_validate({"map": flags})
    grid = OccupancyGrid(settings.grid_settings(), "again")
    placer = ScanPlacer(grid, Receipts(), lambda *_: None, settings.placing_rules())
    for robot, published in drives:
        for message in published:
            if isinstance(message, Scan):
                placer.add_scan(f"robot{robot}", SENSOR, message)
            else:
                placer.add_pose(f"robot{robot}", message)
    return grid


def uninterrupted(sent: dict[int, list[int]], rate: float, flags: dict[str, object]) -> NpzMap:
    """The map of so many scans of each robot, run by run, as it is if nothing ever goes wrong."""
    return read_npz(encode_npz(uninterrupted_grid(sent, rate, flags).snapshot()))


def uninterrupted_grid(
    sent: dict[int, list[int]], rate: float, flags: dict[str, object], sight: str = "near"
) -> OccupancyGrid:
    """The same, not yet encoded."""
    runs = ((robot, run, count) for robot, counts in sent.items() for run, count in enumerate(counts))
    drives = ((robot, messages(robot, count, f"run{run}", rate, sight)) for robot, run, count in runs)
    return mapped_grid(drives, flags)
