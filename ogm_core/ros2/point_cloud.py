"""Point clouds flattened to scans: of the points at a robot's height, the nearest in each direction."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import BadMessage, BadSetting, cut, printable
from ogm_core.ros2.cdr import PointCloud2
from ogm_core.ros2.transform import Transform
from ogm_core.types import Scan
from ogm_core.wire.messages import MAX_RANGE, scan_from_fields

DEFAULT_BINS = 720
MAX_BINS = 36_000
_BLOCK = 8192
_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Of sensor_msgs/PointField."""


@dataclass(frozen=True, slots=True)
class Flattening:
    """Which points of a cloud count, and what is made of them.

    Those between `z_min` and `z_max` in the base frame, m, and `range_min` to `range_max` from the sensor,
    along the floor, m. There are `bins` beams all round. A beam without a point says nothing, since what it
    met may lie outside of the band, as the floor does; with `clear` it says that nothing is there.
    """

    z_min: float
    z_max: float
    bins: int = DEFAULT_BINS
    range_min: float = 0.3
    range_max: float = 100.0
    clear: bool = False

    def __post_init__(self) -> None:
        if not (math.isfinite(self.z_min) and math.isfinite(self.z_max) and self.z_min < self.z_max):
            raise BadSetting(f"z band: finite z_min < z_max is needed, got {self.z_min:g} and {self.z_max:g}")
        if not 1 <= self.bins <= MAX_BINS:
            raise BadSetting(f"bins: 1 to {MAX_BINS} are needed, got {self.bins}")
        if not 0.0 <= self.range_min < self.range_max <= MAX_RANGE:
            raise BadSetting(
                f"ranges of clouds: 0 <= range_min < range_max <= {MAX_RANGE:g} m is needed, got "
                f"{self.range_min:g} and {self.range_max:g}"
            )


def flattened_scan(
    cloud: PointCloud2,
    mount: Transform,
    rules: Flattening,
    *,
    delay: float = 0.0,
    seq: int = 0,
    run: str = "",
) -> Scan:
    """A cloud as a scan for the mapper; `mount` is the sensor in the base frame, tilted as it may be.

    The scan's sensor is where the cloud's is, and looks ahead; beam k gets the nearest point whose bearing
    is within half an increment of its own. `delay`, s, is added to the stamp.

    Raises:
        BadMessage: the cloud has no x, y, z, its layout does not fit its data, or its stamp is out of range.
    """
    found = np.full(rules.bins + 1, np.inf, np.float32)
    coordinates = _coordinates(cloud)
    for block in _blocks(coordinates[0].shape):
        _mark_nearest(found, [_flat(each[block]) for each in coordinates], mount, rules)
    nearest = found[:-1]
    nearest[0] = min(nearest[0], found[-1])
    if not rules.clear:
        nearest[np.isinf(nearest)] = np.nan
    nearest.flags.writeable = False
    fields = {
        "stamp": cloud.stamp + round(delay * 1e9),
        "seq": seq,
        "run": run,
        "angle_min": -math.pi,
        "angle_increment": math.tau / rules.bins,
        "range_min": float(rules.range_min),
        "range_max": float(rules.range_max),
        "mount": [mount.x, mount.y, 0.0],
    }
    return scan_from_fields(fields, nearest)


