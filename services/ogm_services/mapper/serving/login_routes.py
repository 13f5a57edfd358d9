"""Routes of log-ins: what a page asks to know whether it may write, and where it gives the token once."""

from dataclasses import asdict, dataclass
from typing import get_args

import orjson
from fastapi import FastAPI, Request, Response
from starlette.types import Scope

from ogm_core.errors import BadParameter
from ogm_core.wire.keys import Write
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.api_description import Operation
from ogm_services.mapper.serving.bearer_token import challenge
from ogm_services.mapper.serving.handlers import add_get, parameters_of
from ogm_services.mapper.serving.json_models import LoginToken
from ogm_services.mapper.serving.refusals import refusal
from ogm_services.mapper.serving.write_access import WriteAccess
from ogm_services.mapper.serving.write_routes import OF_STORES
from ogm_services.replies.answer import Unauthorized

LOGIN, LOGOUT = "/login", "/logout"
LOG_IN_PATHS = frozenset({LOGIN, LOGOUT})
"""They are asked by POST, and need no token that is given before."""
_FORM = 'body: a JSON object is needed: {"token": "..."}'


@dataclass(frozen=True, slots=True)
class LoginState:
    """Whether who asks may write, and what there is to write.

    `token_needed`: not everybody may; `logged_in`: by the cookie that came with the request; `may_write`: by
    that, by the token that came with it, or because none is needed; `writes`: what this mapper can do.
    """

    token_needed: bool
    logged_in: bool
    may_write: bool
    writes: list[Write]


_SHOW = Operation(
    *("get_login", "login", "Whether who asks may write, and what there is to write"),
    model=LoginState,
    problems=(),
)
_LOG_IN = Operation(
    *("log_in", "login", "Get a cookie for the token, with which a page may write"),
    model=LoginState,
    problems=(401, 403, 413, 429),
    body=(LoginToken,),
)
_LOG_OUT = Operation(*("log_out", "login", "Make that cookie void"), model=LoginState, problems=(403, 413))


def add_login_routes(app: FastAPI, access: WriteAccess, answers: Answers) -> None:
    """Add them; `answers` know whether maps can be saved, areas erased, and robots left out."""

    def state(scope: Scope, *, logged_in: bool) -> Response:
        may_write = logged_in or access.problem(scope) is None
        told = LoginState(access.token_needed, logged_in, may_write, _writes(answers))
        return Response(orjson.dumps(asdict(told)), media_type="application/json")

    async def show(request: Request) -> Response:
        parameters_of(request, allowed=False)
        return state(request.scope, logged_in=access.log_ins.has(request.scope))

    async def log_in(request: Request) -> Response:
        parameters_of(request, allowed=False)
        token = _token_in(await request.body())
        if not access.token_needed:
            return state(request.scope, logged_in=False)
        error = access.problem_of(request.scope, token)
        if error is not None:
            if isinstance(error, Unauthorized):
                error = Unauthorized(f"POST {LOGIN}: refused: {error}")
            return refusal(error, challenge(invalid=True))
        response = state(request.scope, logged_in=True)
        response.headers["Set-Cookie"] = access.log_ins.begin(request.scope)
        return response

    async def log_out(request: Request) -> Response:
        parameters_of(request, allowed=False)
        forgotten = access.log_ins.end(request.scope)
        response = state(request.scope, logged_in=False)
        response.headers["Set-Cookie"] = forgotten
        return response

    add_get(app, LOGIN, show, _SHOW)
    app.add_api_route(LOGIN, log_in, methods=["POST"], **_LOG_IN.options())
    app.add_api_route(LOGOUT, log_out, methods=["POST"], **_LOG_OUT.options())


def _writes(answers: Answers) -> list[Write]:
    """What there is to write."""
    return [
        name
        for name in get_args(Write)
        if (answers.saves or name not in OF_STORES)
        and (answers.keeps_robots or name != "forget")
        and (answers.erases or name != "erase")
    ]


def _token_in(body: bytes) -> bytes:
    try:
        given = orjson.loads(body)
    except orjson.JSONDecodeError:
        raise BadParameter(_FORM) from None  # without what was sent, which may be the token
    if not isinstance(given, dict) or set(given) != {"token"} or not isinstance(given["token"], str):
        raise BadParameter(_FORM)
    return given["token"].encode()
