"""Sensor mount of a CARMEN log's laser, which its sweeps need once ODOM lines are the robot's poses.

CARMEN writes into every sweep the robot's pose, interpolated between its ODOM lines, and the laser's, the
robot's composed with the mount; and it logs the mount as the parameters robot_frontlaser_offset (m
forward), robot_frontlaser_side_offset (m to the left) and robot_frontlaser_angular_offset (rad). Who corrects
the poses afterwards may correct both, and the ODOM lines; or the laser's alone, and then the two no longer
lie in one frame.
"""

import math
from collections.abc import Iterable

from ogm_core.errors import BadMessage, BadSetting
from ogm_core.logs.carmen import CarmenLog
from ogm_core.logs.carmen_lines import LaserLine
from ogm_core.types import IDENTITY, Pose, PoseStamped, shorter_arc

SAME_M = 0.01
SAME_RAD = 0.01
"""Two lines say the same mount if it differs by no more: logs round poses to six digits."""

_PARAMETERS = (
    b"robot_frontlaser_offset",
    b"robot_frontlaser_side_offset",
    b"robot_frontlaser_angular_offset",
)


def mount_of_laser(lines: Iterable[bytes], log: CarmenLog) -> Pose:
    """The laser's pose on the robot, by all lines of a log.

    If every sweep's two poses say the same mount, it is the first's; else the parameters'. `log` reads the
    lines, ODOM among them; malformed ones are passed over. Without a sweep it is the identity.

    Raises:
        BadSetting: there is no ODOM line, or neither the sweeps nor a parameter say the mount.
    """
    survey = _Survey(log)
    for line in lines:
        survey.add(line)
    return survey.mount()


class _Survey:
    """What the lines seen so far say."""

    def __init__(self, log: CarmenLog) -> None:
        self._log = log
        self._sweeps = self._poses = 0
        self._bad_pose = ""
        self._first = IDENTITY
        self._agree = True
        self._parameters: dict[bytes, float] = {}

    def add(self, line: bytes) -> None:
        try:
            match self._log.message(line):
                case LaserLine(scan, robot) if scan.pose is not None:
                    self._compare(robot, scan.pose)
                case PoseStamped():
                    self._poses += 1
                case None if line.lstrip().startswith(b"PARAM"):
                    self._note(line.split())
        except BadMessage as error:
            if line.lstrip().startswith(b"ODOM"):
                self._bad_pose = self._bad_pose or f"; its ODOM lines are malformed ({error})"

    def mount(self) -> Pose:
        if self._sweeps and not self._poses:
            raise BadSetting(
                f"--odometry: no ODOM line to take poses from{self._bad_pose}; "
                "leave it out to take those in the laser's own lines"
            )
        if self._agree:
            return self._first
        if _PARAMETERS[0] not in self._parameters:
            raise BadSetting(
                "--odometry: where the laser sits on the robot is not known: the two poses in its lines "
                "lie in different frames, and there is no PARAM robot_frontlaser_offset"
            )
        return Pose(*(self._parameters.get(name, 0.0) for name in _PARAMETERS))

    def _compare(self, robot: Pose, laser: Pose) -> None:
        self._sweeps += 1
        if not all(map(math.isfinite, robot)):
            self._agree = False
            return
        mount = seen_from(robot, laser)
        if self._sweeps == 1:
            self._first = mount
        near = math.hypot(mount.x - self._first.x, mount.y - self._first.y) <= SAME_M
        self._agree &= near and abs(shorter_arc(self._first.theta, mount.theta)) <= SAME_RAD

    def _note(self, tokens: list[bytes]) -> None:
        """Keep a parameter as it was first said."""
        if len(tokens) < 3 or tokens[1] not in _PARAMETERS or tokens[1] in self._parameters:
            return
        try:
            value = float(tokens[2])
        except ValueError:
            return
        if math.isfinite(value):
            self._parameters[tokens[1]] = value


def seen_from(robot: Pose, laser: Pose) -> Pose:
    """The laser's pose in the robot's frame, of two poses in one frame."""
    dx, dy = laser.x - robot.x, laser.y - robot.y
    c, s = math.cos(robot.theta), math.sin(robot.theta)
    return Pose(c * dx + s * dy, c * dy - s * dx, shorter_arc(robot.theta, laser.theta))
