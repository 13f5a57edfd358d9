"""Poses, scans and sweeps: the values that travel through the mapper."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Ranges = NDArray[np.float32]
_BESIDES_RANGES = 1024
"""What a scan takes in memory besides its ranges, about, bytes."""


class Pose(NamedTuple):
    """Position in metres and heading in radians, counter-clockwise, of a frame in another one."""

    x: float
    y: float
    theta: float

    def compose(self, child: "Pose") -> "Pose":
        """Pose of `child`, given in this frame, in the frame that this pose is given in.

        A zero child gives this pose bit for bit. Theta is not normalised.
        """
        if child == IDENTITY:
            return self
        c, s = math.cos(self.theta), math.sin(self.theta)
        return Pose(
            self.x + c * child.x - s * child.y,
            self.y + s * child.x + c * child.y,
            self.theta + child.theta,
        )


IDENTITY = Pose(0.0, 0.0, 0.0)


def shorter_arc(start: float, end: float) -> float:
    """The shorter turn from one heading to another, both finite, rad."""
    turn = end - start
    if not math.isfinite(turn):
        # Two finite headings may differ by more than float64 holds; whole turns do not count.
        turn = math.remainder(end, math.tau) - math.remainder(start, math.tau)
    return math.remainder(turn, math.tau)


@dataclass(frozen=True, slots=True)
class PoseStamped:
    """Pose of a robot's base in the map frame at a time.

    `stamp` in ns since the Unix epoch; `seq` counts the messages of this key and `run`; `run` names the
    publisher's run ("" if it names none).
    """

    stamp: int
    pose: Pose
    seq: int = 0
    run: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One sweep of a 2D LiDAR; beam k looks along `angle_min + k * angle_increment` in the sensor frame.

    `stamp` is the time of the first beam, ns since the Unix epoch; `time_increment` the seconds between
    beams. Angles in radians, ranges in metres: float32, shape (N,), N >= 1, read-only. `mount` is the
    sensor's pose in the base frame, `pose` the base's pose in the map frame at `stamp`, if the scan
    carries one. `clear_range` and `reach` (m) take the place of the map's, where they are not None; they are
    no part of a message.
    """

    stamp: int
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    ranges: Ranges
    time_increment: float = 0.0
    mount: Pose = IDENTITY
    pose: Pose | None = None
    seq: int = 0
    run: str = ""
    clear_range: float | None = None
    reach: float | None = None

    @property
    def nbytes(self) -> int:
        """What it takes in memory, about: its ranges, and all else."""
        return self.ranges.nbytes + _BESIDES_RANGES

    @property
    def end_stamp(self) -> int:
        """Time of the last beam, ns since the Unix epoch."""
        if self.time_increment == 0.0:
            return self.stamp
        return self.stamp + round((self.ranges.size - 1) * self.time_increment * 1e9)

    @property
    def beam_times(self) -> NDArray[np.float64]:
        """How long after the stamp each beam was taken, whole ns, shape (N,)."""
        numbers = np.arange(self.ranges.size, dtype=np.float64)
        times: NDArray[np.float64] = np.rint(numbers * self.time_increment * 1e9)
        return times


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Where the sensor was while a scan swept: its pose in the map frame at mid sweep, and at every beam.

    `beams` is float64, shape (N, 3): x and y in m, theta in rad.
    """

    middle: Pose
    beams: NDArray[np.float64]


class PlacedScan(NamedTuple):
    """A scan, its sensor's pose in the map frame at its stamp, and the sweep where the motion is known."""

    scan: Scan
    pose: Pose
    sweep: Sweep | None = None
