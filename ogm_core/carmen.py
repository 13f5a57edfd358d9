"""CARMEN logs: one message a line, its name first, fields between blanks.

`FLASER n r1 .. rn  x y theta  ox oy otheta  ipc_time host logger_time`, in metres, radians and seconds, is
one sweep of the front laser. The first triple is the laser's own pose in the map frame, the second the
robot's odometry. The log names neither the field of view nor the maximum range: both are the SICK LMS's.
"""

import math
import re

from ogm_core.errors import BadMessage
from ogm_core.messages import DEFAULT_MAX_BEAMS, scan_from_fields
from ogm_core.recorded import Recorded, RecordedScan, text_ranges
from ogm_core.types import Scan

ROBOT = "robot1"
SENSOR = "laser"
RANGE_MAX = 80.0
"""Range at which a SICK LMS says "nothing", m, where the user does not know better."""

_STEP_DEGREES = {b"180": 1.0, b"181": 1.0, b"360": 0.5, b"361": 0.5}
_MESSAGE_NAME = re.compile(rb"[A-Z][A-Z0-9_]*")
_FIELDS_AROUND_RANGES = 11  # the name, n, two poses, ipc_time, host, logger_time


def parse_line(
    line: bytes, *, range_max: float | None = None, max_beams: int = DEFAULT_MAX_BEAMS
) -> Recorded | None:
    """Read one line; None if it is blank, a comment or a message that is not read.

    `range_max` replaces the default of 80 m.

    Raises:
        BadMessage: the line is not CARMEN's, or a FLASER that makes no sense.
    """
    tokens = line.split()
    if not tokens or tokens[0].startswith(b"#"):
        return None
    match tokens[0]:
        case b"FLASER":
            scan = _flaser(tokens, RANGE_MAX if range_max is None else range_max, max_beams)
            return RecordedScan(ROBOT, SENSOR, scan)
    # Messages that are not read end here: ODOM, ROBOTLASER1, PARAM, SYNC, NEFF, TRUEPOS ...
    if _MESSAGE_NAME.fullmatch(tokens[0]):
        return None
    raise BadMessage("not a CARMEN message: a line begins with a name in capitals, or with #")


def _flaser(tokens: list[bytes], range_max: float, max_beams: int) -> Scan:
    count = tokens[1] if len(tokens) > 1 else b""
    if count not in _STEP_DEGREES:
        raise BadMessage(
            f"FLASER: 180, 181, 360 or 361 beams, whose bearings are known, are needed, got {count!r}"
        )
    beams, step = int(count), _STEP_DEGREES[count]
    if len(tokens) != beams + _FIELDS_AROUND_RANGES:
        raise BadMessage(
            f"FLASER: {beams} beams need {beams + _FIELDS_AROUND_RANGES} fields, got {len(tokens)}"
        )
    try:
        numbers = list(map(float, tokens[2:-2]))
    except ValueError as error:
        raise BadMessage(f"FLASER: a field is not a number ({error})") from error
    fields = {
        "stamp": _nanoseconds(numbers[-1]),
        "seq": 0,
        "angle_min": -math.pi / 2,
        "angle_increment": math.radians(step),
        "range_min": 0.0,
        "range_max": range_max,
        "pose": numbers[beams : beams + 3],
    }
    return scan_from_fields(fields, text_ranges(numbers[:beams]), max_beams=max_beams)


def _nanoseconds(seconds: float) -> int:
    stamp = seconds * 1e9
    if not math.isfinite(stamp):
        raise BadMessage(f"ipc_time: a finite number is needed, got {seconds:g}")
    return round(stamp)
