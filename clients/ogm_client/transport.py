"""Protocol of the transports to a mapper: questions by the names of the HTTP routes, bytes back."""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

from ogm_client.errors import BadReply, MapperError

NAMES = ("map.png", "map.json", "map.pgm", "map.yaml", "map.npz", "cell", "quality", "status")
"""What can be fetched from a mapper, over HTTP and over Zenoh alike."""

Parameters = Mapping[str, str]


class Version(NamedTuple):
    """One state of a map: the content can only differ where the version does."""

    epoch: str
    revision: int


class MapReply(NamedTuple):
    """map.npz and what it shows; `stamp` of the newest integrated scan, ns since the Unix epoch, or None."""

    npz: bytes
    version: Version
    stamp: int | None


class Transport(Protocol):
    """A connection to one mapper.

    Every method may raise CannotConnect, NobodyAnswered, MapperError, BadReply, or ClientError once closed.
    """

    def fetch(self, name: str, parameters: Parameters) -> bytes:
        """The bytes of one of NAMES."""

    def fetch_map(self, parameters: Parameters) -> MapReply:
        """map.npz with its version."""

    def fetch_map_after(self, seen: Version) -> MapReply | None:
        """map.npz, whole, if the map is no longer at version `seen`; else None."""

    def reset(self) -> None:
        """Empty the map."""

    def close(self) -> None:
        """Withdraw from the network; closing twice does nothing."""


def map_reply(npz: bytes, epoch: object, revision: object, stamp: object) -> MapReply:
    """Check what accompanies a map.

    Raises:
        BadReply: a value is missing or of the wrong type.
    """
    if not isinstance(epoch, str) or type(revision) is not int or not (stamp is None or type(stamp) is int):
        raise BadReply(
            f"map.npz: a text epoch, a whole revision and a whole or null stamp are needed, "
            f"got {epoch!r}, {revision!r} and {stamp!r}"
        )
    return MapReply(npz, Version(epoch, revision), stamp)


def json_object(what: str, payload: bytes) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        BadReply: it is something else; the text names `what`.
    """
    try:
        value = json.loads(payload)
    except ValueError as error:  # also a text that is not UTF-8
        raise BadReply(f"{what}: not JSON ({error})") from error
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
        case {"type": str(kind), "status": int(status)}:
            return MapperError(kind, status, str(problem.get("detail") or problem.get("title") or kind))
    raise BadReply(f"error reply to {what}: problem+json with type and status is needed, got {problem}")
