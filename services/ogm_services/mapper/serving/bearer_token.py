"""Bearer token of writes over HTTP (RFC 6750): who may change something says so with every request."""

from collections.abc import Container

from starlette.types import ASGIApp, Receive, Scope, Send

from ogm_core.errors import MAX_SHOWN
from ogm_services.mapper.serving.allowed_methods import SAFE_METHODS
from ogm_services.mapper.serving.refusals import refusal
from ogm_services.mapper.serving.write_access import WriteAccess
from ogm_services.replies.answer import Unauthorized


class BearerToken:
    """ASGI middleware: refuses every request that may change something and that nothing allows to.

    Without a token it lets everything through. Which methods are writes is their definition's matter, not
    the routes': a new route is guarded by itself, unless it is named as one that only reads.
    """

    def __init__(self, app: ASGIApp, access: WriteAccess, reads: Container[str] = ()) -> None:
        """`reads`: paths that change nothing of the map, whatever the method."""
        self._app = app
        self._access = access
        self._reads = reads

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 401 or 429, or leave it to the application behind."""
        if scope["type"] != "http" or self._only_reads(scope):
            await self._app(scope, receive, send)
            return
        error = self._access.problem(scope)
        if error is None:
            await self._app(scope, receive, send)
            return
        if isinstance(error, Unauthorized):
            error = Unauthorized(
                f"{scope['method']} {scope['path'][:MAX_SHOWN]}: refused: {error}: it needs the header "
                "`Authorization: Bearer TOKEN`, once, with the token of the mapper's settings (http.token), "
                "or the cookie that POST /login gives for it"
            )
        given = any(name == b"authorization" for name, _ in scope["headers"])
        await refusal(error, challenge(invalid=given))(scope, receive, send)

    def _only_reads(self, scope: Scope) -> bool:
        return scope["method"] in SAFE_METHODS or (scope["method"] == "POST" and scope["path"] in self._reads)


def challenge(*, invalid: bool) -> dict[str, str]:
    """What a refusal asks for: a token, or another one."""
    return {"WWW-Authenticate": 'Bearer error="invalid_token"' if invalid else "Bearer"}
