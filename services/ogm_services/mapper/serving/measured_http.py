"""Requests over HTTP as metrics know them: by names of which there are few, whoever asks for what."""

import time

from starlette.routing import BaseRoute, Mount, Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ogm_services.mapper.serving.measurements import Measurements

OTHER = "other"
"""Stands for every path that is no route's, and for every method that is not of RFC 9110."""
METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "CONNECT"})


class MeasuredHttp:
    """ASGI middleware, outside all that answer: measures every request, by the template of its route."""

    def __init__(self, app: ASGIApp, measurements: Measurements, routes: list[BaseRoute]) -> None:
        """`routes`: the application's, which may still grow."""
        self._app = app
        self._measurements = measurements
        self._routes = routes
        self._without_parameters: dict[str, str] = {}
        """Paths that are their own templates, found once."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand a request on, and measure it when it has been answered."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began, status = time.perf_counter(), "5xx"

        async def send_noted(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = f"{message['status'] // 100}xx"
            await send(message)

        try:
            await self._app(scope, receive, send_noted)
        finally:
            method = scope["method"] if scope["method"] in METHODS else OTHER
            seconds = time.perf_counter() - began
            self._measurements.http_answered(self._template(scope["path"]), method, status, seconds)

    def _template(self, path: str) -> str:
        """The path of the route that a request's path is of, with its parameters' names."""
        known = self._without_parameters.get(path)
        if known is not None:
            return known
        for route in self._routes:
            if isinstance(route, Route | Mount) and route.path_regex.match(path):
                if route.path == path:
                    self._without_parameters[path] = path
                return route.path
        return OTHER
