"""Host check: over HTTP the mapper answers to its own names only, against DNS rebinding.

A page's owner can let the page's own name lead to this machine: the browser then takes the mapper for a part
of that page, and lets it read and write. But it still says in Host which name it asked for.
"""

import ipaddress
import re
import socket
import threading
from collections.abc import Iterable
from functools import lru_cache

from starlette.types import ASGIApp, Receive, Scope, Send

from ogm_core.errors import MAX_SHOWN, OgmError
from ogm_services.mapper.serving.refusals import refusal
from ogm_services.replies.answer import BadHost, ForeignHost

_HOST = re.compile(rb"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_\-.]+)(?::([0-9]{1,5}))?")
"""Host of RFC 9112, section 3.2, without what no name of the network has in it."""
_REMEMBERED = 256
_LONGEST = 300
"""Bytes of what is remembered: a name of the network has 253 at most."""
REFUSED = "ogm.refused"
"""Key of a request's scope: the error of what is ill-formed before anything has looked at it."""


class OwnNames:
    """The hosts that the mapper goes by.

    Known are addresses in digits, which no name can be made to lead to, localhost with the names below it,
    the machine's own names, and `names`.
    """

    def __init__(self, names: Iterable[str] = ()) -> None:
        mine = socket.gethostname()
        self._names = {_plain(name) for name in (*names, "localhost", mine, f"{mine}.local")}
        self._judged = lru_cache(_REMEMBERED)(self._problem)
        # The whole name is asked of the network, which may take seconds, or never answer.
        threading.Thread(target=self._add_whole_name, name="ogm-host-name", daemon=True).start()

    def problem(self, header: bytes) -> BadHost | ForeignHost | None:
        """What is wrong with a Host header."""
        return self._judged(header) if len(header) <= _LONGEST else self._problem(header)

    def _problem(self, header: bytes) -> BadHost | ForeignHost | None:
        shown = header[:MAX_SHOWN].decode("latin-1")
        parts = _HOST.fullmatch(header)
        if parts is None or int(parts[2] or 0) > 65535:
            return BadHost(f"Host {shown!r}: a name or an address is needed, with a port or without")
        host = _plain(parts[1].decode("ascii"))
        if _is_address(host) or host in self._names or host.endswith(".localhost"):
            return None
        return ForeignHost(
            f"Host {shown!r}: this mapper does not go by that name; if it is its own, add it to http.hosts"
        )

    def _add_whole_name(self) -> None:
        self._names.add(_plain(socket.getfqdn()))
        self._judged.cache_clear()


class KnownHosts:
    """ASGI middleware: refuses what asks for another host than this one, before any route or cache.

    A request without Host (HTTP/1.0) comes from no browser. What is known to be ill-formed is refused, too.
    """

    def __init__(self, app: ASGIApp, names: OwnNames) -> None:
        self._app = app
        self._names = names

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 400 or 421, or leave it to the application behind."""
        error = self._error(scope) if scope["type"] != "lifespan" else None
        if error is None:
            await self._app(scope, receive, send)
        else:
            await refusal(error)(scope, receive, send)

    def _error(self, scope: Scope) -> OgmError | None:
        refused: OgmError | None = scope.get(REFUSED)
        if refused is not None:
            return refused
        hosts = (value for name, value in scope["headers"] if name == b"host")
        return next(filter(None, map(self._names.problem, hosts)), None)


def _plain(name: str) -> str:
    """A name as names are compared: in small letters, without the dot of the root."""
    return name.lower().removesuffix(".")


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host.strip("[]"))
    except ValueError:
        return False
    return True
