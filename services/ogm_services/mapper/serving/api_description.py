"""OpenAPI description of the mapper's HTTP routes: their parameters, and what each of them may answer."""

from collections.abc import Iterable, Mapping
from typing import Any

from ogm_core.cells.value_bytes import COLOURS
from ogm_core.files.map_files import PALETTES, VALUES
from ogm_core.tiles.polygon import MAX_POINTS
from ogm_core.tiles.pyramid import LEAST_Z, NATIVE_Z
from ogm_core.wire.keys import NAME
from ogm_services.mapper.serving.map_tiles import MAX_PLACE
from ogm_services.mapper.serving.map_updates import SINCE
from ogm_services.replies.problems import MEDIA_TYPE

Responses = dict[int | str, dict[str, Any]]
Parameter = dict[str, Any]

_NUMBER = r"[-+]?[0-9]{1,6}(\.[0-9]{1,6})?"
_NAME = {"type": "string", "pattern": f"^{NAME.pattern}$"}
_PARAMETERS: dict[str, tuple[str, dict[str, Any]]] = {
    "region": (
        "xmin,ymin,xmax,ymax in metres, clipped to the map: rounded outward to cells, or, where they are "
        "erased, the cells whose centre it holds",
        {"type": "string", "pattern": f"^{_NUMBER}(,{_NUMBER}){{3}}$"},
    ),
    "polygon": (
        f"x1,y1,x2,y2,... in metres, 3 to {MAX_POINTS} corners in order, in place of a region: even-odd "
        "where it crosses itself",
        {"type": "string", "pattern": f"^{_NUMBER}(,{_NUMBER}){{5,{2 * MAX_POINTS - 1}}}$"},
    ),
    "palette": (
        "ros (trinary: 0 occupied, 254 free, 205 neither) or probability (brighter is occupied), both grey; "
        "cividis (the same in colours), dark (trinary), costmap (as RViz draws it)",
        {"type": "string", "enum": list(COLOURS)},
    ),
    "transparent": ("1: what is unknown is not drawn", {"type": "string", "enum": ["0", "1"]}),
    "rev": (
        "the tile's ETag without its quotes: while it is that, caches may keep the answer for good",
        {"type": "string"},
    ),
    "since": (
        "the map's ETag without its quotes: only the tiles that were written since; of another life of the "
        "map, or of a revision that is still to come, all of them",
        {"type": "string", "pattern": f"^{SINCE}$"},
    ),
    "max_size": (
        "longest side in pixels: the picture is shrunk by a whole factor",
        {"type": "integer", "minimum": 1, "maximum": 999_999_999},
    ),
    "values": (
        "percent (0 to 100, -1 unknown) or trinary (0, 100, -1)",
        {"type": "string", "enum": list(VALUES)},
    ),
    "at": (
        "the map as it was saved under this name (POST /save), in place of the live one",
        _NAME,
    ),
    "name": ("of the saved map", _NAME),
    "x": ("metres, map frame", {"type": "number"}),
    "y": ("metres, map frame", {"type": "number"}),
}
_GREY_PALETTE = (
    "ros (trinary: 0 occupied, 254 free, 205 neither) or probability (brighter is occupied)",
    {"type": "string", "enum": list(PALETTES)},
)
_REQUIRED = frozenset({"x", "y", "name"})
_PLACE = {
    "z": ("16: a pixel a cell; half as many with each below", LEAST_Z, NATIVE_Z),
    "x": ("tiles to the east of the map's anchor", 1 - MAX_PLACE, MAX_PLACE - 1),
    "y": ("tiles to the south of the one above the anchor, -1", 1 - MAX_PLACE, MAX_PLACE - 1),
}


