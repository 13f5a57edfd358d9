"""Route of WebSocket clients that watch the map live."""

from typing import Final

from fastapi import FastAPI, Request, Response
from starlette.routing import WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket

from ogm_core.errors import cut
from ogm_services.mapper.serving.refusals import refusal
from ogm_services.replies.answer import UnknownName, UpgradeRequired

LIVE_PATH: Final = "/ws"


def add_live_route(app: FastAPI, clients: ASGIApp) -> None:
    """Add it; who asks without the handshake of a WebSocket, or elsewhere with it, is told so."""

    async def no_handshake(_: Request) -> Response:
        error = UpgradeRequired(f"{LIVE_PATH}: a WebSocket's handshake is needed (RFC 6455)")
        return refusal(error, {"Upgrade": "websocket", "Connection": "Upgrade"})

    async def nowhere(websocket: WebSocket) -> None:
        error = UnknownName(f"{cut(websocket.url.path)}: there is no WebSocket, but at {LIVE_PATH}")
        await websocket.send_denial_response(refusal(error))

    app.router.routes.append(WebSocketRoute(LIVE_PATH, clients))
    app.router.routes.append(WebSocketRoute("/{path:path}", nowhere))
    app.add_api_route(LIVE_PATH, no_handshake, methods=["GET", "HEAD"], include_in_schema=False)
