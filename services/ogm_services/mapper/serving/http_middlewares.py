"""Middlewares of HTTP: what a request goes through on its way to a route, and its answer on the way back."""

from collections.abc import Sequence
from urllib.parse import unquote_plus

from starlette.datastructures import MutableHeaders
from starlette.middleware import Middleware
from starlette.routing import BaseRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ogm_services.mapper.serving.allowed_methods import AllowedMethods
from ogm_services.mapper.serving.bearer_token import BearerToken
from ogm_services.mapper.serving.behind_proxies import BehindProxies, WholePath
from ogm_services.mapper.serving.content_coding import Gzip
from ogm_services.mapper.serving.cross_origin import CrossOriginSharing
from ogm_services.mapper.serving.http_access import HttpAccess
from ogm_services.mapper.serving.in_pieces import InPieces
from ogm_services.mapper.serving.known_hosts import KnownHosts, OwnNames
from ogm_services.mapper.serving.login_routes import LOG_IN_PATHS
from ogm_services.mapper.serving.measured_http import MeasuredHttp
from ogm_services.mapper.serving.measurements import Measurements
from ogm_services.mapper.serving.query_routes import READS
from ogm_services.mapper.serving.ready_maps import NO_STORE, ReadyMaps
from ogm_services.mapper.serving.refused_http import RefusedHttp
from ogm_services.mapper.serving.same_origin import SameOrigin
from ogm_services.mapper.serving.write_access import WriteAccess
from ogm_services.replies.in_flight import InFlight

UNHEARD = "t"
"""Query parameter that viewers add, with a new value each time, lest a cache answers them."""


def middlewares(
    routes: list[BaseRoute],
    access: HttpAccess,
    write_access: WriteAccess,
    ready: ReadyMaps,
    *,
    in_flight: InFlight,
    measurements: Measurements,
) -> Sequence[Middleware]:
    """All of them, the outermost first: it meets a request first, and its answer last.

    `routes`: the application's, which may still grow.
    """
    names = OwnNames(access.hosts)
    proxies = Middleware(BehindProxies, names=names, routes=routes, access=access)
    sharing = Middleware(CrossOriginSharing, origins=access.origins, routes=routes, reads=READS)
    needed = write_access.token_needed
    return [
        # Who asks, for which host and path: all others go by that.
        *([proxies] if access.root_path or access.proxies else []),
        # Refusals are counted, and told to operators, so these two are outside all that refuse.
        Middleware(MeasuredHttp, measurements=measurements, routes=routes),
        Middleware(RefusedHttp),
        # Who asks by a name that is not the mapper's gets nothing at all.
        Middleware(KnownHosts, names=names),
        # Pages of other origins may read every answer, those of caches and refusals included.
        *([sharing] if access.origins else []),
        # Whatever has made it, a long body is counted.
        Middleware(InPieces, in_flight=in_flight),
        # What differs only by it is one question, for the next one, too.
        Middleware(_WithoutUnheard),
        # Maps that have not changed are read: nothing below is needed for them, and they go out as they are.
        Middleware(ready.around),
        Middleware(Gzip),
        Middleware(_NoStore),
        # Writes of foreign pages are refused before their token is looked at: they shall not try tokens.
        Middleware(SameOrigin, origins=access.origins, reads=READS, token_needed=needed),
        Middleware(BearerToken, access=write_access, reads=READS | LOG_IN_PATHS),
        # Next to the routes, for these two change what the routes see: the method, and the path.
        Middleware(AllowedMethods, routes=routes),
        Middleware(WholePath),
    ]


class _NoStore:
    """ASGI middleware: nothing is kept by caches unless a route says otherwise."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_marked(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in NO_STORE.items():
                    headers.setdefault(name, value)
            await send(message)

        await self._app(scope, receive, send_marked)


class _WithoutUnheard:
    """ASGI middleware: nothing behind it sees the query parameter UNHEARD, neither a route nor a cache."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["query_string"]:
            heard = [
                part
                for part in scope["query_string"].split(b"&")
                if unquote_plus(part.partition(b"=")[0].decode("latin-1")) != UNHEARD
            ]
            scope = {**scope, "query_string": b"&".join(heard)}
        await self._app(scope, receive, send)
