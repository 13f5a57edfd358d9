"""Pose source: what tells a group of robots' poses, and where their sensors are on them."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

from ogm_core.ros2.cdr import LaserScan, PointCloud2
from ogm_core.ros2.transform import Transform
from ogm_services.ros2.account import Account
from ogm_services.ros2.mapped_robot import MappedRobot
from ogm_services.ros2.options import Ros2Options
from ogm_services.ros2.robots import Robots
from ogm_services.ros2.sensor_feed import SensorFeed


class Mounted(NamedTuple):
    """Whose a message is, and as which of its sensors."""

    robot: MappedRobot
    sensor: str


@dataclass(frozen=True, slots=True)
class RobotGroup:
    """The robots of one network and namespace, and what all of them share.

    `where`: the network in words; `otherwise`: the name of a robot with neither namespace nor prefix.
    """

    where: str
    namespace: str
    otherwise: str
    robots: Robots
    account: Account
    options: Ros2Options


class PoseSource(Protocol):
    """The robots of one source and namespace."""

    def owner(self, feed: SensorFeed, message: LaserScan | PointCloud2, now: float) -> Mounted:
        """Whose sensor a message is of.

        Raises:
            NoTransformYet: nothing tells it so far.
            ScanRefused: it can be nobody's.
        """

    def mount(self, mounted: Mounted, message: LaserScan | PointCloud2, stamp: int) -> Transform:
        """Where the sensor was on its robot at a stamp, ns; raises as `owner` does."""

    def missing(self, mounted: Mounted) -> str:
        """Why a robot has no poses later than those that were sent."""

    def send_poses(self) -> None:
        """Send what can be told by now."""
