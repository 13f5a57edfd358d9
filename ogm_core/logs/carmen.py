"""CARMEN logs: one message a line, its name first, fields between blanks; metres, radians, seconds.

`FLASER n r1 .. rn  x y theta  ox oy otheta  ipc_time host logger_time` is a sweep of the front laser. It
names neither the field of view nor the maximum range: both are the SICK LMS's.

`ROBOTLASER1 laser_type start_angle field_of_view angular_resolution maximum_range accuracy remission_mode
n r1 .. rn  m s1 .. sm  x y theta  ox oy otheta  tv rv forward_safety_dist side_safety_dist turn_axis
ipc_time host logger_time` is the newer form, which names them.

`ODOM x y theta tv rv acceleration  ipc_time host logger_time` is the robot's pose, by its wheels.

Of a sweep's two poses the first is the laser's, the second the robot's by its wheels; what SLAM has corrected
is the first, or both. The first is the sweep's own pose. With a `mount` the ODOM lines are the robot's poses
instead, and a sweep has none of its own (carmen_mount says which mount).
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from ogm_core.errors import BadMessage
from ogm_core.logs.recorded import ReadDecimals, Recorded, RecordedPose, RecordedScan, text_ranges
from ogm_core.types import Pose, PoseStamped, Ranges, Scan
from ogm_core.wire.messages import DEFAULT_MAX_BEAMS, MAX_RANGE, pose_from_fields, scan_from_fields

ROBOT = "robot1"
SENSOR = "laser"
RANGE_MAX = 80.0
"""Range at which a SICK LMS says "nothing", m, where neither the log nor the user knows better."""

_STEP_DEGREES = {b"180": 1.0, b"181": 1.0, b"360": 0.5, b"361": 0.5}
_MESSAGE_NAME = re.compile(r"[A-Z][A-Z0-9_]{0,63}")
_MAX_NAMES = 50
"""How many names of unread messages are told apart: any text's words in capitals look like such names."""

_SETUP = (
    "laser_type",
    "start_angle",
    "field_of_view",
    "angular_resolution",
    "maximum_range",
    "accuracy",
    "remission_mode",
)
_LASER_POSE = ("laser_pose_x", "laser_pose_y", "laser_pose_theta")
_POSES = (*_LASER_POSE, "robot_pose_x", "robot_pose_y", "robot_pose_theta")
_SAFETY = ("laser_tv", "laser_rv", "forward_safety_dist", "side_safety_dist", "turn_axis")
_ODOM = ("x", "y", "theta", "tv", "rv", "acceleration", "ipc_time")
_COUNT_DIGITS = 9  # a line holds fewer numbers than that says; int() refuses very long ones


class LaserLine(NamedTuple):
    """What a laser's line says: a sweep, whose `pose` is the laser's, and the robot's pose by its wheels."""

    scan: Scan
    robot: Pose


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
        self._range_max = range_max
        self._max_beams = max_beams
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
        laser = _LASERS.get(name) if self._form in (None, name) else None
        if laser is None and (name != "ODOM" or self._mount is None):
            self._pass_over(name)
            return None
        try:
            if laser is None:
                return _odom(line.split())
            sweep = self._at_once(laser, line) or laser.read(
                line.split(), None, self._range_max, self._max_beams
            )
        except BadMessage as error:
            raise BadMessage(f"{name}: {error}") from error
        self._form = name
        return sweep

    def lasers_passed_over(self) -> str:
        """The laser messages among `unread`, as "20 RLASER, 3 RAWLASER1"; "" if there are none."""
        return ", ".join(f"{count} {name}" for name, count in self.unread.most_common() if "LASER" in name)

    def _at_once(self, laser: "_Laser", line: bytes) -> LaserLine | None:
        """What a laser's line says; None if its ranges cannot be read at once, or anything else is wrong."""
        if self._decimals is None:
            return None
        *head, text = line.split(None, laser.count_at + 1)
        if len(head) <= laser.count_at or not _is_count(head[-1]) or int(head[-1]) > self._max_beams:
            return None
        ranges_and_end = self._decimals(text, int(head[-1]))
        if ranges_and_end is None:
            return None
        ranges, end = ranges_and_end
        if not text[end : end + 1].isspace():
            return None
        try:
            return laser.read(head + text[end:].split(), ranges, self._range_max, self._max_beams)
        except BadMessage:
            return None  # who reads it with care says what is wrong

    def _pass_over(self, name: str) -> None:
        # PARAM, SYNC, NEFF, TRUEPOS, ODOM, RLASER, ROBOTLASER2, RAWLASER1 ... and what is yet to be invented.
        if not _MESSAGE_NAME.fullmatch(name):
            raise BadMessage("not a CARMEN message: a line begins with a name in capitals, or with #")
        self.unread[name if name in self.unread or len(self.unread) < _MAX_NAMES else "others"] += 1


