"""A caller's own values as messages: lists and arrays of any numbers, checked as a mapper checks messages."""

import math
import numbers
import operator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ogm_core.errors import BadMessage
from ogm_core.types import Pose, Ranges, Scan
from ogm_core.wire.messages import scan_from_fields

MAX_TURNS = 2.0
"""Bearings that go round more often are no radians."""


def scan_of(
    ranges: ArrayLike,
    *,
    angle_min: float,
    angle_increment: float,
    range_min: float,
    range_max: float,
    stamp: int = 0,
    time_increment: float = 0.0,
    mount: ArrayLike | None = None,
    pose: ArrayLike | None = None,
    seq: int = 0,
    run: str = "",
) -> Scan:
    """A scan of one's own numbers: `ranges` is a list or an array of N metres, inf for no return.

        scan = scan_of([2.0, 2.1, math.inf], angle_min=-0.5, angle_increment=0.5, range_min=0.1, range_max=8)

    The other values are those of `Scan`; `mount` and `pose` are [x, y, theta], None if there is none.

    Raises:
        BadMessage: a value is of the wrong type or out of range, as a mapper would say of a received scan.
    """
    fields: dict[str, Any] = {
        "stamp": stamp_of(stamp),
        "seq": seq,
        "run": run,
        "angle_min": number_of(angle_min, "angle_min"),
        "angle_increment": number_of(angle_increment, "angle_increment"),
        "time_increment": number_of(time_increment, "time_increment"),
        "range_min": number_of(range_min, "range_min"),
        "range_max": number_of(range_max, "range_max"),
    }
    if mount is not None:
        fields["mount"] = list(pose_of(mount, "mount"))
    if pose is not None:
        fields["pose"] = list(pose_of(pose, "pose"))
    scan = scan_from_fields(fields, ranges_of(ranges))
    turns = (scan.ranges.size - 1) * abs(scan.angle_increment) / math.tau
    if turns > MAX_TURNS:
        raise BadMessage(
            f"angle_increment: the bearings go {turns:.3g} times round: give radians, not degrees"
        )
    return scan


def stamp_of(value: int) -> int:
    """A whole number, numpy's too; ns since the Unix epoch.

    Raises:
        BadMessage: it is something else.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise BadMessage(f"stamp: a whole number of ns is needed, got {type(value).__name__}")
    return operator.index(value)


def number_of(value: float, name: str) -> float:
    """A real number, numpy's too; a bool or a text is a mistake.

    Raises:
        BadMessage: it is something else, or too large for a float; the text names it `name`.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise BadMessage(f"{name}: a number is needed, got {type(value).__name__}")
    try:
        return float(value)
    except OverflowError as error:
        raise BadMessage(f"{name}: a finite number is needed, got one past every float") from error


def pose_of(values: ArrayLike, name: str) -> Pose:
    """Three numbers: x and y in metres, theta in radians.

    Raises:
        BadMessage: they are not; the text names them `name`.
    """
    try:
        parts: list[Any] = list(values)  # type: ignore[arg-type]  # a mistake may be no list at all
    except TypeError:
        raise BadMessage(f"{name}: [x, y, theta] is needed, got {type(values).__name__}") from None
    if len(parts) != 3:
        raise BadMessage(f"{name}: [x, y, theta] is needed, got {len(parts)} values")
    return Pose(*(number_of(part, f"{name}[{i}]") for i, part in enumerate(parts)))


def ranges_of(values: ArrayLike) -> Ranges:
    """Numbers of any kind as float32, shape (N,), read-only; a copy. What a mask hides is NaN.

    Raises:
        BadMessage: they are no numbers, or not in one row.
    """
    try:
        ranges = np.asarray(values)
    except ValueError as error:
        raise BadMessage(f"ranges: {error}") from error
    if ranges.ndim != 1 or ranges.dtype.kind not in "iuf":
        raise BadMessage(
            f"ranges: numbers, shape (N,), are needed (inf for no return), got {ranges.dtype} {ranges.shape}"
        )
    with np.errstate(over="ignore"):  # a reading past float32 is past every range_max, as inf is
        copy = ranges.astype(np.float32)
    if isinstance(values, np.ma.MaskedArray):
        copy[np.ma.getmaskarray(values)] = np.nan
    copy.flags.writeable = False
    return copy
