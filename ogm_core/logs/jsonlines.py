"""JSON lines logs: a message's fields, "type", "robot" and, for scans, "sensor", one message a line.

`ranges` is a list of numbers, read as float32; "inf", "-inf" and "nan" stand in it as strings.
"""

import json
import math
from typing import Any, NoReturn, cast

import numpy as np
import orjson

from ogm_core.errors import BadMessage
from ogm_core.logs.recorded import Recorded, RecordedPose, RecordedScan, text_ranges
from ogm_core.types import Ranges
from ogm_core.wire.keys import NAME
from ogm_core.wire.messages import DEFAULT_MAX_BEAMS, pose_from_fields, scan_fields, scan_from_fields

_DEEP = 100
"""A line of more brackets is left to Python's reader, which lets them nest less deep."""
_NOT_FINITE = {"inf": math.inf, "-inf": -math.inf, "nan": math.nan}


def parse_line(
    line: bytes, *, range_max: float | None = None, max_beams: int = DEFAULT_MAX_BEAMS
) -> Recorded | None:
    """Read one line; None if it is blank. `range_max` (m) replaces a scan's own.

    Raises:
        BadMessage: it is not JSON, or not a well-formed message.
    """
    if not line.strip():
        return None
    if (fields := _quickly(line)) is not None:
        try:
            return _recorded(fields, range_max, max_beams)
        except BadMessage:
            pass  # of a whole number beyond 64 bits orjson makes a float; json says better what is wrong
    return _recorded(_fields(line), range_max, max_beams)


def _quickly(line: bytes) -> dict[str, Any] | None:
    """A line's fields as orjson reads them; None if they are left to `_fields`.

    What it refuses may be a line nevertheless: half a surrogate pair, a number beyond float64.
    """
    if line.count(b"[") + line.count(b"{") > _DEEP:
        return None
    try:
        fields = orjson.loads(line)
    except orjson.JSONDecodeError:
        return None
    return fields if isinstance(fields, dict) else None


def _fields(line: bytes) -> dict[str, Any]:
    try:
        fields = json.loads(line.decode(), parse_constant=_refuse_constant)
    except json.JSONDecodeError as error:
        raise BadMessage(f"not JSON ({error.msg}, column {error.colno})") from error
    except (ValueError, RecursionError) as error:
        raise BadMessage(f"not JSON ({error})") from error
    if not isinstance(fields, dict):
        raise BadMessage("not a JSON object")
    return fields


def _recorded(fields: dict[str, Any], range_max: float | None, max_beams: int) -> Recorded:
    """The message that a line's fields are."""
    match fields.get("type"):
        case "pose":
            return RecordedPose(_name(fields, "robot"), pose_from_fields(fields))
        case "scan":
            robot, sensor = _name(fields, "robot"), _name(fields, "sensor")
            if range_max is not None:
                fields["range_max"] = range_max
            ranges = _ranges(fields.get("ranges"))
            return RecordedScan(robot, sensor, scan_from_fields(fields, ranges, max_beams=max_beams))
        case other:
            raise BadMessage(f"type: 'pose' or 'scan' is needed, got {_shown(other)}")


def to_line(recorded: Recorded) -> str:
    """JSON form of a message, without the line's end; `parse_line` gives the same message, bit for bit."""
    fields: dict[str, Any]
    if isinstance(recorded, RecordedPose):
        message = recorded.message
        fields = {"type": "pose", "robot": recorded.robot, "stamp": message.stamp, "seq": message.seq}
        fields |= {"run": message.run, **message.pose._asdict()}
    else:
        fields = {"type": "scan", "robot": recorded.robot, "sensor": recorded.sensor}
        fields |= scan_fields(recorded.message)
        fields["ranges"] = _short(recorded.message.ranges)
    return json.dumps(fields, allow_nan=False, separators=(",", ":"))


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f'bare {text}; "inf", "-inf" and "nan" are strings, in ranges only')


def _shown(value: object) -> str:
    return repr(value) if isinstance(value, str | int | float) else type(value).__name__


def _name(fields: dict[str, Any], what: str) -> str:
    if what not in fields:
        raise BadMessage(f"{what}: missing")
    value = fields[what]
    if not isinstance(value, str) or not NAME.fullmatch(value):
        raise BadMessage(f"{what}: a name is 1 to 64 of A-Z a-z 0-9 _ - . , got {_shown(value)}")
    return value


def _ranges(values: object) -> Ranges:
    if not isinstance(values, list):
        raise BadMessage("ranges: a list is needed")
    if not set(map(type, values)) <= {float, int}:
        values = [_number(value, k) for k, value in enumerate(values)]
    try:
        return text_ranges(values)
    except OverflowError as error:
        raise BadMessage("ranges: a whole number is beyond float64") from error


def _number(value: object, k: int) -> float:
    if type(value) in (float, int):
        return cast(float, value)
    if isinstance(value, str) and value in _NOT_FINITE:
        return _NOT_FINITE[value]
    raise BadMessage(f"ranges[{k}]: a number, 'inf', '-inf' or 'nan' is needed, got {_shown(value)}")


def _short(ranges: Ranges) -> list[float | str]:
    """Numbers of few digits that read as these float32: 0.1, where the float32 is 0.10000000149...

    The shortest text of a float32 is read by way of float64; where rounding twice gave a neighbour, all
    digits are kept.
    """
    short = ranges.astype(str).astype(np.float64)
    with np.errstate(over="ignore"):
        chosen = np.where(short.astype(np.float32) == ranges, short, ranges.astype(np.float64))
    return [value if math.isfinite(value) else str(value) for value in chosen.tolist()]
