"""Reverse proxies: the mapper under a path, and what a proxy that is believed says of who asks, and for what.

Of the headers that proxies write, those are read that nginx, Caddy, Traefik and HAProxy can all write:
X-Forwarded-For, -Proto, -Host and -Prefix; not Forwarded (RFC 7239).
"""

import ipaddress
import re
from collections.abc import Iterable, Sequence
from functools import lru_cache

from starlette.responses import RedirectResponse
from starlette.routing import BaseRoute, Mount, Route
from starlette.types import ASGIApp, Receive, Scope, Send

from ogm_core.errors import MAX_SHOWN, BadSetting, OgmError
from ogm_services.mapper.serving.http_access import HttpAccess
from ogm_services.mapper.serving.known_hosts import REFUSED, OwnNames
from ogm_services.replies.answer import BadForwarded
from ogm_services.settings.values import ROOT_PATH, ROOT_PATH_FORM

_SECURE = {"http": False, "ws": False, "https": True, "wss": True}
"""What X-Forwarded-Proto may be (Traefik says ws and wss of WebSockets), and whether that is TLS."""
_SCHEMES = {"http": ("http", "https"), "websocket": ("ws", "wss")}
_REMEMBERED = 1024


class BehindProxies:
    """ASGI middleware, outside all others: who asks, for what, as the proxy between was asked for it.

    Behind it a path has no prefix, whether the proxy has stripped it or not; `root_path` has it. Headers are
    believed of the proxies that are named, and only where the proxy has asked for one of the mapper's own
    names: else a page whose name was made to lead to this machine could say by them that it has another. Of
    a list, which each proxy on the way has added to, the last entry is believed, as nobody else wrote that.
    """

    def __init__(self, app: ASGIApp, names: OwnNames, routes: list[BaseRoute], access: HttpAccess) -> None:
        """`routes`: the application's, which may still grow."""
        self._app = app
        self._names = names
        self._routes = routes
        self._root_path = access.root_path
        networks = [ipaddress.ip_network(peer) for peer in access.proxies]
        self._is_proxy = lru_cache(_REMEMBERED)(lambda host: _is_in(host, networks))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand on what was asked for; the way to the page without its slash leads to the page."""
        if scope["type"] in _SCHEMES:
            try:
                scope = self._without_prefix(self._as_asked(scope))
            except OgmError as error:
                scope = {**scope, REFUSED: error}  # told, logged and counted by those behind, as all is
            if not scope["path"] and scope["type"] == "http":
                query = scope["query_string"].decode("latin-1")
                target = f"{scope['root_path']}/{'?' if query else ''}{query}"
                await RedirectResponse(target)(scope, receive, send)
                return
        await self._app(scope, receive, send)

    def _as_asked(self, scope: Scope) -> Scope:
        """A request as the first proxy that is believed has got it."""
        scope = {**scope, "root_path": self._root_path}
        client = scope.get("client")
        host = next((value for name, value in scope["headers"] if name == b"host"), None)
        if client is None or not self._is_proxy(client[0]):
            return scope
        if host is not None and self._names.problem(host) is not None:
            return scope
        said = _forwarded(scope)
        if b"for" in said:
            scope["client"] = (self._client(said[b"for"]) or client[0], 0)
        if b"proto" in said:
            scope["scheme"] = _SCHEMES[scope["type"]][_is_secure(said[b"proto"][-1])]
        if b"prefix" in said:
            scope["root_path"] = self._prefix(said[b"prefix"][-1])
        if b"host" in said:
            others = [(name, value) for name, value in scope["headers"] if name != b"host"]
            scope["headers"] = [(b"host", said[b"host"][-1].encode("latin-1")), *others]
        return scope

    def _client(self, addresses: Sequence[str]) -> str | None:
        """Who has asked the first of the proxies that are believed, if they say so."""
        asked = None
        for address in reversed(addresses):
            asked = _address_in(address)
            if asked is None or not self._is_proxy(asked):
                break
        return asked

    def _prefix(self, said: str) -> str:
        prefix = said.removesuffix("/")
        if prefix:
            if ROOT_PATH.fullmatch(prefix) is None:
                raise BadForwarded(f"X-Forwarded-Prefix {said[:MAX_SHOWN]!r}: {ROOT_PATH_FORM} is needed")
            check_root_path(prefix, self._routes, "X-Forwarded-Prefix")
        return prefix

    @staticmethod
    def _without_prefix(scope: Scope) -> Scope:
        prefix, path = scope["root_path"], scope["path"]
        if prefix and path.startswith(prefix) and path[len(prefix) : len(prefix) + 1] in ("", "/"):
            scope["path"] = path[len(prefix) :]
        return scope


class WholePath:
    """ASGI middleware, inside all others: gives a path its prefix back, which ASGI's `path` has."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand it on to the router, which looks at what is behind `root_path`."""
        prefix = scope.get("root_path", "")
        await self._app({**scope, "path": prefix + scope["path"]} if prefix else scope, receive, send)


def check_root_path(root_path: str, routes: Iterable[BaseRoute], given_as: str) -> None:
    """See that no path below it is a route's: a proxy may strip it or not, and either is understood.

    Raises:
        BadSetting: one is.
    """
    below = f"{root_path}/"
    for route in routes:
        if root_path and isinstance(route, Route | Mount) and f"{route.path}/".startswith(below):
            raise BadSetting(f"{given_as} {root_path}: the mapper serves {route.path} itself: take another")


def _forwarded(scope: Scope) -> dict[bytes, list[str]]:
    """The entries of X-Forwarded-*, of all lines of each, by what comes after that, in small letters."""
    found: dict[bytes, list[str]] = {}
    for name, value in scope["headers"]:
        if name.startswith(b"x-forwarded-"):
            entries = [entry.strip() for entry in value.decode("latin-1").split(",")]
            found.setdefault(name[len(b"x-forwarded-") :], []).extend(entries)
    return found


def _is_secure(said: str) -> bool:
    secure = _SECURE.get(said.lower())
    if secure is None:
        raise BadForwarded(f"X-Forwarded-Proto {said[:MAX_SHOWN]!r}: http or https is needed")
    return secure


def _address_in(entry: str) -> str | None:
    """The address of an entry of X-Forwarded-For, which may have a port; None if it has none."""
    bare = re.fullmatch(r"\[([0-9A-Fa-f:.]+)\](?::[0-9]+)?|([0-9.]+):[0-9]+", entry)
    text = entry if bare is None else bare[1] or bare[2]
    try:
        # Not its zone, which is of the proxy's machine, and may be any text of any length.
        return str(ipaddress.ip_address(text.partition("%")[0]))
    except ValueError:
        return None


def _is_in(host: str, networks: Sequence[ipaddress.IPv4Network | ipaddress.IPv6Network]) -> bool:
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    # A socket that listens on :: has IPv4's addresses in IPv6's clothes.
    plain = getattr(address, "ipv4_mapped", None) or address
    return any(plain in network for network in networks)
