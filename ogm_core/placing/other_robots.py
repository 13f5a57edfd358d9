"""Other robots in a scan: its beams that end at one of them say nothing about the map, and are skipped.

Where another robot was when a beam was taken, its pose history says as it is when the scan is integrated.
So what is skipped depends on the order in which messages of several robots come.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.placing.hints import Hint
from ogm_core.placing.pose_history import PoseHistory
from ogm_core.placing.robot import Robot
from ogm_core.placing.robot_rules import RobotRules
from ogm_core.types import PlacedScan, Scan

APART_NS = 1_000_000_000
"""If the newest stamps of two are farther apart, their clocks differ, or one of them is silent."""
APART_IN_A_ROW = 10
"""So often the other one must have gone on meanwhile: one that is silent needs no clock set."""
_MAX_PAIRS = 4096
"""Pairs that are far apart and remembered; one that is forgotten is looked at anew."""
_ROUNDING = 1e-3
"""m; more than rounding can move a point."""

MarkHits = Callable[[PlacedScan, NDArray[np.float64], NDArray[np.bool_]], None]
"""Marks the hits of a placed scan, in a bool for each of its N beams, that end within a radius of a place.

The places are x, y and radius, m: shape (1, P, 3), or (N, P, 3) with those of each beam; NaN is none.
"""


class WithoutRobots(NamedTuple):
    """A scan without the beams that ended at other robots, how many these were, and what there is to tell."""

    scan: Scan
    skipped: int = 0
    hints: tuple[Hint, ...] = ()


class OtherRobots:
    """Skips beams that end at other robots than the scan's own. One thread calls it."""

    def __init__(
        self,
        rules: RobotRules,
        mark_hits: MarkHits,
        replaced: Callable[[Scan, Scan], object] = lambda *_: None,
    ) -> None:
        """`replaced` is told of each scan that loses beams, and of the one without them in its place."""
        self.rules = rules
        self._mark_hits = mark_hits
        self._replaced = replaced
        self._apart: dict[tuple[str, str], tuple[int, int]] = {}
        """Of pairs far apart: the other's newest stamp when last looked at, and how often it rose."""

    def without(
        self, name: str, robot: Robot, robots: Iterable[tuple[str, Robot]], placed: PlacedScan
    ) -> WithoutRobots:
        """A scan of a robot, without the beams that ended at another one of `robots`."""
        scan = placed.scan
        own = robot.poses.newest if scan.pose is None else scan.stamp
        there: list[tuple[PoseHistory, float]] = []
        hints: tuple[Hint, ...] = ()
        for other, known in robots:
            radius, newest = self.rules.radius_of(other), known.poses.newest
            if radius is None or newest is None or other == name:
                continue
            if own is None or abs(newest - own) <= APART_NS:
                there.append((known.poses.history, radius))
            elif self._goes_on(name, other, newest):
                hints += (Hint("robot_clock", _CLOCK.format(abs(newest - own) / 1e9, other)),)
        places = _places(placed, there) if there else []
        if not places:
            return WithoutRobots(scan, 0, hints)
        marked = np.zeros(scan.ranges.size, np.bool_)
        for each in places:
            self._mark_hits(placed, each, marked)
        skipped = int(np.count_nonzero(marked))
        if skipped:
            scan = _without(scan, marked)
            self._replaced(placed.scan, scan)
        return WithoutRobots(scan, skipped, hints)

    def _goes_on(self, name: str, other: str, newest: int) -> bool:
        """Whether another robot, whose stamps are far away, has gone on for a while: once for each pair."""
        if len(self._apart) >= _MAX_PAIRS:
            self._apart.clear()
        before, times = self._apart.get((name, other), (newest, 0))
        if newest != before:
            times += 1
        self._apart[name, other] = newest, times
        return newest != before and times == APART_IN_A_ROW


def _places(placed: PlacedScan, there: list[tuple[PoseHistory, float]]) -> list[NDArray[np.float64]]:
    """Places of those robots that a beam may end at, for `MarkHits`.

    Where the map takes the beams one after the other, each has its own time; else all have the scan's stamp.
    """
    if placed.sweep is not None:
        return _places_of_each(placed, placed.sweep.beams, there)
    scan, (x, y, _) = placed.scan, placed.pose
    farthest = scan.range_max + _ROUNDING
    near = []
    for history, radius in there:
        pose = history.about(scan.stamp)
        if pose is not None and math.hypot(pose.x - x, pose.y - y) <= farthest + radius:
            near.append((pose.x, pose.y, radius))
    return [np.array([near])] if near else []


def _places_of_each(
    placed: PlacedScan, beams: NDArray[np.float64], there: list[tuple[PoseHistory, float]]
) -> list[NDArray[np.float64]]:
    """Places of the robots that a beam of a sweep may end at, at each beam's time."""
    scan = placed.scan
    first, last = sorted((scan.stamp, scan.end_stamp))
    xmin, ymin = beams[:, :2].min(axis=0).tolist()
    xmax, ymax = beams[:, :2].max(axis=0).tolist()
    after = scan.beam_times
    near = []
    for history, radius in there:
        box = history.box_about(first, last)
        if box is None:
            continue
        dx, dy = max(box[0] - xmax, xmin - box[2], 0.0), max(box[1] - ymax, ymin - box[3], 0.0)
        if math.hypot(dx, dy) <= scan.range_max + _ROUNDING + radius:
            places = np.full((scan.ranges.size, 1, 3), radius)
            places[:, 0, :2] = history.about_each(scan.stamp, after)
            near.append(places)
    return near


def _without(scan: Scan, marked: NDArray[np.bool_]) -> Scan:
    """A scan whose marked beams are no reading."""
    ranges = scan.ranges.copy()
    ranges[marked] = np.nan
    ranges.flags.writeable = False
    return replace(scan, ranges=ranges)


_CLOCK = (
    "its newest stamp and that of {1} are {0:.3g} s apart, so it takes {1} for a wall: set their clocks, "
    "unless messages of one of the two come late"
)
