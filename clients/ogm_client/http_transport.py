"""HTTP transport: a mapper reached over HTTP."""

import io
import re
import time
from collections.abc import Callable, Mapping
from http.cookiejar import CookieJar, DefaultCookiePolicy
from typing import NamedTuple
from urllib.parse import urlsplit

import httpcore
import httpx

from ogm_client.errors import BadReply, CannotConnect, ClientError, NobodyAnswered, PartialMap
from ogm_client.http_deadline import DEADLINE, DeadlineTransport
from ogm_client.missing_shares import in_headers
from ogm_client.transport import (
    MAX_PROBLEM_BYTES,
    Limits,
    MapReply,
    Parameters,
    json_object,
    map_reply,
    mapper_error,
    partial_reply,
    printable,
    too_long,
)
from ogm_core.errors import BadParameter, BadSetting
from ogm_core.wire.addresses import masked
from ogm_core.wire.keys import Query, Write, check_name

_PROBLEM = "application/problem+json"
_EXAMPLE = "a URL looks like http://127.0.0.1:8000"
_OF_A_GATEWAY = (httpx.codes.BAD_GATEWAY, httpx.codes.SERVICE_UNAVAILABLE, httpx.codes.GATEWAY_TIMEOUT)
"""What who stands before a mapper answers, and no mapper does, but with a problem."""
_DELETED: Mapping[Write, tuple[str, str]] = {"delete": ("snapshots", "name"), "forget": ("robots", "robot")}
"""What is deleted by a name in the path: below what, and the parameter that names it."""
_BROKEN_OFF = "without sending"
"""In the words of httpcore and h11, which have no error of its own for a connection that ends too early."""
_HEADERS = {"Accept-Encoding": "identity"}
"""Of an answer that is not compressed the length tells how much memory it takes."""


class _Answer(NamedTuple):
    status_code: int
    headers: httpx.Headers
    content: bytes