_PROBLEM = {
    "type": "object",
    "required": ["type", "title", "status", "detail"],
    "properties": {name: {"type": "string"} for name in ("type", "title", "detail")}
    | {"status": {"type": "integer"}},
}
"""What went wrong (RFC 9457)."""
_PROBLEMS = {
    400: "The request is ill-formed, or a parameter is unknown or wrong",
    401: "A write needs the mapper's token",
    403: "A page of another origin asks for a write",
    404: "The map has no known cell, or none is saved under this name, or there are no tiles there",
    409: "A map is saved under this name already",
    412: "The map is not the one that If-Match names",
    413: "The body is longer than a write's may be",
    421: "The Host header is no name of this mapper",
    429: "Too many wrong tokens came from this address: Retry-After says when to try again",
    503: "The mapper is starting, stopping or busy: Retry-After says when to ask again; or it stores no map",
    507: "The disk is full",
}
_MAP_HEADERS = {
    "ETag": '"<epoch>-<run>-<revision>", the validator for If-None-Match and If-Match',
    "OGM-Resolution": "Metres per pixel",
    "OGM-Origin": "x,y of the lower-left corner, metres",
    "OGM-Epoch": "Id of the map's life: another one since it was made or emptied",
    "OGM-Run": "Id of the mapper's process: another one since it was started",
    "OGM-Revision": "Scans integrated, and erasures, in this life",
    "OGM-Stamp": "That of the newest integrated scan, ns since the Unix epoch, or null",
}
_TILE_HEADERS = {
    "ETag": '"<epoch>-<run>-<revision>" of the tile, or "<epoch>-empty", for If-None-Match and If-Match',
    "OGM-Resolution": "Metres per pixel",
    "OGM-Epoch": _MAP_HEADERS["OGM-Epoch"],
    "OGM-Run": "Id of the mapper's process; not of an empty tile",
    "OGM-Revision": "Of the map, when the tile last changed; not of an empty tile",
}
_OF_EVERY_ROUTE = (400, 421)


def described_parameters(names: Iterable[str], place: str = "query", form: str = "") -> list[Parameter]:
    """The parameters of a route, as OpenAPI describes them; `place`: "query" or "path".

    `form` is the map's format, where it is one.
    """
    described = []
    for name in names:
        grey = name == "palette" and form == "pgm"
        said, schema = _GREY_PALETTE if grey else _PARAMETERS[name]
        described.append(_described(name, place, name in _REQUIRED, said, schema))
    return described


def described_place() -> list[Parameter]:
    """The parameters in the path of a tile."""
    return [
        _described(name, "path", True, said, {"type": "integer", "minimum": low, "maximum": high})
        for name, (said, low, high) in _PLACE.items()
    ]


def _described(name: str, place: str, required: bool, said: str, schema: dict[str, Any]) -> Parameter:
    return {"name": name, "in": place, "required": required, "description": said, "schema": schema}


def responses(media_type: str, model: type | None = None, problems: Iterable[int] = (503,)) -> Responses:
    """What a route may answer: a body of `media_type`, JSON of a `model` if there is one, or a problem."""
    described: Responses = {200: {"content": {media_type: {}}, "model": model}}
    for status in sorted({*_OF_EVERY_ROUTE, *problems}):
        described[status] = {
            "description": _PROBLEMS[status],
            "content": {MEDIA_TYPE: {"schema": _PROBLEM}},
        }
    return described


def probe_responses() -> Responses:
    """What a probe may answer: plain text either way."""
    unhealthy = {"description": "It is not; the text says why", "content": {"text/plain": {}}}
    return {**responses("text/plain", problems=()), 503: unhealthy}


def map_responses(media_type: str) -> Responses:
    """What a map's route may answer, validators included."""
    return _with_validators(responses(media_type, problems=(404, 412, 503)), _MAP_HEADERS)


def tile_responses() -> Responses:
    """What a tile's route may answer, likewise."""
    return _with_validators(responses("image/png", problems=(404, 412, 503)), _TILE_HEADERS)


def _with_validators(described: Responses, said: Mapping[str, str]) -> Responses:
    headers = {name: {"description": text, "schema": {"type": "string"}} for name, text in said.items()}
    described[200]["headers"] = headers
    unchanged = {"description": "It is the one that If-None-Match names", "headers": headers}
    return {**described, 304: unchanged}
