"""Placing state: all that decides where later messages go, as one value, and as bytes.

It is a value for each robot. Scans that wait for a pose are not part of it, only that they do: they are not
decided, and are to be handed in again after a placer has gone on from it. What such a scan has done to the
rules of its source, when it came, stays in the state: the source's newest stamp, a step back of its clock,
that its scans are held, its run, its seq. So when it comes again it does none of that a second time, and is
no `duplicate`: it takes the place among those that wait that it had, by the number of its message, and is
placed or dropped with them. Everything else that was taken is decided, and does not come again.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import msgpack
import numpy as np

from ogm_core.errors import BadInput
from ogm_core.placing.kept_poses import HistoryState

OF_GONE = "/gone"
"""Key of the outcomes of scans of robots that were forgotten; no robot has an empty name."""
VERSION = 1
"""Of the form of the bytes."""
CHUNK = 256
"""So many poses of a history, counted from its first, have bytes of their own: of a full chunk they stay."""


_HEAD = {"messages", "poses", "seqs", "gone", "sources", "waiting"}


class BadState(BadInput):
    """Bytes are no placing state, or not one of this version."""


@dataclass(frozen=True, slots=True, eq=False)
class RobotState:
    """State of one robot.

    `serial` is another one whenever something has changed. `life` and `histories` name the pose history.
    `head`: all but its poses. Within: `messages`, how many had come when it was taken, of all robots.
    """

    serial: int
    life: int
    histories: int
    head: Mapping[str, Any]
    history: HistoryState


PlacingState = Mapping[str, RobotState]
"""State of a placer, by robot; those of robots that have not changed are the same objects as before."""


class _Mark(NamedTuple):
    """What the bytes say of a robot: the rest is there already."""

    serial: int
    history: tuple[int, int]
    first: int
    end: int


class StateParts:
    """Bytes of a placing state, in parts with keys: of those only that have changed since the state before.

    A robot's first part has its name as key, "r"; chunks of its poses have "r/0", "r/1", ...
    """

    def __init__(self, before: PlacingState | None = None, of_gone: Mapping[str, int] | None = None) -> None:
        """`before`: the state of which all parts are there already, `of_gone`: the outcomes in OF_GONE."""
        self._of_gone = dict(of_gone or {})
        self._marks = {name: _mark(state) for name, state in (before or {}).items()}

    def changes(
        self, state: PlacingState, of_gone: Mapping[str, int] | None = None
    ) -> dict[str, bytes | None]:
        """The parts that are to be put, by key, and None where one is to be taken away.

        `of_gone`: outcomes of scans of robots that were forgotten, if that may have changed.
        """
        parts: dict[str, bytes | None] = {}
        if of_gone is not None and of_gone != self._of_gone:
            self._of_gone = dict(of_gone)
            parts[OF_GONE] = msgpack.packb(self._of_gone)
        marks = {name: _mark(robot) for name, robot in state.items()}
        for name, before in self._marks.items():
            if name not in marks:
                parts |= dict.fromkeys([name, *_keys(name, before)])
        for name, mark in marks.items():
            known = self._marks.get(name)
            if known is None or known.serial != mark.serial:
                parts |= _changes(name, state[name], mark, known)
        self._marks = marks
        return parts


def _mark(state: RobotState) -> _Mark:
    return _Mark(state.serial, (state.life, state.histories), state.history.first, state.history.end)


def _keys(name: str, mark: _Mark) -> list[str]:
    return [f"{name}/{k}" for k in _chunks(mark.first, mark.end)]


def _chunks(first: int, end: int) -> range:
    return range(first // CHUNK, -(-end // CHUNK) if end > first else first // CHUNK)


def _changes(name: str, state: RobotState, mark: _Mark, known: _Mark | None) -> dict[str, bytes | None]:
    """The parts of one robot that are other than those `known`."""
    parts: dict[str, bytes | None] = {} if known is None else dict.fromkeys(_keys(name, known))
    for k in _chunks(mark.first, mark.end):
        # A full chunk stays as it is once there is a pose after it: only the newest can become ambiguous.
        if (
            known is not None
            and known.history == mark.history
            and known.first // CHUNK <= k
            and known.end > (k + 1) * CHUNK
        ):
            del parts[f"{name}/{k}"]
        else:
            parts[f"{name}/{k}"] = _chunk(state.history, k)
    history = [state.life, state.histories, mark.first, mark.end]
    parts[name] = msgpack.packb([VERSION, history, state.head], default=_packed)
    return parts


def _packed(value: object) -> bytes:
    """An array of seqs, little-endian."""
    return np.asarray(value).astype("<i8").tobytes()


def _chunk(history: HistoryState, k: int) -> bytes:
    """The poses of chunk k: the number of its first, then their stamps, they, and which are ambiguous."""
    low, high = max(k * CHUNK - history.first, 0), min((k + 1) * CHUNK, history.end) - history.first
    first = np.array([history.first + low], "<i8").tobytes()
    stamps = np.asarray(history.stamps[low:high]).astype("<i8").tobytes()
    poses = np.asarray(history.poses[3 * low : 3 * high]).astype("<f8").tobytes()
    return first + stamps + poses + history.ambiguous[low:high]


def state_of(parts: Mapping[str, bytes]) -> dict[str, RobotState]:
    """The state whose parts these are.

    Raises:
        BadState: a part is missing, or is not what is written here; the text names the robot.
    """
    robots = {}
    for serial, (name, part) in enumerate((key, part) for key, part in parts.items() if "/" not in key):
        try:
            robots[name] = _robot_of(-1 - serial, name, part, parts)
        except BadState as error:
            raise BadState(f"placing state of robot {name}: {error}") from error
        except (KeyError, ValueError, TypeError, msgpack.UnpackException) as error:
            raise BadState(
                f"placing state of robot {name}: it is damaged, or parts of it are missing"
            ) from error
    return robots


def outcomes_of_gone(parts: Mapping[str, bytes]) -> dict[str, int]:
    """What became of scans of robots that were forgotten; nothing where no part tells.

    Raises:
        BadState: the part is not what is written here.
    """
    try:
        counts = msgpack.unpackb(parts[OF_GONE]) if OF_GONE in parts else {}
        return {str(outcome): int(count) for outcome, count in counts.items()}
    except (ValueError, TypeError, AttributeError, msgpack.UnpackException) as error:
        raise BadState("what was counted of robots that were forgotten is damaged") from error


def _robot_of(serial: int, name: str, part: bytes, parts: Mapping[str, bytes]) -> RobotState:
    version, (life, histories, first, end), head = msgpack.unpackb(part, strict_map_key=True)
    if version != VERSION:
        raise BadState(f"its form is version {version}, and this program knows {VERSION}: use a newer one")
    if not head.keys() >= _HEAD:
        raise ValueError("something else")
    stamps, poses, ambiguous = [], [], []
    at = first
    for k in _chunks(first, end):
        chunk = parts[f"{name}/{k}"]
        count = (len(chunk) - 8) // 33
        (begins,) = np.frombuffer(chunk, "<i8", 1).tolist()
        skipped, kept = at - begins, min((k + 1) * CHUNK, end) - begins
        if not (begins <= at and kept <= count):
            raise BadState(f"poses {at} to {end} are not all there")
        stamps.append(np.frombuffer(chunk, "<i8", count, 8)[skipped:kept])
        poses.append(np.frombuffer(chunk, "<f8", 3 * count, 8 + 8 * count)[3 * skipped : 3 * kept])
        ambiguous.append(chunk[8 + 32 * count :][skipped:kept])
        at = begins + kept
    history = HistoryState(
        first,
        np.concatenate(stamps or [np.empty(0)]).astype(np.int64),
        np.concatenate(poses or [np.empty(0)]).astype(np.float64),
        b"".join(ambiguous),
    )
    return RobotState(serial, life, histories, head, history)
