"""Log-ins of browsers: a random value in a cookie stands for the token that was given once."""

import hashlib
import re
import secrets
import time
from collections import OrderedDict
from collections.abc import Callable

from starlette.types import Scope

LIFETIME = 12 * 3600
"""How long a log-in holds, s."""
MAX_LOG_INS = 256
"""How many there are at most; the oldest goes first."""
_PORT = re.compile(rb":([0-9]{1,5})$")


class LogIns:
    """The browsers that are logged in, of this process; what they send is kept as a digest only.

    On the event loop only.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock` in s."""
        self._clock = clock
        self._until: OrderedDict[bytes, float] = OrderedDict()

    def begin(self, scope: Scope) -> str:
        """Log in; the Set-Cookie header that keeps it."""
        value = secrets.token_urlsafe(32)
        self._until[_digest(value)] = self._clock() + LIFETIME
        if len(self._until) > MAX_LOG_INS:
            self._until.popitem(last=False)
        return _cookie(scope, value, LIFETIME)

    def end(self, scope: Scope) -> str:
        """Log out whoever asks; the Set-Cookie header that lets the browser forget it."""
        for value in _values(scope):
            self._until.pop(_digest(value), None)
        return _cookie(scope, "", 0)

    def has(self, scope: Scope) -> bool:
        """Whether a request comes from a browser that is logged in."""
        now = self._clock()
        return any(self._until.get(_digest(value), now) > now for value in _values(scope))


def _digest(value: str) -> bytes:
    return hashlib.sha256(value.encode("latin-1")).digest()


def _cookie(scope: Scope, value: str, lifetime: int) -> str:
    secure = "; Secure" if scope.get("scheme") == "https" else ""
    path = scope.get("root_path") or "/"
    kept = f"Max-Age={lifetime}; Path={path}; HttpOnly; SameSite=Strict{secure}"
    return f"{_name(scope)}={value}; {kept}"


def _name(scope: Scope) -> str:
    """The cookie's name: browsers tell hosts apart and not their ports, on which other mappers may be."""
    host = next((value for name, value in scope["headers"] if name == b"host"), b"")
    port = _PORT.search(host)
    return f"ogm_login_{port[1].decode()}" if port else "ogm_login"


def _values(scope: Scope) -> list[str]:
    """What a request's cookies of the mapper's name hold: of several paths there may be several."""
    name = _name(scope)
    pairs = (
        pair.partition("=")
        for key, line in scope["headers"]
        if key == b"cookie"
        for pair in line.decode("latin-1").split(";")
    )
    return [value.strip() for key, _, value in pairs if key.strip() == name]
