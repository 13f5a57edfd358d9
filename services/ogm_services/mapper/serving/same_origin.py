"""Same-origin check of writes over HTTP: programs and the mapper's own page may, other pages may not."""

from collections.abc import Collection

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from ogm_core.errors import cut
from ogm_services.mapper.serving.refusals import refusal
from ogm_services.replies.answer import CrossOrigin

SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
"""They change nothing (RFC 9110, section 9.2.1)."""


class SameOrigin:
    """ASGI middleware: refuses every request that may change something and comes from another origin's page.

    A browser sends such a request for any page that is open on the machine, whoever made the page. It says
    so in Sec-Fetch-Site, or, where it reaches the mapper under a name that it does not trust, in Origin
    alone. A program that is no browser sends neither.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 403, or leave it to the application behind."""
        if scope["type"] == "http" and scope["method"] not in SAFE_METHODS:
            foreign = _foreign(Headers(scope=scope))
            if foreign is not None:
                error = CrossOrigin(
                    f"{scope['method']} {scope['path']}: refused: a page of another origin asks for it "
                    f"({foreign}): use the mapper's own page, or a program that is no browser"
                )
                await refusal(error)(scope, receive, send)
                return
        await self._app(scope, receive, send)


def foreign_origin(headers: Headers, allowed: Collection[str] = ()) -> str | None:
    """The header Origin of a page of another origin, but of those that are allowed; None if there is none."""
    origin, host = (headers.get(name) for name in ("Origin", "Host"))
    if origin is None or origin.lower() in allowed:
        return None
    # Not its scheme: a proxy that ends TLS speaks HTTP to the mapper.
    same = host is not None and origin.rpartition("://")[2].lower() == host.lower()
    return None if same else f"Origin: {cut(origin)}, Host: {host and cut(host)}"


def _foreign(headers: Headers) -> str | None:
    """The header that tells of another origin; None if none does."""
    site = headers.get("Sec-Fetch-Site")
    if site is not None:
        # "none": the user asks, by no page at all. "same-site": another port, or another name of the domain.
        return None if site in ("same-origin", "none") else f"Sec-Fetch-Site: {site}"
    return foreign_origin(headers)
