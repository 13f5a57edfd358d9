"""A mapper's reply to the question for its status, as values; read by hand, for pydantic is not light."""

from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from types import UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from ogm_client.errors import BadReply
from ogm_client.transport import json_object, printable
from ogm_core.status import Erasure, Forgotten, SnapshotInfo, SnapshotList, Status
from ogm_core.types import Pose

_WORDS = {
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    Pose: "[x, y, theta]",
}
_END = 2**64
"""Numbers are smaller, whatever their sign; an infinite one is not, and NaN is neither."""
_T = TypeVar("_T")


def read_status(payload: bytes) -> Status:
    """A status of what `GET /status` answers, of a mapper of any version.

    What only a newer mapper says is passed over; what an older one does not say yet has its default.

    Raises:
        BadReply: it lacks what every mapper says, or has something else in its place.
    """
    status: Status = _value(Status, json_object("status", payload), ("status",))
    return status


def read_snapshot(payload: bytes) -> SnapshotInfo:
    """What is told of one saved map.

    Raises:
        BadReply: it is something else.
    """
    snapshot: SnapshotInfo = _value(SnapshotInfo, json_object("save", payload), ("save",))
    return snapshot


def read_erasure(payload: bytes) -> Erasure:
    """What is told of what has been erased.

    Raises:
        BadReply: it is something else.
    """
    erasure: Erasure = _value(Erasure, json_object("erase", payload), ("erase",))
    return erasure


def read_forgotten(payload: bytes) -> Forgotten:
    """What is told of a map that a robot was left out of.

    Raises:
        BadReply: it is something else.
    """
    forgotten: Forgotten = _value(Forgotten, json_object("forget", payload), ("forget",))
    return forgotten


def read_snapshots(payload: bytes) -> list[SnapshotInfo]:
    """The saved maps of what `GET /snapshots` answers.

    Raises:
        BadReply: it is something else.
    """
    listed: SnapshotList = _value(SnapshotList, json_object("snapshots", payload), ("snapshots",))
    return listed.snapshots


def read_reply(kind: type[_T], what: str, payload: bytes) -> _T:
    """A JSON object as a dataclass; the text of an error names `what`.

    Raises:
        BadReply: it is something else.
    """
    reply: _T = _value(kind, json_object(what, payload), (what,))
    return reply


def _value(kind: Any, given: Any, path: tuple[str, ...]) -> Any:  # noqa: ANN401 - JSON, and what is made of it
    """What JSON says, as a `kind`; the path says where it stands."""
    if get_origin(kind) is Literal:  # who asked looks whether it is one of the words
        kind = str
    if isinstance(kind, UnionType):  # of something and None
        return None if given is None else _value(get_args(kind)[0], given, path)
    if kind is Pose and isinstance(given, list) and len(given) == 3:
        return Pose(*(_value(float, part, path) for part in given))
    match get_origin(kind) or kind, given:
        case origin, dict() if origin is dict:
            inner = get_args(kind)[1]
            return {_text(name, path): _value(inner, part, (*path, name)) for name, part in given.items()}
        case origin, list() if origin is list:
            inner = get_args(kind)[0]
            return [_value(inner, part, path) for part in given]
        case part, dict() if is_dataclass(part):
            return _part(kind, given, path)
    if kind is str and type(given) is str:
        return _text(given, path)
    if type(given) is kind or (kind is float and type(given) is int):
        if not -_END < given < _END:
            raise _misread(path, "a number below 2^64 is needed")
        return kind(given)
    raise _misread(path, f"{_WORDS.get(kind, 'something else')} is needed, got {type(given).__name__}")


def _part(kind: Any, given: dict[str, Any], path: tuple[str, ...]) -> Any:  # noqa: ANN401 - a dataclass
    """A part of the status: its fields by name."""
    values = {}
    for name, (inner, required) in _fields(kind).items():
        if name in given:
            values[name] = _value(inner, given[name], (*path, name))
        elif required:
            raise _misread((*path, name), "missing")
    return kind(**values)


def _text(text: str, path: tuple[str, ...]) -> str:
    """A text that may be shown on a terminal, which some characters would steer."""
    if not text.isprintable():
        raise _misread(path, "a text has characters that cannot be shown")
    return text


@cache
def _fields(kind: Any) -> dict[str, tuple[Any, bool]]:  # noqa: ANN401 - a dataclass
    """Type of every field, and whether every mapper says it."""
    hints = get_type_hints(kind)
    return {
        field.name: (hints[field.name], field.default is MISSING and field.default_factory is MISSING)
        for field in fields(kind)
    }


def _misread(path: tuple[str, ...], what: str) -> BadReply:
    where, *inside = path
    return BadReply(f"{where}: {printable('.'.join(inside))}: {what}; is that a mapper of another version?")
