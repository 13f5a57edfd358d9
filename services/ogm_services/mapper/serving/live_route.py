"""Route of WebSocket clients that watch the map live."""

from typing import Final

from fastapi import FastAPI, Request, Response
from starlette.routing import WebSocketRoute
from starlette.types import ASGIApp

from ogm_services.mapper.serving.refusals import refusal
from ogm_services.replies.answer import UpgradeRequired

LIVE_PATH: Final = "/ws"


def add_live_route(app: FastAPI, clients: ASGIApp) -> None:
    """Add it; who asks without the handshake of a WebSocket is told so."""

    async def no_handshake(_: Request) -> Response:
        error = UpgradeRequired(f"{LIVE_PATH}: a WebSocket's handshake is needed (RFC 6455)")
        return refusal(error, {"Upgrade": "websocket", "Connection": "Upgrade"})

    app.router.routes.append(WebSocketRoute(LIVE_PATH, clients))
    app.add_api_route(LIVE_PATH, no_handshake, methods=["GET", "HEAD"], include_in_schema=False)
