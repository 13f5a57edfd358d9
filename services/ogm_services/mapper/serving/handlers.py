"""Handlers of HTTP requests: what every route does with a request, an answer, and the threads between."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import TypeVar

from fastapi import FastAPI, Request, Response

from ogm_core.errors import BadParameter, cut
from ogm_services.mapper.serving.api_description import Operation
from ogm_services.replies.answer import Answer, Parameters
from ogm_services.replies.turns import Turns

Handler = Callable[[Request], Awaitable[Response]]
_T = TypeVar("_T")


def add_get(app: FastAPI, path: str, handler: Handler, operation: Operation) -> None:
    """Route GET, and HEAD with it (see `AllowedMethods`)."""
    app.add_api_route(path, handler, **operation.options())


async def in_turn(turns: Turns, answer: Callable[[], _T]) -> _T:
    """What `answer` returns, made by a thread of that share; Busy if its turn does not come soon."""
    return await asyncio.wrap_future(turns.take(answer))


def parameters_of(request: Request, *, allowed: bool = True) -> Parameters:
    """The query parameters of a request.

    Raises:
        BadParameter: one is given twice, or at all, where none is `allowed`.
    """
    given: dict[str, str] = {}
    for name, value in request.query_params.multi_items():
        if name in given or not allowed:
            raise BadParameter(
                f"{cut(name)}: {'given twice' if allowed else 'unknown parameter; there are none'}"
            )
        given[name] = value
    return given


def plain(answer: Answer) -> Response:
    """The response of an answer that is no map."""
    return Response(answer.body, media_type=answer.media_type)
