"""Answer of a service, over HTTP and Zenoh alike; light, so that simulators load no kernels to answer."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ogm_core.errors import BadInput, BadParameter, OgmError, cut

Parameters = Mapping[str, str]

NO_SNAPSHOTS = (
    "this mapper stores no map, and so has no snapshots: start it with a folder for them, --data DIR "
    "(mapper.data)"
)
"""What a `NotStored` says."""


def refuse_parameters(given: Parameters, name: str) -> None:
    """Refuse any parameter of what has none.

    Raises:
        BadParameter: there is one; the text names it.
    """
    if given:
        raise BadParameter(f"{cut(next(iter(given)))}: {name} has no parameters")


class UnknownName(OgmError):
    """Nothing of that name is served."""

    slug = "not-found"


class UnknownSnapshot(UnknownName):
    """No map is saved under that name."""

    slug = "unknown-snapshot"


class NameTaken(BadParameter):
    """A map is saved under that name already."""

    slug = "name-taken"


class NotStored(OgmError):
    """The mapper stores no map, so that none can be saved, now or later."""

    slug = "not-stored"


class NotSeparate(OgmError):
    """The map does not keep robots apart, so that none can be left out of it."""

    slug = "not-separate"


class Changed(OgmError):
    """The map is no longer the one that a request's If-Match names."""

    slug = "map-changed"


class CrossOrigin(OgmError):
    """A page of another origin asks a browser to change something here."""

    slug = "cross-origin"


class UpgradeRequired(OgmError):
    """A WebSocket is asked for by a request that is no handshake."""

    slug = "upgrade-required"


class BadHost(BadInput):
    """A request's Host is no name and no address."""

    slug = "bad-host"


class BadForwarded(BadInput):
    """What a proxy says of a request is not of the form that it has."""

    slug = "bad-forwarded"


class ForeignHost(OgmError):
    """A request asks for a host that is not this one."""

    slug = "misdirected"


class Unauthorized(OgmError):
    """A request that may change something does not carry the token that it needs."""

    slug = "unauthorized"


class TooManyGuesses(OgmError):
    """So many wrong tokens came from an address that no more is looked at for `wait` s."""

    slug = "too-many-guesses"

    def __init__(self, text: str, wait: int) -> None:
        super().__init__(text)
        self.wait = wait


class Busy(OgmError):
    """So many questions wait for an answer already that no more are taken."""

    slug = "busy"


class Unavailable(OgmError):
    """The mapper cannot do it now: it is stopping, far behind, or its disk fails. Later it may."""

    slug = "unavailable"


class PartOfMap(Unavailable):
    """A share of the map does not answer, and what is asked would mislead without it."""

    slug = "partial-map"


class OtherGateway(Unavailable):
    """Another gateway, which has been asked, too, can say it of the copy that is named in fewer words."""

    slug = "other-gateway"


class AskShares(OgmError):
    """A gateway cannot do it for the mappers of all shares."""

    slug = "not-by-gateway"


class Starting(Unavailable):
    """The mapper is not ready yet: it is still making its kernels ready."""

    slug = "starting"


@dataclass(frozen=True, slots=True)
class Answer:
    """A body, its media type, and for a map what `MapSnapshot.meta` says of it."""

    body: bytes
    media_type: str
    meta: dict[str, Any] | None = None

    @property
    def etag(self) -> str | None:
        """Strong validator of a map: its epoch, the mapper's run, and its revision.

        In place of that the tag of a map that several mappers have written; None if a part of it is missing.
        """
        meta = self.meta
        if meta is None or "missing" in meta:
            return None
        return f'"{meta["epoch"]}-{meta["run"]}-{meta.get("tag") or meta["revision"]}"'
