"""Other robots in a scan: its beams that end at one of them say nothing about the map, and are skipped.

Where another robot was when a beam was taken, its pose history says as it is when the scan is integrated.
So what is skipped depends on the order in which messages of several robots come.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.placing.hints import Hint
from ogm_core.placing.pose_history import PoseHistory
from ogm_core.placing.robot import Robot
from ogm_core.placing.robot_rules import RobotRules
from ogm_core.placing.whereabouts import Whereabouts
from ogm_core.types import PlacedScan, Scan

APART_NS = 1_000_000_000
"""If the newest stamps of two are farther apart, their clocks differ, or one of them is silent."""
APART_IN_A_ROW = 10
"""So often the other one must have gone on meanwhile: one that is silent needs no clock set."""
_MAX_PAIRS = 4096
"""Pairs that are far apart and remembered; one that is forgotten is looked at anew."""
_ROUNDING = 1e-3
"""m; more than rounding can move a point."""

MarkHits = Callable[[PlacedScan, NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]], None]
"""Marks the hits of a placed scan that end at robots: (placed, ways, times, marks); a mark for each beam.

Each row of `ways`, shape (R, 8), is a piece of a robot's way: the robot's number, its radius (m), and what
`Piece` has. Each beam has one of the `times`, when a robot is where the first of its rows says that holds it.
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
        self._whereabouts = Whereabouts(rules)
        self._apart: dict[tuple[str, str], tuple[int, int]] = {}
        """Of pairs far apart: the other's newest stamp when last looked at, and how often it rose."""

    def moved(self, robot: str) -> None:
        """Note that what is known of a robot's poses has changed."""
        self._whereabouts.moved(robot)

    def forget(self, robot: str) -> None:
        """Know nothing of a robot any more."""
        self._whereabouts.forget(robot)

    def without(
        self, name: str, robot: Robot, known: Callable[[str], Robot | None], placed: PlacedScan
    ) -> WithoutRobots:
        """A scan of a robot, without the beams that ended at another one; `known` tells what is of each."""
        scan = placed.scan
        newest = robot.poses.newest
        own = scan.stamp if scan.pose is not None or newest is None else newest
        first = scan.stamp if placed.sweep is None else min(scan.stamp, scan.end_stamp)
        found = self._whereabouts.look(
            name, known, (own, APART_NS, first), _box(placed), scan.range_max + _ROUNDING
        )
        hints = tuple(
            Hint("robot_clock", _CLOCK.format(abs(newest - own) / 1e9, other))
            for other, newest in found.apart
            if self._goes_on(name, other, newest)
        )
        ways = _ways(placed, found.near)
        if not ways:
            return WithoutRobots(scan, 0, hints)
        times = np.zeros(scan.ranges.size) if placed.sweep is None else scan.beam_times
        marked = np.zeros(scan.ranges.size, np.bool_)
        self._mark_hits(placed, np.array(ways), times, marked)
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


def _ways(placed: PlacedScan, near: list[tuple[PoseHistory, float]]) -> list[tuple[float, ...]]:
    """Ways of robots for `MarkHits`, while the scan was taken.

    Where the map takes the beams one after the other, each has its own time; else all have the scan's stamp.
    """
    scan, rows = placed.scan, list[tuple[float, ...]]()
    first, last = sorted((0, scan.end_stamp - scan.stamp))
    for n, (history, radius) in enumerate(near):
        if placed.sweep is not None:
            rows += [(n, radius, *piece) for piece in history.pieces(scan.stamp, first, last)]
        elif (pose := history.about(scan.stamp)) is not None:
            rows.append((n, radius, 0.0, 0.0, *pose[:2], *pose[:2]))
    return rows


def _box(placed: PlacedScan) -> tuple[float, float, float, float]:
    """A box around the sensor while it measured, xmin, ymin, xmax, ymax."""
    if placed.sweep is None:
        x, y, _ = placed.pose
        return x, y, x, y
    places = placed.sweep.beams[:, :2]
    (xmin, ymin), (xmax, ymax) = places.min(axis=0).tolist(), places.max(axis=0).tolist()
    return xmin, ymin, xmax, ymax


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
