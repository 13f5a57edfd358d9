"""The mapper on HTTP: a FastAPI application over `Answers`. It knows names, bytes and headers, and no map."""

import asyncio
import importlib.metadata
import logging
from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from importlib.resources import files
from typing import TypeVar
from urllib.parse import unquote_plus

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse, JSONResponse, PlainTextResponse
from fastapi_offline import FastAPIOffline
from starlette.datastructures import MutableHeaders
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ogm_core.errors import BadParameter, OgmError, cut
from ogm_core.status import Status
from ogm_services.mapper.serving.answers import MAP_FORMATS, Answers
from ogm_services.mapper.serving.api_description import (
    Responses,
    described_parameters,
    map_responses,
    probe_responses,
    responses,
)
from ogm_services.mapper.serving.bearer_token import BearerToken
from ogm_services.mapper.serving.health import Health
from ogm_services.mapper.serving.in_pieces import InPieces
from ogm_services.mapper.serving.known_hosts import KnownHosts
from ogm_services.mapper.serving.measured_http import MeasuredHttp
from ogm_services.mapper.serving.metrics import MEDIA_TYPE as METRICS_TYPE
from ogm_services.mapper.serving.metrics import Metrics
from ogm_services.mapper.serving.ready_maps import NO_STORE, ReadyMaps
from ogm_services.mapper.serving.refusals import refusal
from ogm_services.mapper.serving.refused_http import RefusedHttp
from ogm_services.mapper.serving.same_origin import SameOrigin
from ogm_services.mapper.serving.shares import Shares
from ogm_services.replies.answer import Answer, Parameters
from ogm_services.replies.in_flight import InFlight
from ogm_services.replies.problems import MEDIA_TYPE, problem, slug_of
from ogm_services.replies.turns import Turns

UNHEARD = "t"
"""Query parameter that viewers add, with a new value each time, lest a cache answers them."""

log = logging.getLogger(__name__)
Handler = Callable[[Request], Awaitable[Response]]
_T = TypeVar("_T")


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


def build_app(
    answers: Answers,
    health: Health,
    reset: Callable[[str], None],
    metrics: Metrics,
    *,
    hosts: Sequence[str] = (),
    token: bytes | None = None,
    shares: Shares,
    in_flight: InFlight | None = None,
) -> FastAPI:
    """Make the application; nothing is computed before a request comes.

    `hosts` are names by which it is asked, besides the machine's own; with a `token` writes must carry it.
    Its threads are those of `shares`, which belong to the caller. `in_flight` counts what is being sent.
    """
    version = importlib.metadata.version("zenoh-ogm")
    app = FastAPIOffline(
        title="zenoh-ogm mapper",
        version=version,
        description="A live occupancy grid map of robots' poses and 2D LiDAR scans.",
        redoc_url=None,
    )
    ready = ReadyMaps(answers)
    answers.count_cache(ready)
    app.add_middleware(BearerToken, token=token)
    app.add_middleware(SameOrigin)
    app.add_middleware(_NoStore)
    app.add_middleware(ready.around)
    app.add_middleware(_WithoutUnheard)
    app.add_middleware(InPieces, in_flight=in_flight or InFlight())
    app.add_middleware(KnownHosts, names=hosts)
    app.add_middleware(RefusedHttp)
    # The last one is the first that a request meets.
    app.add_middleware(MeasuredHttp, measurements=metrics.measurements, routes=app.routes)
    for form, wanted in MAP_FORMATS.items():
        handler, summary = _map_handler(shares.maps, answers, ready, form), f"The map as {form.upper()}"
        described = map_responses(wanted.media_type)
        _get(app, f"/map.{form}", handler, described, summary, sorted(wanted.parameters))
    maps, plain = shares.maps, responses("application/json")
    _get(app, "/cell", _handler(maps, answers.cell), plain, "One cell", ["x", "y"])
    _get(app, "/quality", _handler(maps, answers.quality), plain, "The quality figures")
    status = _handler(shares.status, answers.status)
    _get(app, "/status", status, responses("application/json", Status), "The mapper's status")
    _add_service_routes(app, shares.status, answers, health, metrics, version)

    described = responses("application/json", Status, problems=(401, 403, 413, 503))

    @app.post("/reset", summary="Empty the map: a new epoch, revision 0", responses=described)
    async def post_reset(request: Request) -> Response:
        _parameters_of(request, allowed=False)
        who = request.client.host if request.client else "somebody"
        await _in_turn(shares.writes, partial(reset, f"{who} over HTTP"))
        return _plain(await _in_turn(shares.status, partial(answers.status, {})))

    app.add_exception_handler(OgmError, _ogm_error)
    app.add_exception_handler(HTTPException, _http_error)
    app.add_exception_handler(Exception, _bug)
    return app


