"""Routes of tiles over HTTP: the pictures, and what a viewer has to know of them."""

from functools import partial

from fastapi import FastAPI, Request, Response

from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.api_description import MAP_HEADERS, TILE_HEADERS, Operation
from ogm_services.mapper.serving.content_coding import accepted_by
from ogm_services.mapper.serving.handlers import add_get, in_turn, parameters_of
from ogm_services.mapper.serving.json_models import TileJson
from ogm_services.mapper.serving.map_tiles import PLACE, TILE_PARAMETERS, MapTile
from ogm_services.mapper.serving.ready_maps import Ready, ReadyMaps
from ogm_services.replies.answer import refuse_parameters
from ogm_services.replies.turns import Turns

TILE_PATH = "/tiles/{z}/{x}/{y}.png"


def add_tile_routes(app: FastAPI, turns: Turns, answers: Answers, ready: ReadyMaps) -> None:
    """Add them; the threads of `turns` make the pictures."""

    async def tile(request: Request) -> Response:
        given = parameters_of(request)
        found = await in_turn(turns, partial(answers.tile, request.path_params, given))
        headers = _headers(found, given.get("rev"))
        return ready.keep(request, Ready(found.png, "image/png", headers, found.of))

    async def description(request: Request) -> Response:
        refuse_parameters(parameters_of(request), "/tiles.json")
        # It says by which name it was asked, so that it is not kept for others.
        answer = await in_turn(turns, partial(answers.tiles, str(request.base_url)))
        return ready.response(request, Ready.map(answer, accepted_by(request.scope)))

    picture = Operation(
        *("get_tile", "tiles", "A tile of the map: 256 x 256 pixels", "image/png"),
        problems=(404, 503),
        parameters=TILE_PARAMETERS,
        path_parameters=PLACE,
        headers=TILE_HEADERS,
    )
    add_get(app, TILE_PATH, tile, picture)
    summary = "Where the tiles are, and what they show: TileJSON"
    told = Operation("get_tiles_json", "tiles", summary, model=TileJson, headers=MAP_HEADERS)
    add_get(app, "/tiles.json", description, told)


def _headers(tile: MapTile, rev: str | None) -> dict[str, str]:
    told = {} if tile.revision is None else {"OGM-Run": tile.of.run, "OGM-Revision": str(tile.revision)}
    return {
        "ETag": f'"{tile.tag}"',
        "Cache-Control": "public, max-age=31536000, immutable" if rev == tile.tag else "no-cache",
        "OGM-Epoch": tile.of.epoch,
        "OGM-Resolution": repr(tile.resolution),
        **told,
    }
