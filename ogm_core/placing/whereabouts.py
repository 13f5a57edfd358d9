"""Whereabouts of robots of late: a table that tells at once which of many a scan may have seen."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ogm_core.placing.pose_history import PoseHistory
from ogm_core.placing.robot import Robot
from ogm_core.placing.robot_rules import RobotRules

_NOBODY = -(2**62)
"""As a stamp, far from any: of a row that is free."""
_FEWEST = 16
"""Rows that there are at first."""


class Looked(NamedTuple):
    """Robots that a scan may have seen, by poses and radii, m; and whose stamps are far away, and change."""

    near: list[tuple[PoseHistory, float]]
    apart: list[tuple[str, int]]
    """With their newest stamps."""


class Whereabouts:
    """A row for each robot with a radius: its newest stamp, and a box around its newest poses."""

    def __init__(self, rules: RobotRules) -> None:
        self._rules = rules
        self._moved: dict[str, None] = {}  # in the order of their messages, not of hashes
        self._rows: dict[str, int] = {}
        self._names: list[str] = []
        self._histories: list[PoseHistory] = []
        self._free: list[int] = []
        self._stamps = np.full((_FEWEST, 3), _NOBODY)
        """Of each: the newest stamp, that from which on the box holds, and the number of its last change."""
        self._boxes = np.zeros((_FEWEST, 5))
        """Of each: xmin, ymin, xmax, ymax and the radius, m."""
        self._changes = 0
        self._seen: dict[str, int] = {}
        """By robot that looked, how many changes there were then."""

    def moved(self, robot: str) -> None:
        """Note that what is known of a robot's poses has changed."""
        self._moved[robot] = None

    def forget(self, robot: str) -> None:
        """Know nothing of a robot any more."""
        self._moved.pop(robot, None)
        self._seen.pop(robot, None)
        row = self._rows.pop(robot, None)
        if row is not None:
            self._stamps[row] = _NOBODY
            self._free.append(row)

    def look(
        self,
        robot: str,
        known: Callable[[str], Robot | None],
        times: tuple[int, int, int],
        box: tuple[float, float, float, float],
        farthest: float,
    ) -> Looked:
        """Which other robots may be within `farthest`, m, and their radius of a box.

        `times`, ns: the robot's newest stamp, how far apart those of others may be, that of the first beam.
        `known` tells what is known of a robot.
        """
        self._refresh(known)
        count, (own, most, first), (xmin, ymin, xmax, ymax) = len(self._names), times, box
        stamps, boxes = self._stamps[:count].T, self._boxes[:count].T
        close = np.abs(stamps[0] - own) <= most
        dx = np.maximum(np.maximum(boxes[0] - xmax, xmin - boxes[2]), 0.0)
        dy = np.maximum(np.maximum(boxes[1] - ymax, ymin - boxes[3]), 0.0)
        reach = farthest + boxes[4]
        near = close & ((dx * dx + dy * dy <= reach * reach) | (first < stamps[1]))
        far = ~close & (stamps[2] > self._seen.get(robot, 0))
        self._seen[robot] = self._changes
        mine = self._rows.get(robot)
        seen = [row for row in np.flatnonzero(near).tolist() if row != mine]
        apart = [row for row in np.flatnonzero(far).tolist() if row != mine]
        return Looked(
            [(self._histories[row], float(boxes[4, row])) for row in seen],
            [(self._names[row], int(stamps[0, row])) for row in apart],
        )

    def _refresh(self, known: Callable[[str], Robot | None]) -> None:
        """Write the rows of those that have moved."""
        if not self._moved:
            return
        self._changes += 1
        for name in self._moved:
            robot, radius = known(name), self._rules.radius_of(name)
            newest = None if robot is None else robot.poses.newest
            if robot is None or radius is None or newest is None:
                continue
            row = self._rows.get(name)
            if row is None:
                row = self._new_row(name, robot.poses.history)
            history = self._histories[row] = robot.poses.history
            since, box = history.lately()
            self._stamps[row] = newest, since, self._changes
            self._boxes[row] = *box, radius
        self._moved.clear()

    def _new_row(self, name: str, history: PoseHistory) -> int:
        if self._free:
            row = self._free.pop()
            self._names[row] = name
        else:
            row = len(self._names)
            self._names.append(name)
            self._histories.append(history)
            if row == len(self._stamps):
                self._stamps = np.concatenate((self._stamps, np.full_like(self._stamps, _NOBODY)))
                self._boxes = np.concatenate((self._boxes, np.zeros_like(self._boxes)))
        self._rows[name] = row
        return row
