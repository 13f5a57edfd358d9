"""Content coding over HTTP (RFC 9110, section 8.4): text goes out by gzip to who takes that."""

import re
from functools import lru_cache
from typing import NamedTuple

from isal import isal_zlib
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MIN_BYTES = 1024
"""What is shorter takes a packet either way."""
LEVEL = 1
"""Of ISA-L: 0.1 ms for a map.json of 525 KB, 18 KB of gzip; zlib takes 0.9 ms for 19 KB, 2.8 for 12."""
VARY = {"Vary": "Accept-Encoding"}
_GZIP_FORMAT = 16 + isal_zlib.MAX_WBITS
_TEXT = re.compile(r"text/|application/([\w.\-]+\+)?(json|yaml|xml)\b|image/x-portable-graymap\b")
"""Media types of bytes that are as they are; PNG, NPZ and tiles are packed already."""
_ENTRY = re.compile(r"([!#$%&'*+\-.^_`|~0-9a-z]+)(?:[ \t]*;[ \t]*q=(0(?:\.[0-9]{0,3})?|1(?:\.0{0,3})?))?")
_REMEMBERED = 256
_LONGEST_REMEMBERED = 256
"""Bytes: a browser's has 20 to 40; longer ones are for nobody but to take memory."""


class Accepted(NamedTuple):
    """What a request takes: gzip rather than bytes as they are, and whether it takes those."""

    gzip: bool
    identity: bool


IDENTITY = Accepted(gzip=False, identity=True)
"""What who says nothing takes."""


def accepted_by(scope: Scope) -> Accepted:
    """What a request takes, by the lines of its Accept-Encoding."""
    lines = [value for name, value in scope["headers"] if name == b"accept-encoding"]
    return accepted(b",".join(lines)) if lines else IDENTITY


def accepted(given: bytes) -> Accepted:
    """What an Accept-Encoding takes (RFC 9110, section 12.5.3); entries that are ill-formed say nothing."""
    return _remembered(given) if len(given) <= _LONGEST_REMEMBERED else _read(given)


def _read(given: bytes) -> Accepted:
    weights: dict[str, float] = {}
    for entry in given.decode("latin-1").lower().split(","):
        parts = _ENTRY.fullmatch(entry.strip(" \t"))
        if parts is not None:
            weights[parts[1].removeprefix("x-")] = float(parts[2] or 1.0)
    gzip = weights.get("gzip", weights.get("*", 0.0))
    identity = weights.get("identity", weights.get("*"))
    wanted = weights.get("identity", 0.0)
    return Accepted(gzip=gzip > 0.0 and gzip >= wanted, identity=identity is None or identity > 0.0)


_remembered = lru_cache(_REMEMBERED)(_read)


def is_text(media_type: str) -> bool:
    """Whether bodies of this type get shorter."""
    return _TEXT.match(media_type) is not None


def goes_by_gzip(accepted: Accepted, size: int) -> bool:
    """Whether a text of so many bytes does, where this is accepted."""
    return accepted.gzip and (size >= MIN_BYTES or not accepted.identity)


def gzipped(body: bytes) -> bytes:
    """The gzip of a body, the same each time."""
    packer = isal_zlib.compressobj(LEVEL, isal_zlib.DEFLATED, _GZIP_FORMAT)
    return packer.compress(body) + packer.flush()


def tag_of_gzip(etag: str) -> str:
    """The strong validator of a body's gzip."""
    return f'{etag[:-1]};gzip"'


class Gzip:
    """ASGI middleware: answers by gzip whose body comes at once, and has no validator of its own.

    What has one, maps and files, sees to its codings itself.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand a request on, and pack what is answered."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        start: Message | None = None

        async def send_packed(message: Message) -> None:
            nonlocal start
            if message["type"] == "http.response.start" and _may_be_packed(message):
                start = message
                return
            if start is not None:
                start, message = _packed(start, message, accepted_by(scope))
                await send(start)
                start = None
            await send(message)

        await self._app(scope, receive, send_packed)


def _may_be_packed(start: Message) -> bool:
    headers = Headers(raw=start["headers"])
    packed = "etag" in headers or "content-encoding" in headers
    return not packed and is_text(headers.get("content-type", ""))


def _packed(start: Message, body: Message, accepted: Accepted) -> tuple[Message, Message]:
    """A response, packed if its whole body is there, and that is accepted."""
    headers = MutableHeaders(raw=[*start["headers"]])
    if VARY["Vary"] not in headers.get("vary", ""):
        headers.add_vary_header(VARY["Vary"])
    content = body.get("body", b"")
    if not body.get("more_body", False) and goes_by_gzip(accepted, len(content)):
        content = gzipped(content)
        headers["Content-Encoding"], headers["Content-Length"] = "gzip", str(len(content))
        body = {**body, "body": content}
    return {**start, "headers": headers.raw}, body
