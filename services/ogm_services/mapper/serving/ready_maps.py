"""HTTP validators: maps and tiles ready to be sent, not changed, or no longer the ones wanted."""

import re
import threading
from collections.abc import Mapping, Sequence
from typing import Any

from fastapi import Request, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from ogm_services.mapper.live.identity import Identity
from ogm_services.mapper.serving.answer_cache import BYTES_BESIDES
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.content_coding import (
    IDENTITY,
    VARY,
    Accepted,
    accepted,
    goes_by_gzip,
    gzipped,
    is_text,
    tag_of_gzip,
)
from ogm_services.mapper.serving.map_parameters import AT
from ogm_services.replies.answer import Answer, Changed
from ogm_services.replies.problems import MEDIA_TYPE, problem_of, status_of

NO_STORE = {"Cache-Control": "no-store"}
"""Header of whatever caches may not keep."""


class ReadyMaps:
    """Maps and tiles that are ready to be sent again, byte for byte, as long as the map does not change.

    As ASGI middleware it answers for them at once: on the event loop, without a thread, a lock or a route.
    All of it belongs to the event loop, but that any thread may `let_go`.
    """

    def __init__(self, answers: Answers) -> None:
        self._answers = answers
        self._keeping = threading.Lock()
        self._of: Identity | None = None
        self._ready: dict[tuple[str, bytes], Ready] = {}
        self._size = 0

    def around(self, app: ASGIApp) -> ASGIApp:
        """The application behind."""

        async def answer(scope: Scope, receive: Receive, send: Send) -> None:
            response = None
            if scope["type"] == "http" and scope["method"] in ("GET", "HEAD"):
                ready = self._ready.get((scope["path"], scope["query_string"]))
                if ready is not None and self._answers.at_once and self._of == self._answers.now():
                    response = ready.response_to(scope)
            await (response or app)(scope, receive, send)

        return answer

    @property
    def nbytes(self) -> int:
        """Bytes that are kept; any thread may ask."""
        return self._size

    def let_go(self) -> None:
        """Keep nothing of what is kept."""
        with self._keeping:
            self._ready, self._size = {}, 0

    def keep(self, request: Request, ready: "Ready") -> Response:
        """The response to a request, kept if the map is still the same."""
        now = self._answers.now()
        if self._answers.at_once and ready.of[:3] == now[:3]:
            path = request.scope["path"].removeprefix(request.scope.get("root_path", ""))
            asked = path, request.scope["query_string"]
            size = ready.size + sum(map(len, asked)) + BYTES_BESIDES
            room = self._answers.memory.cache_room
            with self._keeping:
                if self._of != now or self._size + size > room:
                    self._of, self._ready, self._size = now, {}, 0
                if size <= room:
                    before = self._ready.get(asked)
                    self._ready[asked] = ready
                    self._size += size if before is None else ready.size - before.size
        return self.response(request, ready)

    def shown(self, request: Request, ready: "Ready") -> Response:
        """The response to a request for a map, or what is made of one: kept, if it is the live one.

        One that is saved under a name may be deleted while the live map stays the same.
        """
        saved = AT.name in request.query_params
        return self.response(request, ready) if saved else self.keep(request, ready)

    @staticmethod
    def response(request: Request, ready: "Ready") -> Response:
        """The response to a request for a map that was made for it, whether that is kept or not."""
        response = ready.response_to(request.scope)
        assert response is not None  # made for what the request accepts
        return response


