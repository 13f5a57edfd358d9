"""HTTP cache validation: maps that have not changed since they were asked for last."""

import re

from fastapi import Request, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from ogm_services.mapper.live.live_map import Identity
from ogm_services.mapper.serving.answers import BYTES_BESIDES, CACHE_BYTES, Answers
from ogm_services.replies.answer import Answer


class ReadyMaps:
    """Maps that are ready to be sent again, byte for byte, as long as the map does not change.

    As ASGI middleware it answers for them at once: on the event loop, without a thread, a lock or a route.
    All of it belongs to the event loop.
    """

    def __init__(self, answers: Answers) -> None:
        self._answers = answers
        self._of: Identity | None = None
        self._ready: dict[tuple[str, bytes], _ReadyMap] = {}
        self._size = 0

    def around(self, app: ASGIApp) -> ASGIApp:
        """The application behind."""

        async def answer(scope: Scope, receive: Receive, send: Send) -> None:
            ready = None
            if scope["type"] == "http" and scope["method"] in ("GET", "HEAD"):
                ready = self._ready.get((scope["path"], scope["query_string"]))
            if ready is None or self._of != self._answers.now():
                await app(scope, receive, send)
            else:
                await ready.response_to(scope)(scope, receive, send)

        return answer

    def keep(self, request: Request, answer: Answer) -> Response:
        """The response to a request for a map, kept if the map is still the same."""
        ready, now = _ReadyMap(answer), self._answers.now()
        if ready.of == now[:2]:
            asked = request.scope["path"], request.scope["query_string"]
            size = len(answer.body) + sum(map(len, asked)) + BYTES_BESIDES
            if self._of != now or self._size + size > CACHE_BYTES:
                self._of, self._ready, self._size = now, {}, 0
            if size <= CACHE_BYTES:
                self._ready[asked] = ready
                self._size += size
        return ready.response_to(request.scope)


class _ReadyMap:
    """The two responses that a map can be, with its body and without."""

    def __init__(self, answer: Answer) -> None:
        headers = _map_headers(answer)
        self.of = headers["OGM-Epoch"], int(headers["OGM-Revision"])
        self._etag = headers["ETag"]
        self._whole = Response(answer.body, media_type=answer.media_type, headers=headers)
        self._not_modified = Response(status_code=304, headers=headers)

    def response_to(self, scope: Scope) -> Response:
        """One of the two, as the request's validators want it; it may be sent any number of times."""
        given = [value.decode("latin-1") for name, value in scope["headers"] if name == b"if-none-match"]
        return self._not_modified if _matches(given, self._etag) else self._whole


def _map_headers(answer: Answer) -> dict[str, str]:
    meta = answer.meta or {}
    origin = meta["origin"]
    return {
        "ETag": str(answer.etag),
        "Cache-Control": "no-cache",
        "OGM-Resolution": repr(meta["resolution"]),
        "OGM-Origin": f"{origin['x']!r},{origin['y']!r}",
        "OGM-Epoch": meta["epoch"],
        "OGM-Revision": str(meta["revision"]),
        "OGM-Stamp": "null" if meta["stamp"] is None else str(meta["stamp"]),
    }


def _matches(if_none_match: list[str], etag: str) -> bool:
    """Whether a request's validators, of all header lines, name this one.

    RFC 9110, section 13.1.2: weak comparison; section 5.3: lines of a list are one list.
    """
    return any(line.strip() == "*" or etag in re.findall(r'"[^"]*"', line) for line in if_none_match)
