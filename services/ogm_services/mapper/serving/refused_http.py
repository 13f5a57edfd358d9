"""Requests over HTTP that are refused because of who asks: an operator sees them in the log.

It refuses nothing itself: it looks at the answers of those that do, and only there is who has asked known.
"""

import logging

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ogm_core.errors import MAX_SHOWN
from ogm_services.runtime.limited_log import LimitedLog

_WHY = {
    401: "without the mapper's token, or with a wrong one",
    403: "by a page of another origin",
    429: "after too many wrong tokens",
    421: "under a name that the mapper does not go by",
}

log = logging.getLogger(__name__)


class RefusedHttp:
    """ASGI middleware, outside those that refuse: warns of what they refused, once a second and status."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._complaints = LimitedLog(log)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand a request on, and look at its answer's status."""

        async def send_looked_at(message: Message) -> None:
            why = _WHY.get(message.get("status", 0))
            if why is not None and message["type"].endswith("http.response.start"):
                host = next((value for name, value in scope["headers"] if name == b"host"), b"")
                method = scope.get("method", "WebSocket")
                self._complaints.of_kind(
                    (scope.get("client") or ["somebody"])[0],
                    str(message["status"]),
                    f"{method} {scope['path'][:MAX_SHOWN]} refused over HTTP, asked for {why} "
                    f"({message['status']}; Host {host.decode('latin-1')[:MAX_SHOWN]})",
                )
            await send(message)

        await self._app(scope, receive, send_looked_at)
