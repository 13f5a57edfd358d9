"""Pages of other origins that may ask the mapper, and what their browsers are told (CORS)."""

from collections.abc import Collection, Container

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import Response
from starlette.routing import BaseRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ogm_services.mapper.serving.allowed_methods import SAFE_METHODS, allowed_methods

EVERYBODY = "*"
_ASKED_WITH = ("Content-Type", "If-Match", "If-None-Match")
_TOLD = "ETag, OGM-Epoch, OGM-Origin, OGM-Resolution, OGM-Revision, OGM-Run, OGM-Stamp, Retry-After"
"""What scripts may read besides what they always may."""
_REMEMBERED_FOR = 600
"""How long a browser need not ask again whether it may ask, s."""


class Origins:
    """The origins whose pages may ask: those that are named, or, with "*", whichever.

    As a container it holds those that may read. None but those that are named may write.
    """

    def __init__(self, given: Collection[str] = ()) -> None:
        self.named = frozenset(given) - {EVERYBODY}
        self.everybody = EVERYBODY in given

    def __bool__(self) -> bool:
        return self.everybody or bool(self.named)

    def __contains__(self, origin: object) -> bool:
        return self.everybody or origin in self.named


class CrossOriginSharing:
    """ASGI middleware: lets the pages of some origins read what is answered, and ask with headers.

    Cookies are never asked for: pages of other origins write by the token that they send themselves.
    """

    def __init__(
        self, app: ASGIApp, origins: Origins, routes: list[BaseRoute], reads: Container[str] = ()
    ) -> None:
        """`reads`: paths that change nothing, whatever the method; `routes` may still grow."""
        self._app = app
        self._origins = origins
        self._routes = routes
        self._reads = reads

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer what a browser asks before it asks, or add to the answer of those behind."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        origin = Headers(scope=scope).get("Origin")

        async def send_shared(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(raw=[*message.get("headers", ())])
                self._share(headers, origin)
                message = {**message, "headers": headers.raw}
            await send(message)

        preflight = None if origin is None else self._preflight(scope, origin)
        await (preflight or self._app)(scope, receive, send_shared)

    def _share(self, headers: MutableHeaders, origin: str | None) -> None:
        if self._origins.everybody:
            headers["Access-Control-Allow-Origin"] = EVERYBODY
        else:
            headers.add_vary_header("Origin")
            if origin is None or origin.lower() not in self._origins:
                return
            headers["Access-Control-Allow-Origin"] = origin
        headers["Access-Control-Expose-Headers"] = _TOLD

    def _preflight(self, scope: Scope, origin: str) -> Response | None:
        """The answer to a browser that asks whether a page may ask; None if it does not, or may not."""
        if scope["method"] != "OPTIONS" or origin.lower() not in self._origins:
            return None
        if "Access-Control-Request-Method" not in Headers(scope=scope):
            return None
        methods = allowed_methods(self._routes, scope)
        may_write = origin.lower() in self._origins.named
        if not may_write and scope["path"] not in self._reads:
            methods = ", ".join(method for method in methods.split(", ") if method in SAFE_METHODS)
        if not methods:
            return None
        asked_with = ("Authorization", *_ASKED_WITH) if may_write else _ASKED_WITH
        told = {
            "Allow": methods,
            "Access-Control-Allow-Methods": methods,
            "Access-Control-Allow-Headers": ", ".join(asked_with),
            "Access-Control-Max-Age": str(_REMEMBERED_FOR),
            "Vary": "Origin",
        }
        return Response(status_code=204, headers=told)
