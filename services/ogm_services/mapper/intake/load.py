"""Load of the queue: what the messages that wait in it take, in all, and of each robot."""

from collections import deque
from dataclasses import dataclass, field
from itertools import islice

from ogm_services.mapper.intake.message import Message
from ogm_services.mapper.intake.work import CellRate

MAX_WORK = 5.0
"""Work that may wait, by what the cells of each robot's scans have taken so far, s."""
MAX_RATES = 2000
"""Robots whose rates are remembered; one that is forgotten is measured anew."""


@dataclass(slots=True)
class Load:
    """Scans and poses that wait: how many, their payload in bytes, and the work that the scans will be, s."""

    scans: int = 0
    size: int = 0
    """Of the scans."""
    work: float = 0.0
    """Of those scans whose size was looked at."""
    poses: int = 0
    pose_size: int = 0

    def add_scan(self, size: int, work: float) -> None:
        """Count one more."""
        self.scans += 1
        self.size += size
        self.work += work

    def remove_scan(self, size: int, work: float) -> None:
        """Count one less."""
        self.scans -= 1
        self.size -= size
        self.work -= work
        if not self.scans:  # else what is lost in rounding would add up
            self.work = 0.0

    def add_pose(self, size: int) -> None:
        """Count one more."""
        self.poses += 1
        self.pose_size += size

    def remove_pose(self, size: int) -> None:
        """Count one less."""
        self.poses -= 1
        self.pose_size -= size


@dataclass(slots=True, eq=False)
class RobotLoad:
    """What waits of one robot, and how long its cells take."""

    scans: deque[Message] = field(default_factory=deque)
    """Of all its sensors, oldest first."""
    cells: float = 0.0
    resumed_cells: float = 0.0
    """Of those scans that are resumed."""
    size: int = 0
    """Payload of the scans, bytes."""
    poses: int = 0
    rate: CellRate = field(default_factory=CellRate)
    posing: float = 0.0
    """How long its poses have taken since its last scan, s: they make scans ready that came before."""

    @property
    def work(self) -> float:
        """How long its scans will take, about, s."""
        return self.cells * self.rate.value

    def look(self, cells: float | None, sign: int, *, resumed: bool) -> float:
        """Count the cells of a scan that comes (1) or goes (-1); the work that it is, s."""
        if cells is None:
            return 0.0
        self.cells += sign * cells
        if resumed:
            self.resumed_cells += sign * cells
        return cells * self.rate.value


class QueueLoad:
    """All that waits, and of each robot. For who holds the queue's lock."""

    def __init__(self, max_scans: int, max_scan_bytes: int) -> None:
        """How many scans may wait, and their payload in bytes."""
        self._max_scans = max_scans
        self._max_scan_bytes = max_scan_bytes
        self.all = Load()
        self.resumed = Load()
        """The part of it that is resumed."""
        self.robots: dict[str, RobotLoad] = {}

    def robot(self, name: str) -> RobotLoad:
        """That of a robot, which may be new."""
        robot = self.robots.get(name)
        if robot is None:
            if len(self.robots) >= MAX_RATES:
                self._forget_some()
            robot = self.robots[name] = RobotLoad()
        return robot

    def add_pose(self, name: str, item: Message) -> None:
        """Count one more of a robot."""
        self.robot(name).poses += 1
        for load in self._loads(item):
            load.add_pose(len(item.payload))

    def remove_pose(self, name: str, item: Message) -> None:
        """Count one less."""
        self.robot(name).poses -= 1
        for load in self._loads(item):
            load.remove_pose(len(item.payload))

    def add_scan(self, name: str, item: Message) -> None:
        """Count one more of a robot, its newest."""
        robot = self.robot(name)
        robot.scans.append(item)
        robot.size += len(item.payload)
        work = robot.look(item.cells, 1, resumed=item.resumed)
        for load in self._loads(item):
            load.add_scan(len(item.payload), work)

    def remove_first_scan(self, name: str) -> Message:
        """Take away a robot's oldest scan; there has to be one."""
        robot = self.robots[name]
        item = robot.scans.popleft()
        robot.size -= len(item.payload)
        work = robot.look(item.cells, -1, resumed=item.resumed)
        if not robot.scans:  # else what is lost in rounding would add up
            robot.cells = robot.resumed_cells = 0.0
        for load in self._loads(item):
            load.remove_scan(len(item.payload), work)
        return item

    def looked(self, name: str, item: Message) -> None:
        """Count the work of a scan that waits, and whose cells are known now."""
        work = self.robots[name].look(item.cells, 1, resumed=item.resumed)
        for load in self._loads(item):
            load.work += work

    def measured(self, name: str, cells: float, seconds: float) -> None:
        """Learn how long a robot's scan of so many cells took, s: those that wait are of that kind, too."""
        robot = self.robot(name)
        before = robot.rate.value
        robot.rate.measured(cells, seconds + robot.posing)
        robot.posing = 0.0
        self.all.work += robot.cells * (robot.rate.value - before)
        self.resumed.work += robot.resumed_cells * (robot.rate.value - before)

    def part(self, load: Load) -> float:
        """The part of the bounds that scans take up: of the work, the bytes or their number, the largest."""
        return max(load.work / MAX_WORK, load.size / self._max_scan_bytes, load.scans / self._max_scans)

    def share(self, name: str) -> float:
        """The part of the bounds that a robot's scans take up."""
        robot = self.robots.get(name)
        if robot is None:
            return 0.0
        size = robot.size / self._max_scan_bytes
        return max(robot.work / MAX_WORK, size, len(robot.scans) / self._max_scans)

    def _forget_some(self) -> None:
        """Forget those of the first few robots of which nothing waits; the others become the last ones."""
        for name in list(islice(self.robots, 8)):
            robot = self.robots.pop(name)
            if robot.scans or robot.poses:
                self.robots[name] = robot

    def _loads(self, item: Message) -> tuple[Load, ...]:
        return (self.all, self.resumed) if item.resumed else (self.all,)
