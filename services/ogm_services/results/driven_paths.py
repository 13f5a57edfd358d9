"""Paths of robots: their positions at the scans that are in the map, as few of them as a picture needs."""

import math

import numpy as np
from numpy.typing import NDArray

from ogm_core.types import Pose, Scan

MOST = 10_000
"""A path with more points is thinned to half of them; even."""
JUMP = 5.0
"""Points farther apart are not joined, m: the robot was carried, or its log has a gap."""


class DrivenPath:
    """The way of one robot's base, from one integrated scan to the next."""

    def __init__(self) -> None:
        self._points: list[tuple[float, float, bool]] = []
        """x, y, and whether the robot drove there from the point before."""
        self._newest = (math.nan, math.nan)
        self._joined = True
        self._stride = 1
        self._since = 0
        """How many points were added since the last one that was kept."""

    def add(self, scan: Scan, sensor: Pose) -> None:
        """Go on to where a scan was taken, `sensor` being its sensor's pose in the map frame."""
        self.go_to(base_of(scan, sensor))

    def go_to(self, position: tuple[float, float]) -> None:
        """Go on to where the robot's base was when a scan was taken, m."""
        self._joined &= math.dist(self._newest, position) <= JUMP
        self._newest = position
        self._since += 1
        if self._since < self._stride:
            return
        self._points.append((*position, self._joined))
        self._joined, self._since = True, 0
        if len(self._points) > MOST:
            self._thin()

    def line(self) -> NDArray[np.float64]:
        """Its points in order, x and y in m, shape (n, 2), with a row of NaN wherever it is broken."""
        points = [*self._points, (*self._newest, self._joined)] if self._since else self._points
        rows = [points[0][:2]] if points else []
        for x, y, joined in points[1:]:
            if not joined:
                rows.append((math.nan, math.nan))
            rows.append((x, y))
        return np.array(rows).reshape(-1, 2)

    def _thin(self) -> None:
        """Keep the first point and every second one after it; joined are those with no break between them."""
        first, *others = self._points
        pairs = zip(others[::2], others[1::2], strict=True)
        self._points = [first, *((x, y, passed[2] and joined) for passed, (x, y, joined) in pairs)]
        self._stride *= 2


def base_of(scan: Scan, sensor: Pose) -> tuple[float, float]:
    """Position of the robot's base, whose mount leads to the sensor's pose, m."""
    theta = sensor.theta - scan.mount.theta
    c, s = math.cos(theta), math.sin(theta)
    return (
        sensor.x - c * scan.mount.x + s * scan.mount.y,
        sensor.y - s * scan.mount.x - c * scan.mount.y,
    )
