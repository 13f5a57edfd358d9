"""Newest scans: the last one of every sensor that is in the map, thinned to what a viewer draws."""

from collections import OrderedDict
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ogm_core.types import Pose, Ranges, Scan

MAX_SOURCES = 256
"""So many sensors' scans are kept; of more, those that were heard last."""
MAX_SHOWN_BEAMS = 360
"""So many beams of a scan are kept; of more, every second, third or so."""


class ShownScan(NamedTuple):
    """A scan for a viewer; beam k looks along `angle_min + k * angle_increment` from the sensor's `pose`."""

    epoch: str
    """The map that it is in."""
    stamp: int
    pose: Pose
    angle_min: float
    angle_increment: float
    range_max: float
    ranges: Ranges


class NewestScans:
    """Those of a live map. One thread notes them, any thread reads.

    They are thinned at once, so that what is kept is little, however long scans are and whoever looks.
    """

    def __init__(self, epoch: Callable[[], str]) -> None:
        """`epoch`: that of the map which a scan has just been put into."""
        self._epoch = epoch
        self._scans: OrderedDict[tuple[str, str], ShownScan] = OrderedDict()
        self.noted = 0
        """How many scans there have been."""

    def note(self, robot: str, sensor: str, scan: Scan, pose: Pose) -> None:
        """Keep a scan in place of its sensor's last one."""
        step = -(-scan.ranges.size // MAX_SHOWN_BEAMS)
        ranges = np.array(scan.ranges[::step], "<f4")  # a copy, so that the whole is not kept
        turn = scan.angle_increment * step
        shown = ShownScan(self._epoch(), scan.stamp, pose, scan.angle_min, turn, scan.range_max, ranges)
        self._scans[robot, sensor] = shown
        self._scans.move_to_end((robot, sensor))
        if len(self._scans) > MAX_SOURCES:
            self._scans.popitem(last=False)
        self.noted += 1

    def of(self, epoch: str) -> dict[tuple[str, str], ShownScan]:
        """Those that are in a map of this epoch, by robot and sensor."""
        return {source: scan for source, scan in self._scans.copy().items() if scan.epoch == epoch}
