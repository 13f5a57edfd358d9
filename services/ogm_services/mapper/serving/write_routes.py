"""Routes of writes over HTTP: who may ask is the middleware's matter, by their methods."""

from collections.abc import Mapping, Sequence
from functools import partial

from fastapi import FastAPI, Request, Response

from ogm_core.status import Erasure, SnapshotInfo, SnapshotList, Status
from ogm_core.wire.keys import Write
from ogm_services.mapper.serving.api_description import described_parameters, responses
from ogm_services.mapper.serving.handlers import Handler, in_turn, parameters_of, plain
from ogm_services.mapper.serving.writes import DoWrite
from ogm_services.replies.answer import Parameters
from ogm_services.replies.turns import Turns

_OF_WRITES = (401, 403, 413, 429, 503)
_PARAMETERS: Mapping[Write, Sequence[str]] = {"reset": (), "erase": ("region", "polygon")}
"""Of the others it is the name of a saved map."""
WITHOUT_STORE: frozenset[Write] = frozenset({"reset", "erase"})
"""What a mapper can do that stores no map."""


def add_write_routes(app: FastAPI, writes: Mapping[Write, DoWrite], turns: Turns) -> None:
    """Add them; the threads of `turns` wait for the worker and the disk."""

    def handler(write: Write) -> Handler:
        async def handle(request: Request) -> Response:
            who = request.client.host if request.client else "somebody"
            given = _named(request)
            return plain(await in_turn(turns, partial(writes[write], given, f"{who} over HTTP")))

        return handle

    def add(
        method: str, path: str, write: Write, summary: str, model: type, problems: tuple[int, ...]
    ) -> None:
        place = "path" if "{name}" in path else "query"
        parameters = described_parameters(_PARAMETERS.get(write, ["name"]), place)
        app.add_api_route(
            path,
            handler(write),
            methods=[method],
            summary=summary,
            response_class=Response,
            responses=responses("application/json", model, problems=(*_OF_WRITES, *problems)),
            openapi_extra={"parameters": parameters} if parameters else None,
        )

    add("POST", "/reset", "reset", "Empty the map: a new epoch, revision 0", Status, ())
    summary = "Make the cells unknown whose centre lies in a region or a polygon: the next revision"
    add("POST", "/erase", "erase", summary, Erasure, (404, 507))
    add("POST", "/save", "save", "Save the map of this moment under a name", SnapshotInfo, (409, 507))
    summary = "Go on with the map that was saved under a name: a new epoch, the revision that was saved"
    add("POST", "/restore", "restore", summary, Status, (404, 507))
    summary = "Delete the map that was saved under a name; those that are left"
    add("DELETE", "/snapshots/{name}", "delete", summary, SnapshotList, (404,))


def _named(request: Request) -> Parameters:
    """The parameters of a request, in its query, or the name in its path."""
    return {**parameters_of(request, allowed=not request.path_params), **request.path_params}