class Ready:
    """The responses that a map can be: itself, that it is the one known, that it is not the one wanted."""

    def __init__(
        self,
        body: bytes,
        media_type: str,
        headers: Mapping[str, str],
        of: Identity,
        taken: Accepted = IDENTITY,
    ) -> None:
        """`headers` with an ETag, but of a map of which a part is missing: that is never the one known.

        `of`: the map that was looked at, on whose stamp nothing depends. It is packed only if that is
        `taken`, as most are never asked for so.
        """
        self.of = of
        self.size = self._length = len(body)
        self._text = is_text(media_type)
        plain = {**headers, **VARY} if self._text else headers
        tag = headers.get("ETag")
        self._tags = () if tag is None else (tag, tag_of_gzip(tag))
        self._whole = Response(body, media_type=media_type, headers=plain)
        self._unchanged = {} if tag is None else {tag: Response(status_code=304, headers=plain)}
        self._packed: Response | None = None
        if self._text:
            coded = dict(plain)
            if tag is not None:
                coded["ETag"] = tag_of_gzip(tag)
                self._unchanged[coded["ETag"]] = Response(status_code=304, headers=coded)
            if goes_by_gzip(taken, self._length):
                packed = gzipped(body)
                self.size += len(packed)
                coded["Content-Encoding"] = "gzip"
                self._packed = Response(packed, media_type=media_type, headers=coded)

    @classmethod
    def map(cls, answer: Answer, taken: Accepted = IDENTITY) -> "Ready":
        """Those of a map, or of what is said of all of it."""
        headers = _map_headers(answer)
        meta = answer.meta or {}
        of = Identity("", "", -1, None)
        if answer.etag is not None:
            of = Identity(meta["epoch"], meta["run"], meta["revision"], meta["stamp"])
        return cls(answer.body, answer.media_type, headers, of, taken)

    def response_to(self, scope: Scope) -> Response | None:
        """One of them, as the request wants it; it may be sent any number of times.

        None: it is to go by gzip, and was not made for that. If-Match is looked at first (RFC 9110, section
        13.2.2), and names a map in whichever coding; 304 says the validator that the client has.
        """
        wanted, known, codings = _lines(scope)
        if wanted and not any(_matches(wanted, tag, weak=False) for tag in self._tags):
            at = f"at {self._tags[0]} now" if self._tags else "not all there"
            changed = Changed(f"the map is {at}, which is not what If-Match asks for: begin again")
            return Response(problem_of(changed), status_of(changed), NO_STORE, MEDIA_TYPE)
        by_gzip = self._text and bool(codings) and goes_by_gzip(accepted(b",".join(codings)), self._length)
        if known:
            for tag in self._tags[::-1] if by_gzip else self._tags:
                if tag in self._unchanged and _matches(known, tag, weak=True):
                    return self._unchanged[tag]
        return self._packed if by_gzip else self._whole


def _map_headers(answer: Answer) -> dict[str, str]:
    meta = answer.meta or {}
    origin = meta["origin"]
    if answer.etag is None:
        named = {**_missing_headers(meta["missing"]), **NO_STORE}
    else:
        named = {
            "ETag": answer.etag,
            "Cache-Control": "no-cache",
            "OGM-Epoch": meta["epoch"],
            "OGM-Run": meta["run"],
            "OGM-Revision": str(meta["revision"]),
        }
    return {
        **named,
        "OGM-Resolution": repr(meta["resolution"]),
        "OGM-Origin": f"{origin['x']!r},{origin['y']!r}",
        "OGM-Stamp": "null" if meta["stamp"] is None else str(meta["stamp"]),
    }


def _missing_headers(missing: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Which shares of a map are missing, and, in the same order, what they fill of the world."""
    bounds = (("" if edge is None else repr(edge) for edge in each["bounds"]) for each in missing)
    return {
        "OGM-Missing": ", ".join(f"{each['share']};since={each['since']}" for each in missing),
        "OGM-Missing-Bounds": "; ".join(",".join(edges) for edges in bounds),
    }


def _lines(scope: Scope) -> tuple[list[str], list[str], list[bytes]]:
    """The lines of If-Match, If-None-Match and Accept-Encoding, all at one look: it is for every request."""
    wanted: list[str] = []
    known: list[str] = []
    codings: list[bytes] = []
    for name, value in scope["headers"]:
        if name == b"accept-encoding":
            codings.append(value)
        elif name == b"if-none-match":
            known.append(value.decode("latin-1"))
        elif name == b"if-match":
            wanted.append(value.decode("latin-1"))
    return wanted, known, codings


def _matches(lines: list[str], etag: str, *, weak: bool) -> bool:
    """Whether a request's validators, of all lines of a header, name this one.

    RFC 9110, section 8.8.3.2: with `weak` comparison W/ does not matter, else it never matches; section 5.3:
    lines of a list are one list.
    """
    alike = (etag, f"W/{etag}") if weak else (etag,)
    return any(
        line.strip() == "*" or any(given in alike for given in re.findall(r'(?:W/)?"[^"]*"', line))
        for line in lines
    )
