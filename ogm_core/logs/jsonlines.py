"""JSON lines logs: a message's fields, "type", "robot" and, for scans, "sensor", one message a line.

`ranges` is a list of numbers, read as float32; "inf", "-inf" and "nan" stand in it as strings.
"""

import json
import math
import re
from typing import Any, NoReturn, cast

import numpy as np

from ogm_core.errors import BadMessage
from ogm_core.logs.recorded import ReadDecimals, Recorded, RecordedPose, RecordedScan, text_ranges
from ogm_core.types import Ranges
from ogm_core.wire.keys import NAME
from ogm_core.wire.messages import DEFAULT_MAX_BEAMS, pose_from_fields, scan_fields, scan_from_fields

_RANGES = re.compile(rb'"ranges"\s*:\s*\[')
_NOT_FINITE = {"inf": math.inf, "-inf": -math.inf, "nan": math.nan}


def parse_line(
    line: bytes,
    *,
    range_max: float | None = None,
    max_beams: int = DEFAULT_MAX_BEAMS,
    decimals: ReadDecimals | None = None,
) -> Recorded | None:
    """Read one line; None if it is blank. `range_max` (m) replaces a scan's own.

    `decimals` reads the ranges of most scans at once; without it, and where it cannot, JSON's reader does.

    Raises:
        BadMessage: it is not JSON, or not a well-formed message.
    """
    if not line.strip():
        return None
    if decimals is not None and (cut := _cut(line, decimals)) is not None:
        try:
            return _recorded(*cut, range_max, max_beams)
        except BadMessage:
            pass  # the whole line says better what is wrong
    return _recorded(_fields(line), None, range_max, max_beams)


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


def _cut(line: bytes, decimals: ReadDecimals) -> tuple[dict[str, Any], Ranges] | None:
    """A scan's fields, and its ranges read at once; None if that cannot be, or the line is not JSON."""
    found = _RANGES.search(line)
    end = -1 if found is None else line.find(b"]", found.end())
    # Without a backslash what looks like this name is it; once in the line, and at its top, it is the scan's.
    if found is None or end < 0 or b"\\" in line or line.count(b'"ranges"') > 1:
        return None
    text = line[found.end() : end]
    ranges_and_end = decimals(text, text.count(b",") + 1, commas=True)
    if ranges_and_end is None or text[ranges_and_end[1] :].strip(b" \t"):
        return None
    try:
        fields = _fields(line[: found.end()] + line[end:])
    except BadMessage:
        return None
    return (fields, ranges_and_end[0]) if "ranges" in fields else None


def _recorded(
    fields: dict[str, Any], ranges: Ranges | None, range_max: float | None, max_beams: int
) -> Recorded:
    """The message that a line's fields are; `ranges`, if they were read already."""
    match fields.get("type"):
        case "pose":
            return RecordedPose(_name(fields, "robot"), pose_from_fields(fields))
        case "scan":
            robot, sensor = _name(fields, "robot"), _name(fields, "sensor")
            if range_max is not None:
                fields["range_max"] = range_max
            if ranges is None:
                ranges = _ranges(fields.get("ranges"))
            scan = scan_from_fields(fields, ranges, max_beams=max_beams)
            return RecordedScan(robot, sensor, scan)
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
