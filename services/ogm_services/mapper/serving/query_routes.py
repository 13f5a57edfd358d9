"""Routes of queries over HTTP: what is computed from the map for who asks."""

from collections.abc import Callable, Mapping

from fastapi import FastAPI, Request, Response

from ogm_core.queries.replies import CheckReply, RaycastReply
from ogm_core.wire.keys import Query
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.api_description import MAP_HEADERS, Operation
from ogm_services.mapper.serving.checks import MAX_BODY
from ogm_services.mapper.serving.handlers import Handler, add_get, in_turn, parameters_of, plain
from ogm_services.mapper.serving.json_models import FootprintsToCheck, PointsToCheck
from ogm_services.mapper.serving.layers import LAYER_FORMATS, layer_parameters
from ogm_services.mapper.serving.queries import Queries
from ogm_services.mapper.serving.raycasts import RAYCAST
from ogm_services.mapper.serving.ready_maps import Ready, ReadyMaps
from ogm_services.replies.answer import Answer, Parameters
from ogm_services.replies.turns import Turns

CHECK = "/check"
READS = frozenset({CHECK})
"""Paths that are asked by POST, with what is asked as the body, and change nothing."""
BODIES = {CHECK.encode(): MAX_BODY}
"""How long bodies may be, bytes, by the path that they are sent to."""

_RAYCAST = Operation(
    "raycast",
    "queries",
    "Cast rays from a point: how far each goes, and whether an occupied or an unknown cell ends it",
    model=RaycastReply,
    problems=(404, 503),
    parameters=RAYCAST,
)
_CHECK = Operation(
    "check",
    "queries",
    "Check whether points or footprints, grown by a margin, are free, occupied or unknown",
    model=CheckReply,
    problems=(403, 413, 503),
    body=(PointsToCheck, FootprintsToCheck),
)
_LAYERS: Mapping[Query, tuple[str, Callable[[Queries, str, Parameters], Answer]]] = {
    "distance": ("Metres from every cell to the nearest occupied one", Queries.distance),
    "inflate": ("The map with all occupied within a radius of what is", Queries.inflate),
}


def add_query_routes(app: FastAPI, answers: Answers, ready: ReadyMaps, turns: Turns) -> None:
    """Add them; the threads of `turns` compute."""

    async def raycast(request: Request) -> Response:
        given = parameters_of(request)
        return plain(await in_turn(turns, lambda: answers.queries.raycast(given)))

    async def check(request: Request) -> Response:
        given, body = parameters_of(request), await request.body()
        return plain(await in_turn(turns, lambda: answers.queries.check(given, body)))

    add_get(app, "/raycast", raycast, _RAYCAST)
    app.add_api_route(CHECK, check, methods=["POST"], **_CHECK.options())
    _add_layers(app, answers, ready, turns)


def _add_layers(app: FastAPI, answers: Answers, ready: ReadyMaps, turns: Turns) -> None:
    def handler(made: Callable[[Queries, str, Parameters], Answer], form: str) -> Handler:
        async def handle(request: Request) -> Response:
            given = parameters_of(request)
            answer = await in_turn(turns, lambda: made(answers.queries, form, given))
            return ready.shown(request, Ready.map(answer))

        return handle

    for form, media_type in LAYER_FORMATS.items():
        for name, (summary, made) in _LAYERS.items():
            operation = Operation(
                *(f"get_{name}_{form}", "queries", f"{summary}, as {form.upper()}", media_type),
                problems=(404, 503),
                parameters=layer_parameters(name, form),
                headers=MAP_HEADERS,
            )
            add_get(app, f"/{name}.{form}", handler(made, form), operation)