class HttpTransport:
    """Requests to the mapper that serves at `url`; it connects when it is first asked something.

    With a `map_name`, NobodyAnswered is raised where another map is served.
    """

    def __init__(self, url: str, limits: Limits, map_name: str | None, token: str | None = None) -> None:
        """Take the mapper's address, "http://host:port", and what an answer may take.

        A `token` goes with what changes something.

        Raises:
            BadSetting: it is not a URL, or the map's name or the token is ill-formed.
        """
        _check_url(url)
        if token is not None and not re.fullmatch(r"[\x21-\x7e]+", token):
            raise BadSetting("token: letters, digits and signs without spaces are needed")
        self._authorization = None if token is None else {"Authorization": f"Bearer {token}"}
        self._url = masked(url)
        self._limits = limits
        self._map_name = None if map_name is None else check_name(map_name, "map name")
        self._checked: tuple[object, object] | None = None
        """Epoch and run of a map which has the right name."""
        # A robot's mapper is on its network, whatever proxy the environment names for the world outside: no
        # proxy is asked. Nor are cookies kept, of which a stranger could send ever more.
        no_cookies = CookieJar(DefaultCookiePolicy(allowed_domains=()))
        try:
            self._client = httpx.Client(
                base_url=url, headers=_HEADERS, cookies=no_cookies, transport=DeadlineTransport()
            )
        except httpx.InvalidURL as error:
            raise BadSetting(f"address {self._url!r}: {masked(str(error))}") from error

    def fetch(self, name: str, parameters: Parameters) -> bytes:
        """The bytes of one of NAMES."""
        answer = self._send("GET", name, parameters)
        if "complete" not in parameters and (missing := in_headers(answer.headers)):
            raise PartialMap(answer.content, missing)
        return answer.content

    def fetch_map(self, parameters: Parameters, name: str = "map.npz") -> MapReply:
        """map.npz, or another archive, with its version."""
        return _map_reply(self._send("GET", name, parameters))

    def ask(self, name: Query, body: bytes) -> bytes:
        """What is answered to a question that is a JSON body."""
        return self._send("POST", name, {}, {"Content-Type": "application/json"}, body).content

    def write(self, name: Write, parameters: Parameters) -> bytes:
        """Change something; the bytes of what is answered."""
        if name in _DELETED:
            folder, named = _DELETED[name]
            # Dots that stay as they are may be taken for steps through folders, on whatever way.
            path = f"{folder}/{parameters[named].replace('.', '%2E')}"
            return self._send("DELETE", path, {}, self._authorization).content
        return self._send("POST", name, parameters, self._authorization).content

    def hear_updates(self, heard: Callable[[bytes], None]) -> Callable[[], None]:
        """Hear nothing: over HTTP a mapper answers only."""
        return lambda: None

    def close(self) -> None:
        """Close the connections; closing twice does nothing."""
        self._client.close()

    def _send(
        self,
        method: str,
        name: str,
        parameters: Parameters,
        headers: dict[str, str] | None = None,
        body: bytes | None = None,
    ) -> _Answer:
        deadline = time.monotonic() + self._limits.timeout
        if self._checked is None:
            self._check_map(deadline)
        answer = self._request(method, name, parameters, headers, deadline, body)
        told = answer.headers
        if "OGM-Epoch" in told and (told["OGM-Epoch"], told.get("OGM-Run")) != self._checked:
            self._check_map(deadline)  # by now somebody else may be there
        return answer

    def _check_map(self, deadline: float) -> None:
        """Ask which map is served, if that matters."""
        if self._map_name is None:
            return
        status = json_object("status", self._request("GET", "status", {}, None, deadline).content)
        if status.get("map") != self._map_name:
            raise NobodyAnswered(
                f"{self._url} serves map {printable(repr(status.get('map')))}, and not {self._map_name!r}: "
                "is the address right, or the map's name?"
            )
        self._checked = status.get("epoch"), status.get("run")

    def _request(
        self,
        method: str,
        name: str,
        parameters: Parameters,
        headers: dict[str, str] | None,
        deadline: float,
        body: bytes | None = None,
    ) -> _Answer:
        if self._client.is_closed:
            raise ClientError(f"{name}: the client is closed")
        checked, self._checked = self._checked, None
        try:
            with self._client.stream(
                *(method, f"/{name}"),
                params=parameters,
                headers=headers,
                content=body,
                extensions={DEADLINE: deadline},
            ) as response:
                answer = _Answer(response.status_code, response.headers, self._content(name, response))
        except httpx.InvalidURL as error:
            raise BadParameter(f"{name}: cannot be asked: {error}") from error
        except (httpcore.TimeoutException, httpcore.NetworkError, httpcore.ProtocolError) as error:
            raise self._failed(name, error) from error
        self._checked = checked
        return answer

    def _failed(self, name: str, error: Exception) -> ClientError:
        """What has kept an answer from coming, told as a client's error."""
        if isinstance(error, (httpcore.ConnectError, httpcore.ConnectTimeout)):
            return CannotConnect(f"cannot connect to {self._url} ({error}): is `ogm mapper` running there?")
        if isinstance(error, httpcore.TimeoutException):
            return NobodyAnswered(
                f"{self._url} did not answer /{name} within {self._limits.timeout:g} s: "
                "is a mapper running there?"
            )
        text = printable(str(error))
        if isinstance(error, httpcore.NetworkError) or _BROKEN_OFF in str(error):
            return NobodyAnswered(
                f"{self._url} broke off before /{name} was there ({text}): does the mapper restart?"
            )
        return BadReply(f"{self._url}: no HTTP answer to /{name} ({text}): is it a mapper's?")

    def _content(self, name: str, response: httpx.Response) -> bytes:
        """The body of a mapper's answer; its refusal, or something else, is raised."""
        if response.status_code == httpx.codes.NOT_MODIFIED:
            return b""
        if response.is_success:
            return self._limited(name, response, self._limits.bytes_of(name))
        if response.headers.get("content-type", "").partition(";")[0].strip() == _PROBLEM:
            raise mapper_error(f"/{name}", self._limited(name, response, MAX_PROBLEM_BYTES))
        if response.status_code in _OF_A_GATEWAY:
            raise NobodyAnswered(
                f"{self._url}: a proxy answered /{name} with {response.status_code} "
                f"{printable(response.reason_phrase)}: does a mapper run behind it?"
            )
        raise BadReply(
            f"{self._url}: /{name} was answered with {response.status_code} "
            f"{printable(response.reason_phrase)}, and not as a mapper does: is the address right?"
        )

    def _limited(self, name: str, response: httpx.Response, limit: int) -> bytes:
        """A body as it was sent, of at most so many bytes."""
        coding = response.headers.get("content-encoding", "identity")
        if coding.lower() != "identity":
            raise BadReply(f"{self._url}: /{name} came compressed ({printable(coding)}), which was not asked")
        content = io.BytesIO()
        for part in response.iter_raw():
            if content.tell() + len(part) > limit:
                raise too_long(f"{self._url}: /{name}", limit)
            content.write(part)
        return content.getvalue()


def _check_url(url: str) -> None:
    """Refuse what httpx would try to connect to in vain."""
    shown = masked(url)
    try:
        parts = urlsplit(url)
        usable = bool(parts.hostname) and parts.port != 0 and url.isprintable() and " " not in url
    except ValueError:  # a port that is none, or brackets that do not match
        usable = False
    if not usable:
        raise BadSetting(f"address {shown!r}: a host and a port, 1 to 65535, are needed; {_EXAMPLE}")
    if parts.query or parts.fragment:
        raise BadSetting(f"address {shown!r}: it ends with the host, the port or a path; {_EXAMPLE}")


def _map_reply(answer: _Answer) -> MapReply:
    headers = answer.headers
    stamp, missing = headers.get("OGM-Stamp"), in_headers(headers)
    try:
        if missing:
            return partial_reply(answer.content, missing, None if stamp == "null" else int(str(stamp)))
        epoch, run, revision = headers["OGM-Epoch"], headers.get("OGM-Run"), int(headers["OGM-Revision"])
        return map_reply(answer.content, epoch, run, revision, None if stamp == "null" else int(stamp))
    except (KeyError, TypeError, ValueError) as error:
        raise BadReply("map.npz: headers OGM-Epoch, OGM-Revision and OGM-Stamp are needed") from error
