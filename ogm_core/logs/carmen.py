"""CARMEN logs: one message a line, its name first, fields between blanks; metres, radians, seconds.

`FLASER n r1 .. rn  x y theta  ox oy otheta  ipc_time host logger_time` is a sweep of the front laser. It
names neither the field of view nor the maximum range: both are the SICK LMS's. The step between the beams of
another laser is the log's `PARAM laser_front_laser_resolution`, in degrees; beam n // 2 looks ahead, as
those of the LMS do.

`ROBOTLASER1 laser_type start_angle field_of_view angular_resolution maximum_range accuracy remission_mode
n r1 .. rn  m s1 .. sm  x y theta  ox oy otheta  tv rv forward_safety_dist side_safety_dist turn_axis
ipc_time host logger_time` is the newer form, which names them.

`ODOM x y theta tv rv acceleration  ipc_time host logger_time` is the robot's pose, by its wheels.

Of a sweep's two poses the first is the laser's, the second the robot's by its wheels; what SLAM has corrected
is the first, or both. The first is the sweep's own pose. With a `mount` the ODOM lines are the robot's poses
instead, and a sweep has none of its own (carmen_mount says which mount).

A range at or above the maximum means "nothing" here, and is handed on as infinite.
"""

import math
import re
from collections import Counter
from dataclasses import replace

from ogm_core.errors import BadMessage
from ogm_core.logs.carmen_lines import LASERS, Known, Laser, LaserLine, is_count, odom_line, resolution_of
from ogm_core.logs.recorded import ReadDecimals, Recorded, RecordedPose, RecordedScan
from ogm_core.types import Pose, PoseStamped
from ogm_core.wire.messages import DEFAULT_MAX_BEAMS

ROBOT = "robot1"
SENSOR = "laser"

_MESSAGE_NAME = re.compile(r"[A-Z][A-Z0-9_:-]{0,63}")
_MAX_NAMES = 50
"""How many names of unread messages are told apart: any text's words in capitals look like such names."""

_OTHER_STEP = (
    "its {} beams are taken as {:g} degrees apart, those of a SICK LMS, but its PARAM line says {:g}: if "
    "that is right, give the beams as ROBOTLASER1, which names their bearings"
)


class CarmenLog:
    """Reads the lines of one log, in their order.

    `range_max` (m) replaces what the log says. `mount`: None, or the laser's pose on the robot; then ODOM
    lines are read. FLASER and ROBOTLASER1 are two forms of the front laser's sweeps; of a log that holds
    both, only the form that comes first is read. `unread` counts the messages that were passed over, by name.
    `decimals` reads the ranges of most lines at once; without it, and where it cannot, they are read singly.
    """

    def __init__(
        self,
        *,
        range_max: float | None = None,
        max_beams: int = DEFAULT_MAX_BEAMS,
        mount: Pose | None = None,
        decimals: ReadDecimals | None = None,
    ) -> None:
        self.unread: Counter[str] = Counter()
        self.doubt = ""
        """What contradicts how its lines are read; "" if nothing does."""
        self._known = Known(range_max, max_beams, needs_time=mount is not None, step=None)
        self._mount = mount
        self._decimals = decimals
        self._form: str | None = None

    def parse_line(self, line: bytes) -> Recorded | None:
        """Read one line; None if it is blank, a comment or a message that is not read.

        Raises:
            BadMessage: the line is not CARMEN's, or one that is read and makes no sense.
        """
        match self.message(line):
            case LaserLine(scan, _):
                if self._mount is not None:
                    scan = replace(scan, pose=None, mount=self._mount)
                return RecordedScan(ROBOT, SENSOR, scan)
            case PoseStamped() as pose:
                return RecordedPose(ROBOT, pose)
        return None

    def message(self, line: bytes) -> LaserLine | PoseStamped | None:
        """What one line says, likewise."""
        first = line.split(None, 1)[:1]
        if not first or first[0].startswith(b"#"):
            return None
        name = first[0].decode(errors="replace")
        laser = LASERS.get(name) if self._form in (None, name) else None
        if laser is None and (name != "ODOM" or self._mount is None):
            self._pass_over(name)
            if name == "PARAM" and self._known.step is None:
                self._known = self._known._replace(step=resolution_of(line))
            return None
        try:
            if laser is None:
                return odom_line(line.split())
            sweep = self._at_once(laser, line) or laser.read(line.split(), None, self._known)
        except BadMessage as error:
            raise BadMessage(f"{name}: {error}") from error
        self._form = name
        step, taken = self._known.step, math.degrees(sweep.scan.angle_increment)
        if name == "FLASER" and step is not None and not math.isclose(step, taken):
            self.doubt = _OTHER_STEP.format(sweep.scan.ranges.size, taken, step)
        return sweep

    def lasers_passed_over(self) -> str:
        """The laser messages among `unread`, as "20 RLASER, 3 RAWLASER1"; "" if there are none."""
        return ", ".join(f"{count} {name}" for name, count in self.unread.most_common() if "LASER" in name)

    def _at_once(self, laser: Laser, line: bytes) -> LaserLine | None:
        """What a laser's line says; None if its ranges cannot be read at once, or anything else is wrong."""
        if self._decimals is None:
            return None
        *head, text = line.split(None, laser.count_at + 1)
        if len(head) <= laser.count_at or not is_count(head[-1]) or int(head[-1]) > self._known.max_beams:
            return None
        ranges_and_end = self._decimals(text, int(head[-1]))
        if ranges_and_end is None:
            return None
        ranges, end = ranges_and_end
        if not text[end : end + 1].isspace():
            return None
        try:
            return laser.read(head + text[end:].split(), ranges, self._known)
        except BadMessage:
            return None  # who reads it with care says what is wrong

    def _pass_over(self, name: str) -> None:
        # PARAM, SYNC, NEFF, TRUEPOS, ODOM, RLASER, ROBOTLASER2, RAWLASER1 ... and what is yet to be invented.
        if not _MESSAGE_NAME.fullmatch(name):
            raise BadMessage("not a CARMEN message: a line begins with a name in capitals, or with #")
        self.unread[name if name in self.unread or len(self.unread) < _MAX_NAMES else "others"] += 1
