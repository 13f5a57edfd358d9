"""Bearer token of writes over HTTP (RFC 6750): who may change something says so with every request."""

import hmac
from collections.abc import Container

from starlette.types import ASGIApp, Receive, Scope, Send

from ogm_core.errors import MAX_SHOWN
from ogm_services.mapper.serving.refusals import refusal
from ogm_services.mapper.serving.same_origin import SAFE_METHODS
from ogm_services.replies.answer import Unauthorized

_SCHEME = b"bearer "


class BearerToken:
    """ASGI middleware: refuses every request that may change something and does not carry the token.

    Without a token it lets everything through. Which methods are writes is their definition's matter, not
    the routes': a new route is guarded by itself, unless it is named as one that only reads.
    """

    def __init__(self, app: ASGIApp, token: bytes | None, reads: Container[str] = ()) -> None:
        """`reads`: paths that change nothing, whatever the method."""
        self._app = app
        self._token = token
        self._reads = reads

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 401, or leave it to the application behind."""
        if self._token is None or scope["type"] != "http" or self._only_reads(scope):
            await self._app(scope, receive, send)
            return
        given = [value for name, value in scope["headers"] if name == b"authorization"]
        # All of its bytes are compared, whichever differs: how long it takes tells nothing of the token.
        if len(given) == 1 and hmac.compare_digest(_token_of(given[0]), self._token):
            await self._app(scope, receive, send)
            return
        what = "its token is not the mapper's" if any(map(_token_of, given)) else "it carries no token"
        error = Unauthorized(
            f"{scope['method']} {scope['path'][:MAX_SHOWN]}: refused: {what}: it needs the header "
            "`Authorization: Bearer TOKEN`, once, with the token of the mapper's settings (http.token)"
        )
        challenge = {"WWW-Authenticate": 'Bearer error="invalid_token"' if given else "Bearer"}
        await refusal(error, challenge)(scope, receive, send)

    def _only_reads(self, scope: Scope) -> bool:
        return scope["method"] in SAFE_METHODS or (scope["method"] == "POST" and scope["path"] in self._reads)


def _token_of(header: bytes) -> bytes:
    """The token that an Authorization header carries; b"" if it is of another scheme."""
    return header[len(_SCHEME) :].strip() if header[: len(_SCHEME)].lower() == _SCHEME else b""