def _flaser(tokens: list[bytes], ranges: Ranges | None, range_max: float | None, max_beams: int) -> LaserLine:
    """What an FLASER line says; `ranges` are those that were read already, and are none of its tokens."""
    count = tokens[1] if len(tokens) > 1 else b""
    if count not in _STEP_DEGREES:
        raise BadMessage(f"180, 181, 360 or 361 beams, whose bearings are known, are needed, got {count!r}")
    beams = int(count) if ranges is None else 0
    _check_length(tokens, beams + 11, f" for {beams} beams")
    numbers = _numbers(tokens, lambda: ["num_readings", *_each("ranges", beams), *_POSES, "ipc_time"])
    fields = {
        "angle_min": -math.pi / 2,
        "angle_increment": math.radians(_STEP_DEGREES[count]),
        "range_max": RANGE_MAX if range_max is None else range_max,
    }
    if ranges is None:
        ranges = text_ranges(numbers[1 : 1 + beams])
    return _laser_line(fields, ranges, numbers[1 + beams :], max_beams)


def _robotlaser(
    tokens: list[bytes], ranges: Ranges | None, range_max: float | None, max_beams: int
) -> LaserLine:
    """What a ROBOTLASER1 line says, likewise."""
    first = 1 + len(_SETUP)
    beams = _count(tokens, first, "num_readings") if ranges is None else 0
    remissions = _count(tokens, first + 1 + beams, "num_remissions")
    _check_length(tokens, beams + remissions + 24, f" for {beams} readings and {remissions} remissions")

    def names() -> list[str]:
        sizes = ["num_readings", *_each("ranges", beams), "num_remissions", *_each("remissions", remissions)]
        return [*_SETUP, *sizes, *_POSES, *_SAFETY, "ipc_time"]

    numbers = _numbers(tokens, names)
    _, start_angle, _, resolution, own_range_max, _, _ = numbers[: len(_SETUP)]
    _check_finite(start_angle=start_angle, angular_resolution=resolution, maximum_range=own_range_max)
    if resolution == 0.0:
        raise BadMessage("angular_resolution: it must not be 0")
    if range_max is None and not 0.0 < own_range_max <= MAX_RANGE:
        raise BadMessage(
            f"maximum_range: above 0 and at most {MAX_RANGE:g} m is needed, got {own_range_max:g} "
            "(--range-max replaces it)"
        )
    fields = {
        "angle_min": start_angle,
        "angle_increment": resolution,
        "range_max": own_range_max if range_max is None else range_max,
    }
    if ranges is None:
        ranges = text_ranges(numbers[first : first + beams])
    return _laser_line(fields, ranges, numbers[first + 1 + beams + remissions :], max_beams)


class _Laser(NamedTuple):
    """One form of the laser's lines."""

    count_at: int
    """Which of its tokens says how many ranges follow."""
    read: Callable[[list[bytes], Ranges | None, float | None, int], LaserLine]


_LASERS = {"FLASER": _Laser(1, _flaser), "ROBOTLASER1": _Laser(1 + len(_SETUP), _robotlaser)}
LASERS_READ = tuple(_LASERS)


def _laser_line(fields: dict[str, float], ranges: Ranges, rest: list[float], max_beams: int) -> LaserLine:
    """Put a sweep together; what follows its ranges are the two poses first, ipc_time last."""
    pose = rest[:3]
    _check_finite(**dict(zip(_LASER_POSE, pose, strict=True)))
    header = {"stamp": _nanoseconds(rest[-1]), "seq": 0, "range_min": 0.0, "pose": pose}
    scan = scan_from_fields(fields | header, ranges, max_beams=max_beams)
    return LaserLine(scan, Pose(*rest[3:6]))


def _odom(tokens: list[bytes]) -> PoseStamped:
    _check_length(tokens, 10)
    x, y, theta, _, _, _, ipc_time = _numbers(tokens, lambda: _ODOM)
    return pose_from_fields({"stamp": _nanoseconds(ipc_time), "seq": 0, "x": x, "y": y, "theta": theta})


def _each(name: str, count: int) -> list[str]:
    return [f"{name}[{k}]" for k in range(count)]


def _count(tokens: list[bytes], at: int, name: str) -> int:
    if at >= len(tokens):
        raise BadMessage(f"{name}: missing, the line has only {len(tokens)} fields")
    if not _is_count(tokens[at]):
        raise BadMessage(f"{name}: a whole number is needed, got {tokens[at]!r}")
    return int(tokens[at])


def _is_count(token: bytes) -> bool:
    return token.isdigit() and len(token) <= _COUNT_DIGITS


def _check_length(tokens: list[bytes], needed: int, purpose: str = "") -> None:
    if len(tokens) != needed:
        raise BadMessage(f"{needed} fields are needed{purpose}, got {len(tokens)}")


def _numbers(tokens: list[bytes], names: Callable[[], Sequence[str]]) -> list[float]:
    """All fields but the name, and host and logger_time at the end, which are not looked at."""
    fields = tokens[1:-2]
    try:
        if b"_" not in b"".join(fields):  # 1_000 is a number to Python alone
            return list(map(float, fields))
    except ValueError:
        pass
    wrong = next(k for k, field in enumerate(fields) if not _is_number(field))
    raise BadMessage(f"{names()[wrong]}: a number is needed, got {fields[wrong]!r}")


def _is_number(text: bytes) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return b"_" not in text


def _check_finite(**numbers: float) -> None:
    for name, number in numbers.items():
        if not math.isfinite(number):
            raise BadMessage(f"{name}: a finite number is needed, got {number:g}")


def _nanoseconds(seconds: float) -> int:
    stamp = seconds * 1e9
    if not math.isfinite(stamp):
        raise BadMessage(f"ipc_time: a finite number is needed, got {seconds:g}")
    return round(stamp)
