"""Routes of writes over HTTP: who may ask is the middleware's matter, by their methods."""

from collections.abc import Mapping, Sequence
from functools import partial

from fastapi import FastAPI, Request, Response

from ogm_core.status import Erasure, Forgotten, SnapshotInfo, SnapshotList, Status
from ogm_core.wire.keys import Write
from ogm_services.mapper.serving.api_description import Operation
from ogm_services.mapper.serving.handlers import Handler, in_turn, parameters_of, plain
from ogm_services.mapper.serving.map_parameters import ERASED_REGION, POLYGON, ROBOT, SNAPSHOT_NAME
from ogm_services.mapper.serving.query_parameters import Parameter
from ogm_services.mapper.serving.writes import DoWrite
from ogm_services.replies.answer import Parameters
from ogm_services.replies.turns import Turns

_OF_WRITES = (401, 403, 413, 429, 503)
_AREA = (ERASED_REGION, POLYGON)
_NAME = (SNAPSHOT_NAME,)
OF_STORES: frozenset[Write] = frozenset({"save", "restore", "delete"})
"""What only a mapper can do that stores its map."""
_DELETES: frozenset[Write] = frozenset({"delete", "forget"})


def add_write_routes(app: FastAPI, writes: Mapping[Write, DoWrite], turns: Turns) -> None:
    """Add them; the threads of `turns` wait for the worker and the disk."""

    def handler(write: Write) -> Handler:
        async def handle(request: Request) -> Response:
            who = request.client.host if request.client else "somebody"
            given = _named(request)
            return plain(await in_turn(turns, partial(writes[write], given, f"{who} over HTTP")))

        return handle

    for path, write, operation in _OPERATIONS:
        method = "DELETE" if write in _DELETES else "POST"
        app.add_api_route(path, handler(write), methods=[method], **operation.options())


def _operation(
    id_: str,
    summary: str,
    model: type,
    problems: tuple[int, ...] = (),
    *,
    parameters: tuple[Parameter, ...] = (),
    in_path: tuple[Parameter, ...] = (),
) -> Operation:
    return Operation(
        *(id_, "changes", summary),
        model=model,
        problems=(*_OF_WRITES, *problems),
        parameters=parameters,
        path_parameters=in_path,
    )


_ERASE = "Make the cells unknown whose centre lies in a region or a polygon: the next revision"
_FORGET = "Leave a robot out of the map: the next revision, that of all others' scans"
_SAVE = "Save the map of this moment under a name"
_RESTORE = "Go on with the map that was saved under a name: a new epoch, the revision that was saved"
_DELETE = "Delete the map that was saved under a name; those that are left"
_OPERATIONS: Sequence[tuple[str, Write, Operation]] = (
    ("/reset", "reset", _operation("reset", "Empty the map: a new epoch, revision 0", Status, (507,))),
    ("/erase", "erase", _operation("erase", _ERASE, Erasure, (404, 507), parameters=_AREA)),
    (
        "/robots/{robot}",
        "forget",
        _operation("forget_robot", _FORGET, Forgotten, (404, 409, 507), in_path=(ROBOT,)),
    ),
    ("/save", "save", _operation("save", _SAVE, SnapshotInfo, (409, 507), parameters=_NAME)),
    ("/restore", "restore", _operation("restore", _RESTORE, Status, (404, 507), parameters=_NAME)),
    (
        "/snapshots/{name}",
        "delete",
        _operation("delete_snapshot", _DELETE, SnapshotList, (404,), in_path=_NAME),
    ),
)


def _named(request: Request) -> Parameters:
    """The parameters of a request, in its query, or the name in its path."""
    return {**parameters_of(request, allowed=not request.path_params), **request.path_params}
