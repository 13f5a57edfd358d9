"""One message of a recorded log, whatever the log's format."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ogm_core.types import PoseStamped, Ranges, Scan


@dataclass(frozen=True, slots=True)
class RecordedPose:
    """A pose message and whose it is."""

    robot: str
    message: PoseStamped


@dataclass(frozen=True, slots=True, eq=False)
class RecordedScan:
    """A scan message and whose it is."""

    robot: str
    sensor: str
    message: Scan


Recorded = RecordedPose | RecordedScan


class ReadDecimals(Protocol):
    """`decimals.read_decimals`, for those who read a CARMEN log so fast that loading numba pays."""

    def __call__(self, text: bytes, count: int) -> tuple[Ranges, int] | None:
        """Read the `count` plain decimals that a text begins with, or None; and say where the last ends."""
        ...


def text_ranges(values: Sequence[float]) -> Ranges:
    """Ranges that were written as decimal numbers, m: float32, shape (N,), read-only.

    What is beyond float32 reads as infinite.

    Raises:
        OverflowError: a whole number is beyond float64.
    """
    with np.errstate(over="ignore"):
        ranges = np.array(values, dtype=np.float64).astype(np.float32)
    ranges.flags.writeable = False
    return ranges


def no_returns(ranges: Ranges, range_max: float) -> Ranges:
    """Ranges in which every one at or above `range_max`, m, is infinite: "no return".

    It is compared as the float32 that ranges are, so that 80.99 is at 80.99. Read-only, the same array if
    there is none.
    """
    beyond = ranges >= np.float32(range_max)
    if not beyond.any():
        return ranges
    changed = np.where(beyond, np.float32(np.inf), ranges)
    changed.flags.writeable = False
    return changed
