"""Protocol of the transports to a mapper: questions by the names of the HTTP routes, bytes back."""

import json
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, NoReturn, Protocol

from ogm_client.errors import BadReply, MapperError
from ogm_client.missing_shares import MissingShare
from ogm_core import errors
from ogm_core.units import MEBIBYTE
from ogm_core.wire.keys import Query, Write

NAMES = (
    *("map.png", "map.pgw", "map.json", "map.pgm", "map.yaml", "map.npz", "map.tiles"),
    *("cell", "quality", "status", "snapshots", "raycast"),
    *("distance.png", "distance.npz", "inflate.png", "inflate.npz"),
)
"""What can be fetched from a mapper, over HTTP and over Zenoh alike."""

Parameters = Mapping[str, str]

MAX_FIGURES_BYTES = 16 * MEBIBYTE
"""The longest status, figures of quality or cell, bytes: a thousand robots' status is half of it."""
MAX_PROBLEM_BYTES = 64 * 1024
"""The longest error reply, bytes."""
_MAX_ID = 128
_SHOWN = 300


class Limits(NamedTuple):
    """What an answer may take: seconds from the question to its last byte, and bytes, unpacked ones too."""

    timeout: float
    max_bytes: int

    def bytes_of(self, name: str) -> int:
        """The longest answer to one of NAMES."""
        return self.max_bytes if "." in name else min(self.max_bytes, MAX_FIGURES_BYTES)


class Version(NamedTuple):
    """One state of a map: the content can only differ where the version does."""

    epoch: str
    run: str
    """Of the mapper's process; "" of an older mapper, which does not tell it."""
    revision: int

    def is_before(self, other: "Version") -> bool:
        """Whether the other one is what this one came to, or itself: of one life, and not older."""
        return self[:2] == other[:2] and self.revision <= other.revision


class MapReply(NamedTuple):
    """map.npz, or another archive, and what it shows.

    `stamp` of the newest integrated scan, ns since the Unix epoch, or None.
    """

    npz: bytes
    version: Version
    stamp: int | None
    missing: tuple[MissingShare, ...] = ()
    """Of a map of which a part is not there, which is of no version."""


class Transport(Protocol):
    """A connection to one mapper.

    Every method may raise CannotConnect, NobodyAnswered, MapperError, BadReply, or ClientError once closed.
    """

    def fetch(self, name: str, parameters: Parameters) -> bytes:
        """The bytes of one of NAMES.

        Raises:
            PartialMap: a share of the map is missing, and `complete` is not among the parameters.
        """

    def fetch_map(self, parameters: Parameters, name: str = "map.npz") -> MapReply:
        """map.npz, or another archive of those NAMES, with its version."""

    def ask(self, name: Query, body: bytes) -> bytes:
        """What is answered to a question that is a JSON body."""

    def write(self, name: Write, parameters: Parameters) -> bytes:
        """Change something; the bytes of what is answered."""

    def hear_updates(self, heard: Callable[[bytes], None]) -> Callable[[], None]:
        """Have every update that the mapper puts handed to `heard`, on whichever thread; what ends that.

        Over HTTP nothing is put.
        """

    def close(self) -> None:
        """Withdraw from the network; closing twice does nothing."""


def too_long(what: str, limit: int) -> BadReply:
    """Say that an answer is longer than `limit`, bytes."""
    return BadReply(f"{what}: longer than {limit} bytes, the most that is read of it (max_bytes, for maps)")


def partial_reply(npz: bytes, missing: tuple[MissingShare, ...], stamp: object) -> MapReply:
    """What accompanies a map of which a part is missing, checked.

    Raises:
        BadReply: the stamp is of the wrong type.
    """
    reply = map_reply(npz, "", "", 0, stamp)
    return reply._replace(missing=missing)


def map_reply(npz: bytes, epoch: object, run: object, revision: object, stamp: object) -> MapReply:
    """Check what accompanies a map.

    Raises:
        BadReply: a value is missing or of the wrong type.
    """
    epoch, run = _plain("epoch", epoch), _plain("run", "" if run is None else run)
    if type(revision) is not int or not (stamp is None or type(stamp) is int):
        raise BadReply(
            f"map.npz: a whole revision and a whole or null stamp are needed, "
            f"got {printable(f'{revision!r} and {stamp!r}')}"
        )
    return MapReply(npz, Version(epoch, run, revision), stamp)


def json_object(what: str, payload: bytes) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        BadReply: it is something else; the text names `what`.
    """
    try:
        value = json.loads(payload, parse_constant=_no_number)
    except RecursionError as error:
        raise BadReply(f"{what}: not JSON that can be read (nested too deep)") from error
    except ValueError as error:  # also a text that is not UTF-8
        raise BadReply(f"{what}: not JSON ({printable(str(error))})") from error
    if not isinstance(value, dict):
        raise BadReply(f"{what}: a JSON object is needed, got {type(value).__name__}")
    return value


def mapper_error(what: str, payload: bytes) -> MapperError:
    """Read the problem+json (RFC 9457) with which the mapper refused `what`.

    Raises:
        BadReply: it is not one.
    """
    problem = json_object(f"error reply to {what}", payload)
    match problem:
        case {"type": str(kind), "status": int(status)} if 400 <= status < 600:
            detail = str(problem.get("detail") or problem.get("title") or kind)
            return MapperError(printable(kind), status, printable(detail))
    raise BadReply(
        f"error reply to {what}: problem+json with type and status is needed, got {printable(repr(problem))}"
    )


def printable(text: str) -> str:
    """What a stranger says, for a terminal: one line, not long, without characters that steer it."""
    line = " ".join(text[: 2 * _SHOWN].split())
    shown = errors.printable(line)
    return shown if len(shown) <= _SHOWN else f"{shown[:_SHOWN]}..."


def _plain(name: str, text: object) -> str:
    if not isinstance(text, str) or not (text.isascii() and text.isprintable()) or len(text) > _MAX_ID:
        raise BadReply(f"map.npz: a plain text is needed as {name}, got {printable(repr(text))}")
    return text


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number of JSON's")
