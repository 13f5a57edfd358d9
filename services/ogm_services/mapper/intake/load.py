"""Load of the queue: what the messages that wait in it take, in all, and of each robot."""

from collections import deque
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from ogm_services.mapper.intake.work import CellRate

_M = TypeVar("_M")


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
class RobotLoad(Generic[_M]):
    """What waits of one robot, and how long its cells take."""

    scans: deque[_M] = field(default_factory=deque)
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
