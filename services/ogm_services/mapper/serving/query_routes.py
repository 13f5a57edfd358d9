"""Routes of queries over HTTP: what is computed from the map for who asks."""

from collections.abc import Callable

from fastapi import FastAPI, Request, Response

from ogm_core.queries.replies import CheckReply, RaycastReply
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.api_description import described_parameters, map_responses, responses
from ogm_services.mapper.serving.checks import BODY, MAX_BODY
from ogm_services.mapper.serving.handlers import Handler, add_get, in_turn, parameters_of, plain
from ogm_services.mapper.serving.layers import (
    DISTANCE_OF_ARRAY,
    DISTANCE_OF_PICTURE,
    LAYER_FORMATS,
    RADIUS,
)
from ogm_services.mapper.serving.queries import Queries
from ogm_services.mapper.serving.query_parameters import described
from ogm_services.mapper.serving.raycasts import RAYCAST
from ogm_services.mapper.serving.ready_maps import Ready, ReadyMaps
from ogm_services.replies.answer import Answer, Parameters
from ogm_services.replies.turns import Turns

CHECK = "/check"
READS = frozenset({CHECK})
"""Paths that are asked by POST, with what is asked as the body, and change nothing."""
BODIES = {CHECK.encode(): MAX_BODY}
"""How long bodies may be, bytes, by the path that they are sent to."""


def add_query_routes(app: FastAPI, answers: Answers, ready: ReadyMaps, turns: Turns) -> None:
    """Add them; the threads of `turns` compute."""

    async def raycast(request: Request) -> Response:
        given = parameters_of(request)
        return plain(await in_turn(turns, lambda: answers.queries.raycast(given)))

    async def check(request: Request) -> Response:
        given, body = parameters_of(request), await request.body()
        return plain(await in_turn(turns, lambda: answers.queries.check(given, body)))

    summary = "Cast rays from a point: how far each goes, and whether an occupied or an unknown cell ends it"
    cast = responses("application/json", RaycastReply, problems=(404, 503))
    add_get(app, "/raycast", raycast, cast, summary, described(RAYCAST))
    app.add_api_route(
        CHECK,
        check,
        methods=["POST"],
        summary="Check whether points or footprints, grown by a margin, are free, occupied or unknown",
        response_class=Response,
        responses=responses("application/json", CheckReply, problems=(403, 413, 503)),
        openapi_extra={"requestBody": BODY},
    )
    _add_layers(app, answers, ready, turns)


def _add_layers(app: FastAPI, answers: Answers, ready: ReadyMaps, turns: Turns) -> None:
    def handler(made: Callable[[Queries, str, Parameters], Answer], form: str) -> Handler:
        async def handle(request: Request) -> Response:
            given = parameters_of(request)
            answer = await in_turn(turns, lambda: made(answers.queries, form, given))
            return ready.keep(request, Ready.map(answer))

        return handle

    region = described_parameters(["region"])
    for form, media_type in LAYER_FORMATS.items():
        farthest = DISTANCE_OF_PICTURE if form == "png" else DISTANCE_OF_ARRAY
        summary = f"Metres from every cell to the nearest occupied one, as {form.upper()}"
        made, parameters = handler(Queries.distance, form), [*region, *described([farthest])]
        add_get(app, f"/distance.{form}", made, map_responses(media_type), summary, parameters)
        summary = f"The map with all occupied within a radius of what is, as {form.upper()}"
        made, parameters = handler(Queries.inflate, form), [*region, *described([RADIUS])]
        add_get(app, f"/inflate.{form}", made, map_responses(media_type), summary, parameters)
