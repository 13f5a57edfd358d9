"""Problem details (RFC 9457): how errors are told, the same over HTTP and in Zenoh error replies.

The one place where their bodies are made. What brings a body to who has asked is each way's own: the headers
of a response in `mapper/serving/refusals.py`, the bytes of one below the application in `http_connection.py`,
a thread that may wait for links in `replies/error_replies.py`.
"""

import http
import json

from ogm_core.errors import BadInput, BadStore, DiskFull, MapEmpty, OgmError, UnknownRobot
from ogm_services.replies.answer import (
    AskShares,
    Busy,
    Changed,
    CrossOrigin,
    ForeignHost,
    NameTaken,
    NotSeparate,
    NotStored,
    TooManyGuesses,
    Unauthorized,
    Unavailable,
    UnknownName,
    UpgradeRequired,
)

MEDIA_TYPE = "application/problem+json"

# First match wins.
_STATUS: tuple[tuple[type[OgmError], int], ...] = (
    (MapEmpty, 404),
    (UnknownName, 404),
    (UnknownRobot, 404),
    (NameTaken, 409),
    (NotSeparate, 409),
    (BadStore, 500),
    (BadInput, 400),
    (Unauthorized, 401),
    (TooManyGuesses, 429),
    (CrossOrigin, 403),
    (ForeignHost, 421),
    (Changed, 412),
    (UpgradeRequired, 426),
    (Busy, 503),
    (Unavailable, 503),
    (NotStored, 503),
    (AskShares, 501),
    (DiskFull, 507),
)

# What is refused below the application, or by its router: no error of ours was raised.
_SLUGS = {
    400: "bad-request",
    404: "not-found",
    405: "method-not-allowed",
    408: "request-timeout",
    413: "content-too-large",
    414: "uri-too-long",
    431: "headers-too-large",
}


def slug_of(status: int) -> str:
    """Slug of what HTTP itself refuses with a status code."""
    return _SLUGS.get(status, "http")


def status_of(error: OgmError) -> int:
    """HTTP status code of an error."""
    return next((status for kind, status in _STATUS if isinstance(error, kind)), 500)


def problem(slug: str, status: int, detail: str) -> bytes:
    """Body of a problem+json reply."""
    title = http.HTTPStatus(status).phrase
    return json.dumps({"type": slug, "title": title, "status": status, "detail": detail}).encode()


def problem_of(error: OgmError) -> bytes:
    """Body of the problem+json reply to an error that was raised on purpose."""
    return problem(error.slug, status_of(error), str(error))
