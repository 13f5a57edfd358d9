"""The mapper on HTTP: a FastAPI application over `Answers`. It knows names, bytes and headers, and no map."""

import importlib.metadata
import logging
from collections.abc import Callable, Mapping
from functools import partial

from fastapi import FastAPI, Request, Response
from fastapi.responses import JSONResponse, PlainTextResponse
from fastapi_offline import FastAPIOffline
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp

from ogm_core.errors import OgmError, cut
from ogm_core.status import SnapshotList, Status
from ogm_core.wire.keys import Write
from ogm_core.wire.map_update import MEDIA_TYPE as UPDATES_TYPE
from ogm_services.mapper.serving.allowed_methods import allowed_methods
from ogm_services.mapper.serving.answering_threads import AnsweringThreads
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.api_description import MAP_HEADERS, TAGS, Operation, describe
from ogm_services.mapper.serving.behind_proxies import check_root_path
from ogm_services.mapper.serving.content_coding import accepted_by
from ogm_services.mapper.serving.handlers import Handler, add_get, in_turn, parameters_of, plain
from ogm_services.mapper.serving.health import Health
from ogm_services.mapper.serving.http_access import HttpAccess
from ogm_services.mapper.serving.http_middlewares import middlewares
from ogm_services.mapper.serving.json_models import CellState, OccupancyMap, Quality, Version
from ogm_services.mapper.serving.live_route import add_live_route
from ogm_services.mapper.serving.login_routes import add_login_routes
from ogm_services.mapper.serving.map_formats import MAP_FORMATS, UPDATES_FORMAT
from ogm_services.mapper.serving.map_parameters import CELL_X, CELL_Y, FINE_FIRST
from ogm_services.mapper.serving.map_updates import UPDATES_PARAMETERS
from ogm_services.mapper.serving.metrics import MEDIA_TYPE as METRICS_TYPE
from ogm_services.mapper.serving.metrics import Metrics
from ogm_services.mapper.serving.page_routes import add_page_routes
from ogm_services.mapper.serving.query_routes import add_query_routes
from ogm_services.mapper.serving.ready_maps import NO_STORE, Ready, ReadyMaps
from ogm_services.mapper.serving.refusals import refusal
from ogm_services.mapper.serving.tile_routes import add_tile_routes
from ogm_services.mapper.serving.write_access import WriteAccess
from ogm_services.mapper.serving.write_routes import add_write_routes
from ogm_services.mapper.serving.writes import DoWrite
from ogm_services.replies.answer import Answer, Parameters
from ogm_services.replies.in_flight import InFlight
from ogm_services.replies.problems import MEDIA_TYPE, problem, slug_of
from ogm_services.replies.turns import Turns

NOT_FOUND = 404
METHOD_NOT_ALLOWED = 405

log = logging.getLogger(__name__)


def build_app(
    answers: Answers,
    health: Health,
    writes: Mapping[Write, DoWrite],
    metrics: Metrics,
    *,
    access: HttpAccess,
    threads: AnsweringThreads,
    in_flight: InFlight | None = None,
    live: ASGIApp | None = None,
) -> FastAPI:
    """Make the application; nothing is computed before a request comes.

    It answers by `threads`, which belong to the caller. `in_flight` counts what is being sent.
    `live` serves WebSocket clients.

    Raises:
        BadSetting: the path that it is served under has routes of its own.
    """
    write_access = WriteAccess(access.token)
    app, ready = _begun(answers, metrics, access, write_access, in_flight)
    _add_map_routes(app, threads.maps, answers, ready)
    add_tile_routes(app, threads.maps, answers, ready)
    add_query_routes(app, answers, ready, threads.maps)
    add_page_routes(app, answers.free_below)
    _add_state_routes(app, threads, answers)
    _add_service_routes(app, threads.status, answers, health, metrics)
    if live is not None:
        add_live_route(app, live)
    add_write_routes(app, writes, threads.writes)
    add_login_routes(app, write_access, answers)
    return _finished(app, access)


def build_share_app(
    answers: Answers,
    health: Health,
    metrics: Metrics,
    *,
    access: HttpAccess,
    threads: AnsweringThreads,
    in_flight: InFlight,
    what: str,
) -> FastAPI:
    """Make the application of one share of a map: probes, status and metrics; of the map it has but a part.

    `what` it is, for who asks for more.

    Raises:
        BadSetting: as `build_app`.
    """

    async def show_what(_: Request) -> Response:
        return PlainTextResponse(f"{what}: here are /status, /livez, /readyz, /metrics and /version\n")

    app, _ = _begun(answers, metrics, access, WriteAccess(access.token), in_flight)
    named = Operation("get_what", "mapper", "Which share of which map this is", "text/plain", problems=())
    add_get(app, "/", show_what, named)
    _add_status_route(app, threads.status, answers)
    _add_service_routes(app, threads.status, answers, health, metrics)
    return _finished(app, access, elsewhere=f"this is {what}: ask a gateway (`ogm gateway`)")


def _begun(
    answers: Answers,
    metrics: Metrics,
    access: HttpAccess,
    write_access: WriteAccess,
    in_flight: InFlight | None,
) -> tuple[FastAPI, ReadyMaps]:
    """An application without routes, behind all middlewares; and the maps that these send again."""
    app = FastAPIOffline(
        title="zenoh-ogm mapper",
        version=importlib.metadata.version("zenoh-ogm"),
        description="A live occupancy grid map of robots' poses and 2D LiDAR scans.",
        redoc_url=None,
        openapi_tags=[{"name": name, "description": said} for name, said in TAGS.items()],
    )
    ready = ReadyMaps(answers)
    answers.memory.count(ready)
    for each in reversed(
        middlewares(
            *(app.routes, access, write_access, ready),
            in_flight=in_flight or InFlight(),
            measurements=metrics.measurements,
        )
    ):
        app.add_middleware(each.cls, *each.args, **each.kwargs)  # outside those that are added already
    return app, ready


