"""Waiting room of scans whose poses have not come: how long they wait, how many, and who is given up."""

from collections.abc import Callable
from itertools import islice

from ogm_core.placing import reasons
from ogm_core.placing.outcomes import Outcomes
from ogm_core.placing.placement import Placement, is_ready
from ogm_core.placing.reasons import Reason
from ogm_core.placing.robot import Robot
from ogm_core.placing.robots import Robots
from ogm_core.placing.rules import MAX_WAITING_SCANS, WAITING_NS
from ogm_core.placing.source import Source
from ogm_core.placing.waiting import Waiting, WaitingLimits


class WaitingRoom:
    """Lets the scans of all robots wait for their poses within limits, and places those that become ready."""

    def __init__(
        self,
        robots: Robots,
        outcomes: Outcomes,
        placement: Placement,
        pose_wait: float,
        limits: WaitingLimits,
        stopping: Callable[[], bool],
    ) -> None:
        """`pose_wait`: how far ahead of its robot's poses a scan may be, s. Once `stopping`, all stay."""
        self._robots = robots
        self._outcomes = outcomes
        self._placement = placement
        self._pose_wait = pose_wait
        self._limits = limits
        self._stopping = stopping

    def add(self, name: str, robot: Robot, source: Source, item: Waiting) -> None:
        """Let a scan wait, unless it is ready, or will never be."""
        if source.holds:  # for whichever pose comes next: how far ahead it is matters only then
            robot.waiting.append(item)
            waits = True
        else:
            waits = self._try(name, robot, item)
        if waits:
            if source.crowds(item.scan.stamp):
                self._limit_sensor(name, robot, item.sensor)
            self._make_room(name, robot)

    def look_again(self, name: str, robot: Robot) -> None:
        """Try every scan of a robot that waits, in order of arrival."""
        bugs = []
        for item in robot.waiting.take():
            if self._stopping():
                robot.waiting.append(item)
                continue
            try:
                self._try(name, robot, item)
            except Exception as bug:  # noqa: BLE001 (raised below)
                bugs.append(bug)
        if bugs:
            raise ExceptionGroup(f"scans of {name} that waited for this pose", bugs)

    def give_up(
        self, name: str, robot: Robot, why: Reason, which: Callable[[Waiting], bool] = lambda _: True
    ) -> None:
        """Drop those of a robot's waiting scans that `which` chooses."""
        for item in robot.waiting.take(which):
            robot.told = None
            self._outcomes.drop(name, item.sensor, "no_pose", why)

    def why_none(self, name: str, robot: Robot, else_why: Reason) -> Reason:
        """Why no pose has come for a scan: maybe because none ever did."""
        if robot.poses.owner is not None:
            return else_why
        others = (other for other, known in self._robots.items() if known.poses.owner is not None)
        return reasons.no_pose_ever(name, list(islice(others, 5)))

    def _try(self, name: str, robot: Robot, item: Waiting) -> bool:
        """Place a scan that is ready, drop one that will never be, let the others wait; whether it waits."""
        scan, newest = item.scan, robot.poses.newest
        if is_ready(robot, scan):
            self._placement.place(name, robot, item.sensor, scan, item.handed)
        elif newest is not None and scan.stamp - newest > self._pose_wait * 1e9:
            ahead = reasons.ahead(scan.stamp - newest, self._pose_wait)
            self._outcomes.drop(name, item.sensor, "no_pose", ahead)
        else:
            robot.waiting.append(item)
            return True
        return False

    def _limit_sensor(self, name: str, robot: Robot, sensor: str) -> None:
        """Give up those scans of a sensor that wait while much newer ones do, or too many."""
        mine = [item for item in robot.waiting if item.sensor == sensor]
        newest = max(item.scan.stamp for item in mine)
        most = MAX_WAITING_SCANS
        kept = most if len(mine) <= most else most * 7 // 8  # not one by one
        oldest_number = mine[-kept:][0].number
        self.give_up(
            name,
            robot,
            self.why_none(name, robot, reasons.CROWDED),
            lambda item: (
                item.sensor == sensor
                and (newest - item.scan.stamp > WAITING_NS or item.number < oldest_number)
            ),
        )
        stamps = [item.scan.stamp for item in robot.waiting if item.sensor == sensor]
        robot.sources[sensor].waiting = len(stamps), min(stamps), max(stamps)

    def _make_room(self, name: str, robot: Robot) -> None:
        """Give up the oldest scans of a robot past its limit, then of the one that holds the most bytes."""
        limits = self._limits
        while robot.waiting.cells > limits.cells and len(robot.waiting) > 1:
            sensor = robot.waiting.take_first().sensor
            self._outcomes.drop(name, sensor, "no_pose", reasons.too_much_waits(limits.cells))
        while self._robots.waiting.nbytes > limits.nbytes:
            name, robot = max(self._robots.items(), key=lambda entry: entry[1].waiting.nbytes)
            robot.told = None
            sensor = robot.waiting.take_first().sensor
            self._outcomes.drop(name, sensor, "no_pose", reasons.no_room(limits.nbytes))
