"""Hits of a placed scan at robots on their ways: beams that ended on what was there at the time."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.grid_settings import GridSettings
from ogm_core.placing.other_robots import MarkHits
from ogm_core.sensor_models.beams import BeamModel, Plain, end_point, reading
from ogm_core.sensor_models.projection import beam_model, read_only, sensor_poses
from ogm_core.types import PlacedScan

_ROUNDING = 1e-3
"""m; more than rounding can move a point."""


def hits_at_robots(settings: GridSettings) -> MarkHits:
    """What marks the hits, as a map of these settings reads a scan, that end at robots."""

    def mark(
        placed: PlacedScan,
        ways: NDArray[np.float64],
        times: NDArray[np.float64],
        marks: NDArray[np.bool_],
    ) -> None:
        model = tuple(beam_model(placed.scan, settings))
        _mark(read_only(placed.scan.ranges), model, sensor_poses(placed), ways, times, marks)

    return mark


@njit(cache=True, error_model="numpy")
def _mark(
    ranges: NDArray[np.float32],
    beam: Plain,
    sensor: NDArray[np.float64],
    ways: NDArray[np.float64],
    times: NDArray[np.float64],
    marks: NDArray[np.bool_],
) -> None:
    """Mark the hits that end within a robot's radius of where it is on its way at the beam's time.

    `sensor` as in `beams.project`; `beam` are the contents of a BeamModel; the others as `MarkHits` says.
    """
    model = BeamModel(*beam)
    near, count = _near(ways, sensor, model.range_max + _ROUNDING)
    if not count:
        return
    for k in range(ranges.size):
        _, hit, length = reading(float(ranges[k]), model)
        if not hit:
            continue
        s = k if len(sensor) > 1 else 0
        x, y = end_point(k, length, sensor[s, 0], sensor[s, 1], sensor[s, 2], model)
        found = -1.0
        for n in range(count):
            robot, radius, t0, t1, x0, y0, x1, y1 = near[n]
            if robot == found or not t0 <= times[k] <= t1:
                continue
            found = robot  # its later rows do not matter
            f = (times[k] - t0) / (t1 - t0) if t1 > t0 else 0.0
            dx, dy = x - (x0 + f * (x1 - x0)), y - (y0 + f * (y1 - y0))
            if dx * dx + dy * dy <= radius * radius:
                marks[k] = True
                break


@njit(cache=True, error_model="numpy")
def _near(
    ways: NDArray[np.float64], sensor: NDArray[np.float64], farthest: float
) -> tuple[NDArray[np.float64], int]:
    """The rows of those robots that a beam of up to `farthest` m may meet, and how many."""
    west, east = sensor[:, 0].min(), sensor[:, 0].max()
    south, north = sensor[:, 1].min(), sensor[:, 1].max()
    near = np.empty_like(ways)
    count = first = 0
    while first < len(ways):
        last = first
        xmin = ymin = math.inf
        xmax = ymax = -math.inf
        while last < len(ways) and ways[last, 0] == ways[first, 0]:
            xmin, xmax = min(xmin, ways[last, 4], ways[last, 6]), max(xmax, ways[last, 4], ways[last, 6])
            ymin, ymax = min(ymin, ways[last, 5], ways[last, 7]), max(ymax, ways[last, 5], ways[last, 7])
            last += 1
        dx, dy = max(xmin - east, west - xmax, 0.0), max(ymin - north, south - ymax, 0.0)
        if math.hypot(dx, dy) <= farthest + ways[first, 1]:
            near[count : count + last - first] = ways[first:last]
            count += last - first
        first = last
    return near, count
