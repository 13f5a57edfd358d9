"""Same-origin check of writes over HTTP: programs and the mapper's own page may, other pages may not."""

from collections.abc import Container

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from ogm_core.errors import cut
from ogm_services.mapper.serving.allowed_methods import SAFE_METHODS
from ogm_services.mapper.serving.cross_origin import Origins
from ogm_services.mapper.serving.refusals import refusal
from ogm_services.mapper.serving.write_access import carries_token
from ogm_services.replies.answer import CrossOrigin


class SameOrigin:
    """ASGI middleware: refuses every request that may change something and comes from another origin's page.

    A browser sends such a request for any page that is open on the machine, whoever made the page. It says
    so in Sec-Fetch-Site, or, where it reaches the mapper under a name that it does not trust, in Origin
    alone. A program that is no browser sends neither.
    """

    def __init__(
        self,
        app: ASGIApp,
        origins: Origins | None = None,
        reads: Container[str] = (),
        *,
        token_needed: bool = False,
    ) -> None:
        """`origins` are others whose pages may: those that are named write, with a token, if one is needed.

        They are not believed to be whoever is logged in. `reads`: paths that change nothing, whatever the
        method.
        """
        self._app = app
        self._origins = origins or Origins()
        self._reads = reads
        self._token_needed = token_needed

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 403, or leave it to the application behind."""
        if scope["type"] == "http" and scope["method"] not in SAFE_METHODS:
            headers = Headers(scope=scope)
            foreign = _foreign(headers)
            if foreign is not None and not self._may(scope, headers):
                error = CrossOrigin(
                    f"{scope['method']} {cut(scope['path'])}: refused: a page of another origin asks for it "
                    f"({foreign}): use the mapper's own page, or a program that is no browser; "
                    "http.cors_origins names pages that may, with the token"
                )
                await refusal(error)(scope, receive, send)
                return
        await self._app(scope, receive, send)

    def _may(self, scope: Scope, headers: Headers) -> bool:
        """Whether a page of another origin may: a token that it sends itself, no other page can send."""
        origin = headers.get("Origin", "").lower()
        if scope["path"] in self._reads and origin in self._origins:
            return True
        return self._token_needed and origin in self._origins.named and carries_token(scope)


def foreign_origin(headers: Headers, allowed: Container[str] = ()) -> str | None:
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
        return None if site in ("same-origin", "none") else f"Sec-Fetch-Site: {cut(site)}"
    return foreign_origin(headers)
