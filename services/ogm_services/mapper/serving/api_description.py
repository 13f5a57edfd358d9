"""OpenAPI description of the mapper's HTTP routes: what each is called, what it takes, and may answer."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from fastapi import FastAPI, Response
from pydantic import BaseModel
from pydantic.json_schema import JsonSchemaMode, models_json_schema

from ogm_services.mapper.serving.json_models import FootprintsToCheck, LoginToken, PointsToCheck, Problem
from ogm_services.mapper.serving.query_parameters import Parameter, TextParameter, described
from ogm_services.replies.problems import MEDIA_TYPE

Tag = Literal["map", "tiles", "queries", "mapper", "changes", "login"]
TAGS = {
    "map": "The map as a file or a picture, live or as it was saved, and what has changed of it.",
    "tiles": "The map as pictures of 256 x 256 pixels, for viewers.",
    "queries": "What is computed from the map for who asks; nothing changes.",
    "mapper": "How the mapper and its map are.",
    "changes": "What changes the map, or those that are saved: with the mapper's token, where it has one.",
    "login": "How a page gets a cookie in place of the token.",
}
_TEXTS = "text/", "application/yaml"
_REF = "#/components/schemas/{model}"
_MODELS: list[tuple[type[BaseModel], JsonSchemaMode]] = [
    (Problem, "serialization"),
    (PointsToCheck, "validation"),
    (FootprintsToCheck, "validation"),
    (LoginToken, "validation"),
]
"""Those that FastAPI does not know of: it knows of what is answered with 200."""
_BEARER = "token"
_TOKEN = {"type": "http", "scheme": "bearer", "description": "http.token of the mapper's settings"}


class Header(NamedTuple):
    """A header of an answer: what it means, and whether it is always there."""

    said: str
    always: bool = True


Headers = Mapping[str, Header]

_PROBLEMS = {
    400: "The request is ill-formed, or a parameter is unknown or wrong",
    401: "A write needs the mapper's token",
    403: "A page of another origin asks for a write",
    404: "The map has no known cell, or none is saved under this name, or there are no tiles or robot there",
    409: "A map is saved under this name already, or the map does not keep robots apart",
    412: "The map is not the one that If-Match names",
    413: "The body is longer than a write's may be",
    421: "The Host header is no name of this mapper",
    429: "Too many wrong tokens came from this address: Retry-After says when to try again",
    500: "The mapper failed, or a saved map is damaged",
    503: "The mapper is starting, stopping or busy: Retry-After says when to ask again; or it stores no map",
    507: "The disk is full",
}
_OF_EVERY_ROUTE = (400, 421, 500)
_OF_ANY_REQUEST = "It was refused before it came to its route: 405, 408, 413, 414, 431"
_PROBLEM_HEADERS: Mapping[int, Headers] = {
    401: {"WWW-Authenticate": Header("The scheme, Bearer, and what is wrong with a token that was given")},
    429: {"Retry-After": Header("Seconds to wait before trying again")},
    503: {"Retry-After": Header("Seconds to wait before asking again; not where no map is stored", False)},
}

_EPOCH = Header("Id of the map's life: another one since it was made or emptied")
MAP_HEADERS: Headers = {
    "ETag": Header('"EPOCH-RUN-REVISION", of a body that is packed "EPOCH-RUN-REVISION;gzip": a validator'),
    "OGM-Resolution": Header("Metres per pixel"),
    "OGM-Origin": Header("x,y of the lower-left corner, metres"),
    "OGM-Epoch": _EPOCH,
    "OGM-Run": Header("Id of the mapper's process: another one since it was started"),
    "OGM-Revision": Header("Scans integrated, and erasures, in this life"),
    "OGM-Stamp": Header("That of the newest integrated scan, ns since the Unix epoch, or null"),
}
TILE_HEADERS: Headers = {
    "ETag": Header('"EPOCH-RUN-REVISION" of the tile, or "EPOCH-empty", for If-None-Match and If-Match'),
    "OGM-Resolution": Header("Metres per pixel"),
    "OGM-Epoch": _EPOCH,
    "OGM-Run": Header("Id of the mapper's process; not of an empty tile", False),
    "OGM-Revision": Header("Of the map, when the tile last changed; not of an empty tile", False),
}
_VALIDATORS = (
    TextParameter(
        "If-None-Match",
        "the ETag of what is there already: 304, without a body, if that has not changed",
        '"5f2b-91c0-1200"',
    ),
    TextParameter(
        "If-Match", "the ETag of the map that is wanted: 412 if it is another one by now", '"5f2b-91c0-1200"'
    ),
)


@dataclass(frozen=True, slots=True)
class Operation:
    """What is said of a route: its id, as generated clients name their functions, its tag and its summary.

    It answers with a body of `media_type`, JSON of a `model` if there is one, or a problem of one of those
    statuses, besides those that every route may answer. With `headers`, one of which is the ETag, it heeds
    validators.
    """

    id: str
    tag: Tag
    summary: str
    media_type: str = "application/json"
    model: type | None = None
    problems: tuple[int, ...] = (503,)
    parameters: tuple[Parameter, ...] = ()
    path_parameters: tuple[Parameter, ...] = ()
    body: tuple[type, ...] = ()
    """JSON of one of these models is what is asked."""
    headers: Headers = field(default_factory=dict)
    probe: bool = False
    """Whether a 503 is plain text, like all that it answers."""

    def options(self) -> dict[str, Any]:
        """What FastAPI is told of the route."""
        extra: dict[str, Any] = {}
        parameters = [*described(self.path_parameters, "path"), *described(self.parameters)]
        if self.headers:
            parameters += described(_VALIDATORS, "header")
        if parameters:
            extra["parameters"] = parameters
        if self.body:
            bodies = [{"$ref": _ref(model)} for model in self.body]
            schema = {"oneOf": bodies} if len(bodies) > 1 else bodies[0]
            content = {self.media_type: {"schema": schema}}
            extra["requestBody"] = {"required": True, "content": content}
        if self.tag == "changes":
            extra["security"] = [{_BEARER: []}, {}]
        return {
            "operation_id": self.id,
            "tags": [self.tag],
            "summary": self.summary,
            "response_class": Response,  # without a media type of its own, so that this one stands alone
            "responses": self._responses(),
            "openapi_extra": extra,
        }

    def _responses(self) -> dict[int | str, dict[str, Any]]:
        whole: dict[str, Any] = {"description": self.summary, "model": self.model}
        if self.model is None:
            binary = {} if self.media_type.startswith(_TEXTS) else {"format": "binary"}
            whole["content"] = {self.media_type: {"schema": {"type": "string", **binary}}}
        said: dict[int | str, dict[str, Any]] = {200: whole}
        if self.headers:
            headers = _headers(self.headers)
            said[200] |= {"headers": headers}
            said[304] = {"description": "It is the one that If-None-Match names", "headers": headers}
        also = (412,) if self.headers else ()
        for status in sorted({*_OF_EVERY_ROUTE, *also, *self.problems}):
            said[status] = _problem(_PROBLEMS[status], _PROBLEM_HEADERS.get(status, {}))
        if self.probe:
            said[503] = {"description": "It is not; the text says why", "content": whole["content"]}
        return said | {"default": _problem(_OF_ANY_REQUEST)}


def describe(app: FastAPI) -> None:
    """Have the description of an application say all that FastAPI does not know of."""
    made: Callable[[], dict[str, Any]] = app.openapi

    def openapi() -> dict[str, Any]:
        document = made()
        _, models = models_json_schema(_MODELS, ref_template=_REF)
        components = document.setdefault("components", {})
        components["schemas"] = {**components.get("schemas", {}), **models["$defs"]}
        components["securitySchemes"] = {_BEARER: _TOKEN}
        return document

    app.openapi = openapi  # type: ignore[method-assign]  # FastAPI's own way to extend it


def _problem(said: str, headers: Headers | None = None) -> dict[str, Any]:
    described = {"description": said, "content": {MEDIA_TYPE: {"schema": {"$ref": _ref(Problem)}}}}
    return described | ({"headers": _headers(headers)} if headers else {})


def _headers(headers: Headers) -> dict[str, Any]:
    return {
        name: {"description": header.said, "required": header.always, "schema": {"type": "string"}}
        for name, header in headers.items()
    }


def _ref(model: type) -> str:
    return _REF.format(model=model.__name__)
