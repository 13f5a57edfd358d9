"""Pose and Scan messages: MessagePack on the wire, and the field rules that recordings share.

`decode_*` and `*_from_fields` are the one place where a message is validated; nothing is repaired.
"""

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, TypeVar

import msgpack
import numpy as np

from ogm_core.errors import BadMessage
from ogm_core.types import IDENTITY, Pose, PoseStamped, Ranges, Scan
from ogm_core.wire.keys import MAX_NAME, NAME

MEDIA_TYPE = "application/msgpack"
POSE_SCHEMA = "ogm.Pose.v1"
SCAN_SCHEMA = "ogm.Scan.v1"
MAX_RANGE = 1000.0
"""The largest `range_max`, m."""
DEFAULT_MAX_BEAMS = 200_000
MAX_POSE_BYTES = 1024
"""The longest pose message."""
_SCAN_BYTES_BESIDES = 4096
"""What a scan message takes beside its ranges, at most."""
MAX_ITEMS = 64
"""A list or map in a message has at most so many items, and a message twice so many lists and maps."""
MAX_TEXT = 1024
"""The longest text in a message, bytes of UTF-8."""
INT_END = 2**63
"""Stamps and seqs are below it."""

Fields = Mapping[str, Any]
_Part = TypeVar("_Part")


def encode_pose(message: PoseStamped) -> bytes:
    """MessagePack form of a pose message."""
    x, y, theta = message.pose
    fields = {"stamp": message.stamp, "seq": message.seq, "run": message.run, "x": x, "y": y, "theta": theta}
    return bytes(msgpack.packb(fields))


def encode_scan(scan: Scan) -> bytes:
    """MessagePack form of a scan message; ranges as little-endian float32."""
    fields = scan_fields(scan)
    fields["ranges"] = scan.ranges.astype("<f4", copy=False).tobytes()
    return bytes(msgpack.packb(fields))


def scan_fields(scan: Scan) -> dict[str, Any]:
    """Every field of a scan message but `ranges`, whose form differs between wire and recording."""
    fields: dict[str, Any] = {
        "stamp": scan.stamp,
        "seq": scan.seq,
        "run": scan.run,
        "angle_min": scan.angle_min,
        "angle_increment": scan.angle_increment,
        "time_increment": scan.time_increment,
        "range_min": scan.range_min,
        "range_max": scan.range_max,
        "mount": list(scan.mount),
    }
    if scan.pose is not None:
        fields["pose"] = list(scan.pose)
    return fields


def max_scan_bytes(max_beams: int) -> int:
    """The longest message of a scan of up to `max_beams` beams, bytes."""
    return 4 * max_beams + _SCAN_BYTES_BESIDES


def check_length(length: int, longest: int) -> None:
    """Check how long a message is, which can be told before it is copied; lengths in bytes.

    Raises:
        BadMessage: it is longer than any of its kind.
    """
    if length > longest:
        raise BadMessage(f"payload: at most {longest} bytes are needed, got {length}")


def decode_pose(payload: bytes) -> PoseStamped:
    """Read a pose message.

    Raises:
        BadMessage: it is not one; the text names the field.
    """
    message = pose_from_fields(unpacked_fields(payload))
    check_length(len(payload), MAX_POSE_BYTES)
    return message


def decode_scan(payload: bytes, *, max_beams: int = DEFAULT_MAX_BEAMS) -> Scan:
    """Read a scan message; its ranges are a view of `payload`.

    Raises:
        BadMessage: it is not one; the text names the field.
    """
    fields = unpacked_fields(payload)
    ranges = _required(fields, "ranges")
    if not isinstance(ranges, bytes):
        raise BadMessage(f"ranges: bytes of little-endian float32 are needed, got {_kind(ranges)}")
    if len(ranges) % 4:
        raise BadMessage(f"ranges: {len(ranges)} bytes are not a whole number of float32")
    scan = scan_from_fields(fields, np.frombuffer(ranges, "<f4"), max_beams=max_beams)
    check_length(len(payload), max_scan_bytes(max_beams))
    return scan


def glance(payload: bytes) -> tuple[Ranges, float, float, float] | None:
    """What a scan message says of its size, unchecked: ranges, angle_increment, range_min, range_max.

    None if it is none, so that `decode_scan` will not read it either.
    """
    try:
        fields = unpacked_fields(payload)
        ranges = np.frombuffer(fields["ranges"], "<f4")
        return (
            ranges,
            float(fields["angle_increment"]),
            float(fields["range_min"]),
            float(fields["range_max"]),
        )
    except (BadMessage, KeyError, TypeError, ValueError, OverflowError):
        return None


def numbering(payload: bytes) -> tuple[int, int, str]:
    """Stamp, seq and run of a pose or scan message, whatever the rest of it is.

    Raises:
        BadMessage: one of them is missing, of the wrong type or out of range.
    """
    fields = unpacked_fields(payload)
    return _count(fields, "stamp"), _count(fields, "seq"), _run(fields)


def pose_from_fields(fields: Fields) -> PoseStamped:
    """Check a pose message's fields.

    Raises:
        BadMessage: a field is missing, of the wrong type or out of range.
    """
    pose = Pose(_number(fields, "x"), _number(fields, "y"), _number(fields, "theta"))
    return PoseStamped(_count(fields, "stamp"), pose, _count(fields, "seq"), _run(fields))


