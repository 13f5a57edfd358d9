"""Missing shares: what a gateway says of the parts of a map that are not in its answer."""

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

from ogm_client.errors import BadReply

_ENTRY = re.compile(r"(?P<share>[0-9]{1,9});since=(?P<since>[0-9]{1,19})")
_NUMBER = re.compile(r"-?[0-9.]{1,24}(e[+-]?[0-9]{1,3})?")
_MOST = 1024

Bounds = tuple[float | None, float | None, float | None, float | None]


class MissingShare(NamedTuple):
    """A share of a map whose mapper does not answer.

    `since` when the gateway noticed it, ns since the Unix epoch; `bounds` of its rectangle, xmin, ymin, xmax,
    ymax, m, None where it is open.
    """

    share: int
    since: int
    bounds: Bounds


def in_headers(headers: Mapping[str, str]) -> tuple[MissingShare, ...]:
    """The shares that the headers of an HTTP answer name.

    Raises:
        BadReply: they are ill-formed.
    """
    told = headers.get("OGM-Missing")
    if told is None:
        return ()
    entries, bounds = told.split(","), headers.get("OGM-Missing-Bounds", "").split(";")
    if len(entries) != len(bounds) or len(entries) > _MOST:
        raise BadReply("OGM-Missing: shares, and their bounds in OGM-Missing-Bounds, are needed")
    return tuple(map(_of_texts, entries, bounds))


def in_attachment(told: Mapping[str, object]) -> tuple[MissingShare, ...]:
    """The shares that are named by what goes with a map over Zenoh.

    Raises:
        BadReply: they are ill-formed.
    """
    entries = told.get("missing", [])
    if not isinstance(entries, list) or len(entries) > _MOST:
        raise BadReply("missing: a list of shares is needed")
    return tuple(map(_of_object, entries))


def _of_texts(entry: str, bounds: str) -> MissingShare:
    match, edges = _ENTRY.fullmatch(entry.strip()), bounds.strip().split(",")
    if match is None or len(edges) != 4 or not all(not edge or _NUMBER.fullmatch(edge) for edge in edges):
        raise BadReply("OGM-Missing: K;since=STAMP, and xmin,ymin,xmax,ymax, are needed")
    xmin, ymin, xmax, ymax = (float(edge) if edge else None for edge in edges)
    return MissingShare(int(match["share"]), int(match["since"]), (xmin, ymin, xmax, ymax))


def _of_object(entry: Any) -> MissingShare:  # noqa: ANN401 (whatever was sent)
    match entry:
        case {"share": int(share), "since": int(since), "bounds": [xmin, ymin, xmax, ymax]} if all(
            edge is None or type(edge) in (int, float) for edge in (xmin, ymin, xmax, ymax)
        ):
            return MissingShare(share, since, (xmin, ymin, xmax, ymax))
    raise BadReply("missing: share, bounds and since of each are needed")
