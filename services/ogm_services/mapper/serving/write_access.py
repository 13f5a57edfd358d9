"""Write access over HTTP: the token of the settings (RFC 6750), or a log-in that it was given for."""

import hmac

from starlette.types import Scope

from ogm_core.errors import OgmError
from ogm_services.mapper.serving.guesses import Guesses
from ogm_services.mapper.serving.log_ins import LogIns
from ogm_services.replies.answer import TooManyGuesses, Unauthorized

_SCHEME = b"bearer "


class WriteAccess:
    """Knows who may write. On the event loop only."""

    def __init__(self, token: bytes | None) -> None:
        """Without a token everybody may."""
        self._token = token
        self._guesses = Guesses()
        self.log_ins = LogIns()

    @property
    def token_needed(self) -> bool:
        """Whether not everybody may."""
        return self._token is not None

    def problem(self, scope: Scope) -> OgmError | None:
        """Why whoever sends a request may not write; None: he may. A token counts before a log-in.

        Of other schemes are the passwords that a browser sends to a proxy on the way: they say nothing here.
        """
        if self._token is None:
            return None
        if not carries_token(scope):
            return None if self.log_ins.has(scope) else Unauthorized("it carries no token")
        given = _authorizations(scope)
        return self.problem_of(scope, _token_of(given[0]) if len(given) == 1 else b"")

    def problem_of(self, scope: Scope, token: bytes) -> OgmError | None:
        """Why this is not the token; None: it is."""
        address = (scope.get("client") or ("somebody",))[0]
        wait = self._guesses.wait(address)
        if wait:
            return TooManyGuesses(f"too many wrong tokens came from {address}: wait {wait} s", wait)
        # All of its bytes are compared, whichever differs: how long it takes tells nothing of the token.
        if self._token is None or hmac.compare_digest(token, self._token):
            return None
        self._guesses.wrong(address)
        return Unauthorized("its token is not the mapper's")


def carries_token(scope: Scope) -> bool:
    """Whether a request has a token in Authorization, right or wrong."""
    return any(map(_token_of, _authorizations(scope)))


def _authorizations(scope: Scope) -> list[bytes]:
    return [value for name, value in scope["headers"] if name == b"authorization"]


def _token_of(header: bytes) -> bytes:
    """The token that an Authorization header carries; b"" if it is of another scheme."""
    return header[len(_SCHEME) :].strip() if header[: len(_SCHEME)].lower() == _SCHEME else b""