def _finished(app: FastAPI, access: HttpAccess, elsewhere: str = "") -> FastAPI:
    """The application with all of its routes, described, and with answers for what goes wrong.

    `elsewhere` says where there is more than its routes.
    """
    describe(app)
    check_root_path(access.root_path, app.routes, "http.root_path")
    app.add_exception_handler(OgmError, _ogm_error)
    app.add_exception_handler(HTTPException, partial(_http_error, elsewhere))
    app.add_exception_handler(Exception, _bug)
    return app


def _add_map_routes(app: FastAPI, turns: Turns, answers: Answers, ready: ReadyMaps) -> None:
    for form, wanted in MAP_FORMATS.items():
        operation = Operation(
            *(f"get_map_{form}", "map", f"The map as {form.upper()}", wanted.media_type),
            model=OccupancyMap if form == "json" else None,
            problems=(404, 503),
            parameters=answers.map_parameters(form),
            headers=MAP_HEADERS,
        )
        add_get(app, f"/map.{form}", _map_handler(turns, answers, ready, form), operation)
    changes = Operation(
        *("get_map_tiles", "map", "What has changed of the map", UPDATES_TYPE),
        parameters=UPDATES_PARAMETERS,
        headers=MAP_HEADERS,
    )
    handler = _map_handler(turns, answers, ready, UPDATES_FORMAT)
    add_get(app, f"/map.{UPDATES_FORMAT}", handler, changes)


def _add_state_routes(app: FastAPI, threads: AnsweringThreads, answers: Answers) -> None:
    maps = threads.maps
    place = CELL_X, CELL_Y, FINE_FIRST
    cell = Operation("get_cell", "queries", "One cell", model=CellState, parameters=place)
    add_get(app, "/cell", _handler(maps, answers.cell), cell)
    saved = Operation("list_snapshots", "map", "The maps that are saved", model=SnapshotList)
    add_get(app, "/snapshots", _handler(maps, answers.snapshots), saved)
    quality = Operation("get_quality", "mapper", "The quality figures", model=Quality)
    add_get(app, "/quality", _handler(maps, answers.quality), quality)
    _add_status_route(app, threads.status, answers)


def _add_status_route(app: FastAPI, turns: Turns, answers: Answers) -> None:
    status = Operation("get_status", "mapper", "The mapper's status", model=Status)
    add_get(app, "/status", _handler(turns, answers.status), status)


def _add_service_routes(
    app: FastAPI, turns: Turns, answers: Answers, health: Health, metrics: Metrics
) -> None:
    async def livez(_: Request) -> Response:
        return _probe(health.not_alive())

    async def readyz(_: Request) -> Response:
        return _probe(health.not_ready())

    async def show_metrics(_: Request) -> Response:
        text = await in_turn(turns, lambda: metrics.text(answers.status_since_start()))
        return PlainTextResponse(text, media_type=METRICS_TYPE)

    async def show_version(_: Request) -> Response:
        return JSONResponse({"name": "zenoh-ogm", "version": app.version})

    def probe(id_: str, summary: str) -> Operation:
        return Operation(id_, "mapper", summary, "text/plain", problems=(), probe=True)

    summary = "Whether the mapper works: 200 or 503"
    add_get(app, "/livez", livez, probe("get_livez", summary))
    summary = "Whether it should get scans: 200, or 503 and why not"
    add_get(app, "/readyz", readyz, probe("get_readyz", summary))
    metered = Operation("get_metrics", "mapper", "Metrics for Prometheus", "text/plain")
    add_get(app, "/metrics", show_metrics, metered)
    summary = "Name and version of this program"
    named = Operation("get_version", "mapper", summary, model=Version, problems=())
    add_get(app, "/version", show_version, named)


def _handler(turns: Turns, answer: Callable[[Parameters], Answer]) -> Handler:
    async def handle(request: Request) -> Response:
        return plain(await in_turn(turns, partial(answer, parameters_of(request))))

    return handle


def _map_handler(turns: Turns, answers: Answers, ready: ReadyMaps, form: str) -> Handler:
    async def handle(request: Request) -> Response:
        given = parameters_of(request)
        taken = accepted_by(request.scope)
        return ready.shown(request, await in_turn(turns, lambda: Ready.map(answers.map(form, given), taken)))

    return handle


def _probe(trouble: str | None) -> Response:
    return PlainTextResponse(trouble or "ok", status_code=503 if trouble else 200)


async def _ogm_error(_: Request, error: Exception) -> Response:
    assert isinstance(error, OgmError)
    return refusal(error)


async def _http_error(elsewhere: str, request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    detail, headers = str(error.detail), dict(error.headers or {})
    if error.status_code == NOT_FOUND and elsewhere:
        detail = f"{cut(request.url.path)} is not here: {elsewhere}"
    if error.status_code == METHOD_NOT_ALLOWED:
        allowed = headers["Allow"] = allowed_methods(request.app.routes, request.scope)
        detail = f"{cut(request.method)} is not for {cut(request.url.path)}: {allowed} are"
    body = problem(slug_of(error.status_code), error.status_code, detail)
    return Response(body, error.status_code, headers, MEDIA_TYPE)


async def _bug(request: Request, error: Exception) -> Response:
    log.error("%s %s failed", request.method, request.url.path, exc_info=error)
    body = problem("internal", 500, "the mapper failed; see its log")
    return Response(body, 500, NO_STORE, MEDIA_TYPE)  # it does not pass through _NoStore
