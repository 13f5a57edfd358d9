"""Lines of a CARMEN log, field by field: a laser's sweeps and ODOM; carmen says what the fields are."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from ogm_core.errors import BadMessage
from ogm_core.logs.recorded import no_returns, text_ranges
from ogm_core.types import Pose, PoseStamped, Ranges, Scan
from ogm_core.wire.messages import MAX_RANGE, pose_from_fields, scan_from_fields

RANGE_MAX = 80.0
"""Range at which a SICK LMS says "nothing", m, where neither the log nor the user knows better."""

_STEP_DEGREES = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}
_RESOLUTION = "laser_front_laser_resolution"
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


class Known(NamedTuple):
    """What is known beside a laser's line itself."""

    range_max: float | None
    """Replaces what the line says, m."""
    max_beams: int
    needs_time: bool
    """Whether the sweep's pose is looked up at its time; else a negative one, which is none, reads as 0."""
    step: float | None
    """Between the front laser's beams, degrees, as a PARAM line says."""


def _flaser(tokens: list[bytes], ranges: Ranges | None, known: Known) -> LaserLine:
    """What an FLASER line says; `ranges` are those that were read already, and are none of its tokens."""
    count = _count(tokens, 1, "num_readings")
    step = math.radians(_step(count, known))
    beams = count if ranges is None else 0
    _check_length(tokens, beams + 11, f" for {beams} beams")
    numbers = _numbers(tokens, lambda: ["num_readings", *_each("ranges", beams), *_POSES, "ipc_time"])
    fields = {
        "angle_min": -math.pi / 2 if count in _STEP_DEGREES else -(count // 2) * step,
        "angle_increment": step,
        "range_max": RANGE_MAX if known.range_max is None else known.range_max,
    }
    if ranges is None:
        ranges = text_ranges(numbers[1 : 1 + beams])
    return _laser_line(fields, ranges, numbers[1 + beams :], known)


def _step(count: int, known: Known) -> float:
    """From beam to beam, degrees."""
    if count in _STEP_DEGREES:
        return _STEP_DEGREES[count]
    if known.step is None:
        raise BadMessage(
            f"the bearings of {count} beams are not known (those of 180, 181, 360 and 361 are): "
            f"no line `PARAM {_RESOLUTION} DEGREES` comes before; add one"
        )
    if (count - 1) * known.step > 360.0:
        raise BadMessage(
            f"{count} beams, {known.step:g} degrees apart by PARAM {_RESOLUTION}, go round more than once"
        )
    return known.step


def _robotlaser(tokens: list[bytes], ranges: Ranges | None, known: Known) -> LaserLine:
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
    if known.range_max is None and not 0.0 < own_range_max <= MAX_RANGE:
        raise BadMessage(
            f"maximum_range: above 0 and at most {MAX_RANGE:g} m is needed, got {own_range_max:g} "
            "(--range-max replaces it)"
        )
    fields = {
        "angle_min": start_angle,
        "angle_increment": resolution,
        "range_max": own_range_max if known.range_max is None else known.range_max,
    }
    if ranges is None:
        ranges = text_ranges(numbers[first : first + beams])
    return _laser_line(fields, ranges, numbers[first + 1 + beams + remissions :], known)


class Laser(NamedTuple):
    """One form of the laser's lines."""

    count_at: int
    """Which of its tokens says how many ranges follow."""
    read: Callable[[list[bytes], Ranges | None, Known], LaserLine]


LASERS = {"FLASER": Laser(1, _flaser), "ROBOTLASER1": Laser(1 + len(_SETUP), _robotlaser)}


def _laser_line(fields: dict[str, float], ranges: Ranges, rest: list[float], known: Known) -> LaserLine:
    """Put a sweep together; what follows its ranges are the two poses first, ipc_time last."""
    pose = rest[:3]
    _check_finite(**dict(zip(_LASER_POSE, pose, strict=True)))
    stamp = _nanoseconds(rest[-1])
    if not known.needs_time:
        stamp = max(stamp, 0)
    header = {"stamp": stamp, "seq": 0, "range_min": 0.0, "pose": pose}
    ranges = no_returns(ranges, fields["range_max"])
    scan = scan_from_fields(fields | header, ranges, max_beams=known.max_beams)
    return LaserLine(scan, Pose(*rest[3:6]))


def odom_line(tokens: list[bytes]) -> PoseStamped:
    """The robot's pose, by the fields of an ODOM line; BadMessage if they make no sense."""
    _check_length(tokens, 10)
    x, y, theta, _, _, _, ipc_time = _numbers(tokens, lambda: _ODOM)
    return pose_from_fields({"stamp": _nanoseconds(ipc_time), "seq": 0, "x": x, "y": y, "theta": theta})


def resolution_of(line: bytes) -> float | None:
    """The step of the front laser's beams, degrees, if that is what a PARAM line says."""
    tokens = line.split(None, 3)
    if len(tokens) < 3 or tokens[1] != _RESOLUTION.encode() or not _is_number(tokens[2]):
        return None
    step = float(tokens[2])
    return step if 0.0 < step <= 360.0 else None


def _each(name: str, count: int) -> list[str]:
    return [f"{name}[{k}]" for k in range(count)]


def _count(tokens: list[bytes], at: int, name: str) -> int:
    if at >= len(tokens):
        raise BadMessage(f"{name}: missing, the line has only {len(tokens)} fields")
    if not is_count(tokens[at]):
        raise BadMessage(f"{name}: a whole number is needed, got {tokens[at]!r}")
    return int(tokens[at])


def is_count(token: bytes) -> bool:
    """Whether a field says how many."""
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
