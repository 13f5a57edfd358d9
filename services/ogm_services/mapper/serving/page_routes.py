"""Routes of the live page: the document, and the files that it loads, which are this program's own."""

import hashlib
import json
from collections.abc import Mapping
from importlib.resources import files

from fastapi import FastAPI, Request, Response
from starlette.exceptions import HTTPException

from ogm_core.cells.thresholds import FREE_BELOW, OCCUPIED_ABOVE
from ogm_core.status import GONE_AFTER
from ogm_core.tiles.polygon import MAX_POINTS
from ogm_core.tiles.pyramid import LEAST_Z, NATIVE_Z, PIXELS
from ogm_services.mapper.serving.api_description import Operation
from ogm_services.mapper.serving.handlers import add_get
from ogm_services.mapper.serving.live_view import MAX_VIEW_TILES
from ogm_services.replies.what_helps import HINT_HELPS, LOST_HELPS, ON_ROBOTS_MEANS, WHAT_HELPS

STATIC_PATH = "/static/{version}/{name}"
_PAGE = "index.html"
_CONSTANTS = "constants.js"
_VERSIONED = "{static}"
"""Stands in the document for where its files are."""
_LEAFLET = ("leaflet.js", "leaflet.css")
_MEDIA_TYPES = {"js": "text/javascript", "css": "text/css"}
_FOR_GOOD = {"Cache-Control": "public, max-age=31536000, immutable", "X-Content-Type-Options": "nosniff"}
_FROM_PYTHON: Mapping[str, Mapping[str, object]] = {
    "what_helps.js": {
        "DROPPED": WHAT_HELPS,
        "LOST": LOST_HELPS,
        "ON_ROBOTS": ON_ROBOTS_MEANS,
        "HINT": HINT_HELPS,
    },
    _CONSTANTS: {
        "OCCUPIED_ABOVE": OCCUPIED_ABOVE,
        "GONE_AFTER_S": GONE_AFTER,
        "LEVELS": NATIVE_Z - LEAST_Z,
        "NATIVE_Z": NATIVE_Z,
        "SIZE": PIXELS,
        "MAX_VIEW_TILES": MAX_VIEW_TILES,
        "MAX_CORNERS": MAX_POINTS,
    },
}
"""Modules of the page that are no files: words of `ogm status`, and constants that the mapper goes by."""
PAGE_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; "
        "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'self'"
    ),
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Nothing is loaded from elsewhere, no script stands in the document; Leaflet sets styles of elements."""


class PageFiles:
    """What the page consists of: its document and its files, under a name that changes with any of them."""

    def __init__(self, free_below: float = FREE_BELOW) -> None:
        """Read them all; the page of a map whose cells are free below this probability."""
        folder = files("ogm_services.mapper.serving") / "page"
        leaflet = files("js_lib_leaflet") / "static" / "js_lib_leaflet"
        found = [*folder.iterdir(), *(leaflet / name for name in _LEAFLET)]
        texts = {file.name: file.read_bytes() for file in sorted(found, key=lambda file: file.name)}
        texts |= {name: _module(said) for name, said in _FROM_PYTHON.items()}
        texts[_CONSTANTS] += _module({"FREE_BELOW": free_below})
        digest = hashlib.sha256()
        for name, text in texts.items():
            digest.update(f"{name} {len(text)} ".encode() + text)
        self.version = digest.hexdigest()[:12]
        page = texts.pop(_PAGE).decode()
        self.document = page.replace(_VERSIONED, f"static/{self.version}").encode()
        self.texts = {name: text for name, text in texts.items() if name.rpartition(".")[2] in _MEDIA_TYPES}

    def response(self, version: str, name: str) -> Response:
        """A file's; caches may keep it for good.

        Raises:
            HTTPException: there is no such file, or it is another version's.
        """
        if version != self.version or name not in self.texts:
            raise HTTPException(404)
        media_type = _MEDIA_TYPES[name.rpartition(".")[2]]
        return Response(self.texts[name], media_type=media_type, headers=_FOR_GOOD)


def _module(said: Mapping[str, object]) -> bytes:
    """A module of the page that exports constants."""
    return "".join(f"export const {name} = {json.dumps(value)};\n" for name, value in said.items()).encode()


def add_page_routes(app: FastAPI, free_below: float) -> None:
    """Add them, of a map whose cells are free below this probability.

    Every address in the page is relative to its own, which a proxy may have moved.
    """
    page = PageFiles(free_below)

    async def show_page(_: Request) -> Response:
        return Response(page.document, media_type="text/html; charset=utf-8", headers=PAGE_HEADERS)

    async def show_file(request: Request) -> Response:
        return page.response(**request.path_params)

    add_get(app, "/", show_page, Operation("get_page", "mapper", "The live page", "text/html", problems=()))
    for method in ("GET", "HEAD"):
        app.add_api_route(STATIC_PATH, show_file, methods=[method], include_in_schema=False)
