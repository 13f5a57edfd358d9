"""g2o pose graphs with laser lines: CARMEN's ROBOTLASER1 lines, each below the vertex that it was taken at.

`VERTEX2 id x y theta`, or VERTEX_SE2, is the robot's pose as SLAM has corrected it. The two poses in a
laser's line are not: they only say where the laser sits on the robot, as for g2o itself (RobotLaser::read).
"""

import math
import re
from dataclasses import replace

from ogm_core.errors import BadMessage
from ogm_core.logs.carmen import ROBOT, SENSOR, CarmenLog
from ogm_core.logs.carmen_lines import LaserLine
from ogm_core.logs.carmen_mount import SAME_M, SAME_RAD, seen_from
from ogm_core.logs.recorded import Recorded, RecordedScan
from ogm_core.types import IDENTITY, Pose

_VERTEX = re.compile(rb"\s*VERTEX(?:2|_SE2)(?:\s|$)")


class GraphLog:
    """Reads the lines of a pose graph, in their order, and those of a CARMEN log, which has no vertices.

    Unless it is known to be a graph, what comes first decides: of a log that begins with a sweep, vertices
    are other lines. `log` reads all lines but vertices. `is_graph` is None until that is known.
    """

    def __init__(self, log: CarmenLog, *, is_graph: bool | None = None) -> None:
        self.is_graph = is_graph
        self._log = log
        self._vertex: Pose | None = None
        self._odometry: Pose | None = None
        """Where the robot was by its wheels at the vertex, once a sweep there has said so."""
        self._stamp = 0

    def parse_line(self, line: bytes) -> Recorded | None:
        """Read one line; None if it is blank, a comment, a vertex or a message that is not read.

        Raises:
            BadMessage: the line is none of a graph or a log, or one that is read and makes no sense.
        """
        if self.is_graph is not False and _VERTEX.match(line):
            self.is_graph = True
            self._vertex = self._odometry = None  # below a malformed one the one before does not hold
            self._vertex = _vertex(line.split())
            return None
        if not self.is_graph:
            recorded = self._log.parse_line(line)
            if recorded is not None:
                self.is_graph = False
            return recorded
        match self._log.message(line):
            case LaserLine() as sweep:
                return self._placed(sweep)
        return None

    def _placed(self, sweep: LaserLine) -> RecordedScan:
        laser, robot = sweep.scan.pose, sweep.robot
        if self._vertex is None or laser is None:
            raise BadMessage("no vertex before it says where the robot was")
        if not all(map(math.isfinite, robot)):
            raise BadMessage("the robot's pose is not finite, so where its laser sits on it is not known")
        if self._odometry is None:
            self._odometry, self._stamp = robot, sweep.scan.stamp
        elif self._odometry == robot == IDENTITY and sweep.scan.stamp != self._stamp:
            raise BadMessage(
                "whether the robot has moved since the vertex before it is not known: it needs one"
            )
        moved = seen_from(self._odometry, robot)
        if math.hypot(moved.x, moved.y) > SAME_M or abs(moved.theta) > SAME_RAD:
            raise BadMessage("the robot has moved since the vertex before it: it needs one of its own")
        scan = replace(sweep.scan, pose=self._vertex, mount=seen_from(robot, laser))
        return RecordedScan(ROBOT, SENSOR, scan)


def _vertex(tokens: list[bytes]) -> Pose:
    name = tokens[0].decode()
    if len(tokens) != 5:
        raise BadMessage(f"{name}: 5 fields are needed, got {len(tokens)}")
    try:
        pose = Pose(*map(float, tokens[2:]))
    except ValueError as error:
        raise BadMessage(f"{name}: x, y and theta are needed, got {tokens[2:]}") from error
    if not all(map(math.isfinite, pose)):
        raise BadMessage(f"{name}: finite x, y and theta are needed, got {tokens[2:]}")
    return pose