def _add_service_routes(
    app: FastAPI, turns: Turns, answers: Answers, health: Health, metrics: Metrics, version: str
) -> None:
    page = files("ogm_services.mapper.serving").joinpath("page/index.html").read_text("utf-8")

    async def show_page(_: Request) -> Response:
        return HTMLResponse(page)

    async def livez(_: Request) -> Response:
        return _probe(health.not_alive())

    async def readyz(_: Request) -> Response:
        return _probe(health.not_ready())

    async def show_metrics(_: Request) -> Response:
        text = await _in_turn(turns, lambda: metrics.text(answers.current_status()))
        return PlainTextResponse(text, media_type=METRICS_TYPE)

    async def show_version(_: Request) -> Response:
        return JSONResponse({"name": "zenoh-ogm", "version": version})

    _get(app, "/", show_page, responses("text/html"), "The live page")
    _get(app, "/livez", livez, probe_responses(), "Whether the mapper works: 200 or 503")
    _get(app, "/readyz", readyz, probe_responses(), "Whether it should get scans: 200, or 503 and why not")
    _get(app, "/metrics", show_metrics, responses("text/plain"), "Metrics for Prometheus")
    _get(app, "/version", show_version, responses("application/json"), "Name and version of this program")


def _get(
    app: FastAPI,
    path: str,
    handler: Handler,
    answers: Responses,
    summary: str,
    parameters: Sequence[str] = (),
) -> None:
    """Route GET and HEAD; what is documented here is made elsewhere."""
    app.add_api_route(
        path,
        handler,
        summary=summary,
        response_class=Response,  # without a media type of its own, so that the described one stands alone
        responses=answers,
        openapi_extra={"parameters": described_parameters(parameters)} if parameters else None,
    )
    app.add_api_route(path, handler, methods=["HEAD"], include_in_schema=False)


async def _in_turn(turns: Turns, answer: Callable[[], _T]) -> _T:
    """What `answer` returns, made by a thread of that share; Busy if its turn does not come soon."""
    return await asyncio.wrap_future(turns.take(answer))


def _handler(turns: Turns, answer: Callable[[Parameters], Answer]) -> Handler:
    async def handle(request: Request) -> Response:
        return _plain(await _in_turn(turns, partial(answer, _parameters_of(request))))

    return handle


def _map_handler(turns: Turns, answers: Answers, ready: ReadyMaps, form: str) -> Handler:
    async def handle(request: Request) -> Response:
        answer = await _in_turn(turns, partial(answers.map, form, _parameters_of(request)))
        return ready.keep(request, answer)

    return handle


def _parameters_of(request: Request, *, allowed: bool = True) -> Parameters:
    given: dict[str, str] = {}
    for name, value in request.query_params.multi_items():
        if name in given or not allowed:
            raise BadParameter(
                f"{cut(name)}: {'given twice' if allowed else 'unknown parameter; there are none'}"
            )
        given[name] = value
    return given


def _plain(answer: Answer) -> Response:
    return Response(answer.body, media_type=answer.media_type)


def _probe(trouble: str | None) -> Response:
    return PlainTextResponse(trouble or "ok", status_code=503 if trouble else 200)


async def _ogm_error(_: Request, error: Exception) -> Response:
    assert isinstance(error, OgmError)
    return refusal(error)


async def _http_error(_: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    body = problem(slug_of(error.status_code), error.status_code, str(error.detail))
    return Response(body, error.status_code, error.headers, MEDIA_TYPE)


async def _bug(request: Request, error: Exception) -> Response:
    log.error("%s %s failed", request.method, request.url.path, exc_info=error)
    body = problem("internal", 500, "the mapper failed; see its log")
    return Response(body, 500, NO_STORE, MEDIA_TYPE)  # it does not pass through _NoStore