def _mark_nearest(
    found: NDArray[np.float32], points: list[NDArray[np.float32]], mount: Transform, rules: Flattening
) -> None:
    """Lower `found`, the nearest range of each bin, by points in the sensor's frame: x, y and z."""
    (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = (map(np.float32, row) for row in _rotation(mount))
    lowest, highest = np.float32(rules.z_min - mount.z), np.float32(rules.z_max - mount.z)
    nearest, farthest = np.float32(rules.range_min), np.float32(rules.range_max)
    x, y, z = points
    # Points may be NaN or inf, which are within nothing.
    with np.errstate(invalid="ignore", over="ignore"):
        height = r20 * x + r21 * y + r22 * z
        within = np.flatnonzero((height >= lowest) & (height <= highest))
        x, y, z = x.take(within), y.take(within), z.take(within)
        ahead, left = r00 * x + r01 * y + r02 * z, r10 * x + r11 * y + r12 * z
        ranges = np.sqrt(ahead * ahead + left * left)
        counted = np.flatnonzero((ranges >= nearest) & (ranges <= farthest) & (ranges > 0.0))
    bins = _bins(ahead.take(counted), left.take(counted), rules.bins)
    np.minimum.at(found, bins, ranges.take(counted))


def _bins(x: NDArray[np.float32], y: NDArray[np.float32], count: int) -> NDArray[np.intp]:
    """The bin of each direction, of which bin k lies around the bearing -pi + k * tau / count.

    Bin `count`, which ends at pi, is bin 0. A number that grows with the bearing tells the bin as well as an
    arctangent does, which would take most of the time.
    """
    edges, first = _edges(count)
    turn = _turn(x, y)
    bins: NDArray[np.intp] = first.take(((turn + np.float32(2.0)) * np.float32(count / 2.0)).astype(np.intp))
    bins += (turn >= edges.take(bins)).astype(np.intp)
    return bins


def _turn(x: NDArray[Any], y: NDArray[Any]) -> NDArray[Any]:
    """-2 to 2 for bearings from -pi to pi, growing with them by 0.5 to 1 a radian."""
    turn: NDArray[Any] = np.copysign(1.0 - x / (np.abs(x) + np.abs(y)), y)
    return turn


@lru_cache(maxsize=4)
def _edges(count: int) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """The upper edges of all bins as turns, and for equal steps of a turn the bin that a step begins in.

    A step is shorter than any bin, so that at most one edge lies within it.
    """
    bearings = (np.arange(count) + 0.5) * math.tau / count - math.pi
    edges = _turn(np.cos(bearings), np.sin(bearings)).astype(np.float32)
    steps = np.arange(2 * count + 1, dtype=np.float32) * np.float32(2.0 / count) - np.float32(2.0)
    return np.append(edges, np.float32(np.inf)), np.searchsorted(edges, steps, side="right")


def _rotation(mount: Transform) -> tuple[tuple[float, ...], ...]:
    """The rotation's matrix, by rows."""
    _, _, _, a, b, c, w = mount
    return (
        (1 - 2 * (b * b + c * c), 2 * (a * b - w * c), 2 * (a * c + w * b)),
        (2 * (a * b + w * c), 1 - 2 * (a * a + c * c), 2 * (b * c - w * a)),
        (2 * (a * c - w * b), 2 * (b * c + w * a), 1 - 2 * (a * a + b * b)),
    )


def _coordinates(cloud: PointCloud2) -> list[NDArray[Any]]:
    """x, y and z of all points in the sensor's frame, m, shape (height, width) each: views of the data."""
    height, width, step = cloud.height, cloud.width, cloud.point_step
    if height * width == 0:
        return [np.empty((0, 0), np.float32)] * 3
    row_step = cloud.row_step if height > 1 else width * step  # of a single row it is often left out
    if step < 1 or row_step < width * step or (height - 1) * row_step + width * step > cloud.data.size:
        raise BadMessage(
            f"cloud: {height} rows of {width} points with point_step {step} and row_step {cloud.row_step} "
            f"do not fit {cloud.data.size} bytes of data"
        )
    layouts = [_layout(cloud, name) for name in "xyz"]
    strides = (row_step, step)
    return [np.ndarray((height, width), dtype, cloud.data, offset, strides) for dtype, offset in layouts]


def _layout(cloud: PointCloud2, name: str) -> tuple[np.dtype[Any], int]:
    """The type of a field, and where it begins in a point."""
    field = next((each for each in cloud.fields if each.name == name), None)
    if field is None:
        names = ", ".join(each.name for each in cloud.fields) or "none"
        raise BadMessage(f"cloud: it has no field {name}; its fields: {cut(printable(names))}")
    if field.datatype not in _DTYPES:
        raise BadMessage(f"cloud: field {name} has the unknown datatype {field.datatype}")
    dtype = np.dtype((">" if cloud.big_endian else "<") + _DTYPES[field.datatype])
    if field.offset + dtype.itemsize > cloud.point_step:
        raise BadMessage(f"cloud: field {name} ends past its point, whose point_step is {cloud.point_step}")
    return dtype, field.offset


def _blocks(shape: tuple[int, ...]) -> Iterator[tuple[slice, slice]]:
    """Rectangles of points, few enough to stay in the processor's cache: twice as fast as all at once."""
    height, width = shape
    rows = max(1, _BLOCK // max(1, width))
    for top in range(0, height, rows):
        for left in range(0, width, _BLOCK):
            yield slice(top, top + rows), slice(left, left + _BLOCK)


def _flat(values: NDArray[Any]) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):  # of float64: past every range, as inf is
        return values.astype(np.float32).reshape(-1)
