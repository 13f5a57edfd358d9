"""Routes of queries over HTTP: what is computed from the map for who asks."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from fastapi import FastAPI, Request, Response

from ogm_core.queries.replies import CheckReply, RaycastReply
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.api_description import responses
from ogm_services.mapper.serving.checks import BODY, MAX_BODY
from ogm_services.mapper.serving.handlers import Handler, in_turn, parameters_of, plain
from ogm_services.mapper.serving.queries import Queries
from ogm_services.mapper.serving.query_parameters import Parameter, described
from ogm_services.mapper.serving.raycasts import RAYCAST
from ogm_services.replies.answer import Answer, Parameters
from ogm_services.replies.turns import Turns

CHECK = "/check"
READS = frozenset({CHECK})
"""Paths that are asked by POST, with what is asked as the body, and change nothing."""
BODIES = {CHECK.encode(): MAX_BODY}
"""How long bodies may be, bytes, by the path that they are sent to."""


def add_query_routes(app: FastAPI, answers: Answers, turns: Turns) -> None:
    """Add them; the threads of `turns` compute."""

    def handler(query: Callable[[Queries, Parameters], Answer]) -> Handler:
        async def handle(request: Request) -> Response:
            given = parameters_of(request)
            return plain(await in_turn(turns, lambda: query(answers.queries, given)))

        return handle

    summary = "Cast rays from a point: how far each goes, and whether an occupied or an unknown cell ends it"
    described_answers = responses("application/json", RaycastReply, problems=(404, 503))

    async def check(request: Request) -> Response:
        given, body = parameters_of(request), await request.body()
        return plain(await in_turn(turns, lambda: answers.queries.check(given, body)))

    _add(app, "/raycast", handler(Queries.raycast), described_answers, summary, RAYCAST)
    app.add_api_route(
        CHECK,
        check,
        methods=["POST"],
        summary="Check whether points or footprints, grown by a margin, are free, occupied or unknown",
        response_class=Response,
        responses=responses("application/json", CheckReply, problems=(403, 413, 503)),
        openapi_extra={"requestBody": BODY},
    )


def _add(
    app: FastAPI,
    path: str,
    handler: Handler,
    answers: dict[int | str, dict[str, Any]],
    summary: str,
    parameters: Sequence[Parameter],
) -> None:
    """Route GET and HEAD."""
    add = partial(app.add_api_route, path, handler)
    extra = {"parameters": described(parameters)}
    add(summary=summary, response_class=Response, responses=answers, openapi_extra=extra)
    add(methods=["HEAD"], include_in_schema=False)
