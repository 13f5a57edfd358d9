"""Methods of HTTP that a path takes: HEAD wherever GET is, OPTIONS everywhere, Allow wherever it helps."""

from collections.abc import Iterable

from starlette.responses import Response
from starlette.routing import BaseRoute, Match, Mount, Route
from starlette.types import ASGIApp, Receive, Scope, Send

SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
"""They change nothing (RFC 9110, section 9.2.1)."""


class AllowedMethods:
    """ASGI middleware: answers OPTIONS, and has the routes of GET answer HEAD."""

    def __init__(self, app: ASGIApp, routes: list[BaseRoute]) -> None:
        """`routes`: the application's, which may still grow."""
        self._app = app
        self._routes = routes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer OPTIONS of a path that there is, or leave it to the application behind."""
        method = scope["method"] if scope["type"] == "http" else None
        if method == "HEAD":
            # The server sends no body of it: it looks at the request, and not at this copy.
            scope = {**scope, "method": "GET"}
        elif method == "OPTIONS" and (allowed := allowed_methods(self._routes, scope)):
            await Response(status_code=204, headers={"Allow": allowed})(scope, receive, send)
            return
        await self._app(scope, receive, send)


def allowed_methods(routes: Iterable[BaseRoute], scope: Scope) -> str:
    """The header Allow (RFC 9110, section 10.2.1) of a request's path; "" if there is no such path."""
    methods: set[str] = set()
    # Whoever serves files below a path has taken that for a part of the root.
    scope = {**scope, "root_path": scope.get("app_root_path", scope.get("root_path", ""))}
    for route in routes:
        if route.matches(scope)[0] is not Match.NONE:
            if isinstance(route, Route):
                methods |= route.methods or set()
            elif isinstance(route, Mount):  # of files
                methods.add("GET")
    if "GET" in methods:
        methods.add("HEAD")
    return ", ".join(sorted({*methods, "OPTIONS"})) if methods else ""
