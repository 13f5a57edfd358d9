"""JSON lines logs: a message's fields, "type", "robot" and, for scans, "sensor", one message a line.

`ranges` is a list of numbers, read as float32; "inf", "-inf" and "nan" stand in it as strings, or as Python
writes them: Infinity, -Infinity, NaN.
"""

import json
import math
from dataclasses import replace
from typing import Any, cast

import orjson

from ogm_core.errors import BadMessage
from ogm_core.logs.recorded import Recorded, RecordedPose, RecordedScan, no_returns, text_ranges
from ogm_core.types import Ranges
from ogm_core.wire.keys import NAME
from ogm_core.wire.messages import DEFAULT_MAX_BEAMS, pose_from_fields, scan_from_fields

_DEEP = 100
"""A line of more brackets is left to Python's reader, which lets them nest less deep."""
_NOT_FINITE = {"inf": math.inf, "-inf": -math.inf, "nan": math.nan}


class JsonLog:
    """Reads the lines of one log, in their order.

    `range_max` (m) replaces a scan's own; ranges at or above it are then infinite, "no return". A message
    without `seq` gets the number after the largest so far of its robot's poses, or of its sensor's scans, in
    its run.
    """

    def __init__(self, *, range_max: float | None = None, max_beams: int = DEFAULT_MAX_BEAMS) -> None:
        self._range_max = range_max
        self._max_beams = max_beams
        self._next: dict[tuple[str, str | None, str], int] = {}
        """The next seq of a robot's poses (None), or of a sensor's scans, in a run."""

    def parse_line(self, line: bytes) -> Recorded | None:
        """Read one line; None if it is blank.

        Raises:
            BadMessage: it is not JSON, or not a well-formed message.
        """
        if not line.strip():
            return None
        if (fields := _quickly(line)) is not None:
            try:
                return self.recorded(fields)
            except BadMessage:
                pass  # of a whole number beyond 64 bits orjson makes a float; json says better what is wrong
        return self.recorded(_fields(line))

    def recorded(self, fields: dict[str, Any]) -> Recorded:
        """The message that a line's fields are; BadMessage if they are none."""
        counted = "seq" not in fields
        if counted:
            fields["seq"] = 0
        recorded = self._message(fields)
        sensor = recorded.sensor if isinstance(recorded, RecordedScan) else None
        source = recorded.robot, sensor, recorded.message.run
        if counted:
            recorded = _numbered(recorded, self._next.get(source, 0))
        self._next[source] = max(self._next.get(source, 0), recorded.message.seq + 1)
        return recorded

    def _message(self, fields: dict[str, Any]) -> Recorded:
        match fields.get("type"):
            case "pose":
                return RecordedPose(_name(fields, "robot"), pose_from_fields(fields))
            case "scan":
                robot, sensor = _name(fields, "robot"), _name(fields, "sensor")
                ranges = _ranges(fields.get("ranges"))
                if self._range_max is not None:
                    fields["range_max"] = self._range_max
                    ranges = no_returns(ranges, self._range_max)
                return RecordedScan(
                    robot, sensor, scan_from_fields(fields, ranges, max_beams=self._max_beams)
                )
            case other:
                raise BadMessage(f"type: 'pose' or 'scan' is needed, got {_shown(other)}")


def _numbered(recorded: Recorded, seq: int) -> Recorded:
    if isinstance(recorded, RecordedPose):
        return replace(recorded, message=replace(recorded.message, seq=seq))
    return replace(recorded, message=replace(recorded.message, seq=seq))


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
        fields = json.loads(line.decode())
    except json.JSONDecodeError as error:
        raise BadMessage(f"not JSON ({error.msg}, column {error.colno})") from error
    except (ValueError, RecursionError) as error:
        raise BadMessage(f"not JSON ({error})") from error
    if not isinstance(fields, dict):
        raise BadMessage("not a JSON object")
    return fields


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
