"""What the client library raises on purpose.

OgmError
+-- ClientError           talking to a mapper, or to the network, failed: the text says what to check
    +-- CannotConnect     nothing takes connections at the address
    +-- CannotListen      an address to listen on is taken, or is not this machine's
    +-- NobodyAnswered    connected, but no mapper of that map answered in time
    +-- NotHeard          a mapper answers, and hears nothing of what the robot publishes
    +-- MapperError       the mapper refused the request: `type`, `status`, `detail`
    +-- BadReply          the answer is not what a mapper answers
    +-- PartialMap        a share of the map is missing: what is there is in `map`

What is wrong with the caller's own values is a `BadInput`: `BadMessage`, `BadParameter` or `BadSetting`,
raised before anything is sent; of files, `BadMapFile` or `BadRecording`; of a package that is not installed,
`MissingExtra`. They, `MapEmpty` and `DiskFull` are importable from `ogm_client`.
"""

from typing import TYPE_CHECKING

from ogm_core.errors import OgmError
from ogm_core.status import RobotStatus

if TYPE_CHECKING:
    from ogm_client.map_grid import MapGrid
    from ogm_client.missing_shares import MissingShare


class ClientError(OgmError):
    """Talking to a mapper, or to the network, failed; the text says what to check."""

    slug = "client-error"


class CannotConnect(ClientError):
    """Nothing takes connections at the address."""

    slug = "cannot-connect"


class CannotListen(ClientError):
    """An address to listen on is taken, or is not this machine's."""

    slug = "cannot-listen"


class NobodyAnswered(ClientError):
    """Connected, but no mapper of that map answered in time."""

    slug = "nobody-answered"


_EARLY = 0.05
"""How much before its time a question may end that was waited for, s."""


def nobody(
    map_name: str, where: str, timeout: float, waited: float, *, secured: bool = False
) -> NobodyAnswered:
    """Say that no mapper of the map answered, and what to check.

    `where` is "at ADDRESS", or what else says how it was asked; `timeout` and `waited` in seconds: Zenoh ends
    a question at once that it hands to nobody; `secured`: certificates say who may ask.
    """
    within = f" within {timeout:g} s" if waited >= timeout - _EARLY else ""
    denied = ", or does access control not let this certificate ask?" if secured else "?"
    return NobodyAnswered(
        f"no mapper of map {map_name!r} answered {where}{within}: "
        "is `ogm mapper`, or `ogm gateway` if the map is cut into shares, running there, "
        f"with --map {map_name}{denied}"
    )


class NotHeard(ClientError):
    """A mapper answers, and hears nothing of what a robot publishes; `status`: what it says of the robot."""

    slug = "not-heard"

    def __init__(self, text: str, status: RobotStatus) -> None:
        super().__init__(text)
        self.status = status


class MapperError(ClientError):
    """The mapper refused a request, with an error reply or with problem+json.

    `type` is the stable name of the kind of error ("map-empty", "bad-parameter", ...), `status` the HTTP
    status code (Zenoh error replies carry the same), `detail` what was wrong, in words.
    """

    slug = "mapper-error"

    def __init__(self, kind: str, status: int, detail: str) -> None:
        super().__init__(f"the mapper refused: {detail} ({kind}, {status})")
        self.type = kind
        self.status = status
        self.detail = detail


class BadReply(ClientError):
    """The answer is not what a mapper answers."""

    slug = "bad-reply"


class PartialMap(ClientError):
    """A map of which shares are missing, as their mappers do not answer: there, all cells are unknown.

    `map` is what is there, a `MapGrid`, or the file that was fetched; `missing` the shares, each with its
    `share`, `bounds` and `since`.
    """

    slug = "partial-map"

    def __init__(self, part: "MapGrid | bytes", missing: "tuple[MissingShare, ...]") -> None:
        shares = ", ".join(str(each.share) for each in missing)
        super().__init__(
            f"share {shares} of the map is missing: ask again in a few seconds, or take what is there, "
            "by ?complete=0 behind the file's name, or get_map(partial=True)"
        )
        self.map = part
        self.missing = missing