def scan_from_fields(fields: Fields, ranges: Ranges, *, max_beams: int = DEFAULT_MAX_BEAMS) -> Scan:
    """Check a scan message's fields; `ranges` are read already, float32, shape (N,).

    Raises:
        BadMessage: a field is missing, of the wrong type or out of range.
    """
    if not 0 < ranges.size <= max_beams:
        raise BadMessage(f"ranges: 1 to {max_beams} beams are needed, got {ranges.size}")
    scan = Scan(
        stamp=_count(fields, "stamp"),
        seq=_count(fields, "seq"),
        run=_run(fields),
        angle_min=_number(fields, "angle_min"),
        angle_increment=_number(fields, "angle_increment"),
        time_increment=_number(fields, "time_increment", 0.0),
        range_min=_number(fields, "range_min"),
        range_max=_number(fields, "range_max"),
        ranges=ranges,
        mount=_pose(fields, "mount") or IDENTITY,
        pose=_pose(fields, "pose"),
    )
    check_scan(scan)
    return scan


def check_scan(scan: Scan) -> None:
    """Check what holds between a scan's fields.

    Raises:
        BadMessage: range_min and range_max, or the bearings, make no sense.
    """
    if scan.angle_increment == 0.0 and scan.ranges.size > 1:
        raise BadMessage("angle_increment: it must not be 0, unless there is one beam")
    if not math.isfinite(scan.angle_min + (scan.ranges.size - 1) * scan.angle_increment):
        raise BadMessage("angle_increment: the last beam's bearing is not finite")
    if not math.isfinite((scan.ranges.size - 1) * scan.time_increment * 1e9):
        raise BadMessage("time_increment: the last beam's stamp is not finite")
    if not 0.0 <= scan.range_min < scan.range_max:
        raise BadMessage(
            f"range_min: 0 <= range_min < range_max is needed, got {scan.range_min:g} and {scan.range_max:g}"
        )
    if scan.range_max > MAX_RANGE:
        raise BadMessage(f"range_max: at most {MAX_RANGE:g} m, got {scan.range_max:g}")


def unpacked_fields(payload: bytes) -> Fields:
    """The fields of any message, unchecked; lists, maps and texts in it are few and short.

    Raises:
        BadMessage: it is no MessagePack map, or holds more.
    """
    take = _counted()
    try:
        fields = msgpack.unpackb(
            payload,
            max_array_len=MAX_ITEMS,
            max_map_len=MAX_ITEMS,
            max_str_len=MAX_TEXT,
            max_ext_len=0,
            strict_map_key=True,
            list_hook=take,
            object_hook=take,
        )
    except (ValueError, TypeError, OverflowError, RecursionError, msgpack.UnpackException) as error:
        raise BadMessage(f"payload: not MessagePack ({str(error) or type(error).__name__})") from error
    if not isinstance(fields, dict):
        raise BadMessage(f"payload: a MessagePack map is needed, got {_kind(fields)}")
    return fields


def _counted() -> Callable[[_Part], _Part]:
    """What lets pass so many lists and maps of one message: few bytes may hold millions of them."""
    left = 2 * MAX_ITEMS

    def take(part: _Part) -> _Part:
        nonlocal left
        left -= 1
        if left < 0:
            raise BadMessage(f"payload: it holds more than {2 * MAX_ITEMS} lists and maps")
        return part

    return take


def _kind(value: object) -> str:
    return "null" if value is None else type(value).__name__


def _required(fields: Fields, name: str) -> Any:  # noqa: ANN401 - whatever was sent
    if name not in fields:
        raise BadMessage(f"{name}: missing")
    return fields[name]


def _finite(value: object, name: str) -> float:
    if type(value) not in (int, float):
        raise BadMessage(f"{name}: a number is needed, got {_kind(value)}")
    try:
        number = float(value)  # type: ignore[arg-type]  # int or float, as just checked
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise BadMessage(f"{name}: a finite number is needed, got {value}")
    return number


def _number(fields: Fields, name: str, default: float | None = None) -> float:
    value = fields.get(name, default)
    if type(value) is float and math.isfinite(value):  # as nearly always; a scan has many of them
        return value
    return _finite(_required(fields, name), name)


def _count(fields: Fields, name: str) -> int:
    value = fields.get(name)
    if type(value) is int and 0 <= value < INT_END:
        return value
    value = _required(fields, name)
    if type(value) is not int:
        raise BadMessage(f"{name}: a whole number is needed, got {_kind(value)}")
    raise BadMessage(f"{name}: 0 to 2^63 - 1 is needed, got {value}")


def _run(fields: Fields) -> str:
    value = fields.get("run", "")
    if not isinstance(value, str):
        raise BadMessage(f"run: text is needed, got {_kind(value)}")
    if value and not _is_name(value):
        shown = value if len(value) <= MAX_NAME else value[:MAX_NAME] + "..."
        raise BadMessage(f"run: 1 to {MAX_NAME} of A-Z a-z 0-9 _ - . are needed, or none, got {shown!r}")
    return value


@lru_cache(1024)
def _is_name(text: str) -> bool:
    """Whether a text may name a run: each does in many messages."""
    return NAME.fullmatch(text) is not None


def _pose(fields: Fields, name: str) -> Pose | None:
    value = fields.get(name)
    if value is None and name not in fields:
        return None
    if not isinstance(value, list) or len(value) != 3:
        raise BadMessage(f"{name}: [x, y, theta] is needed")
    x, y, theta = value
    if type(x) is type(y) is type(theta) is float and all(map(math.isfinite, value)):
        return Pose(x, y, theta)
    return Pose(*(_finite(part, f"{name}[{i}]") for i, part in enumerate(value)))
