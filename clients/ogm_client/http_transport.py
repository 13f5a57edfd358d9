"""HTTP transport: a mapper reached over HTTP."""

import httpx

from ogm_client.errors import BadReply, CannotConnect, ClientError, NobodyAnswered
from ogm_client.transport import MapReply, Parameters, Version, json_object, map_reply, mapper_error
from ogm_core.errors import BadParameter, BadSetting
from ogm_core.wire.keys import check_name

_PROBLEM = "application/problem+json"


class HttpTransport:
    """Requests to the mapper that serves at `url`; it connects when it is first asked something.

    With a `map_name`, NobodyAnswered is raised where another map is served.
    """

    def __init__(self, url: str, timeout: float, map_name: str | None) -> None:
        """Take the mapper's address, "http://host:port", and how long an answer may take, s.

        Raises:
            BadSetting: it is not a URL, or the map's name is ill-formed.
        """
        self._url = url
        self._timeout = timeout
        self._map_name = None if map_name is None else check_name(map_name, "map name")
        self._epoch: str | None = None
        """That of a map which has the right name."""
        try:
            # A robot's mapper is on its network, whatever proxy the environment names for the world outside.
            self._client = httpx.Client(base_url=url, timeout=timeout, trust_env=False)
        except httpx.InvalidURL as error:
            raise BadSetting(f"address {url!r}: {error}") from error

    def fetch(self, name: str, parameters: Parameters) -> bytes:
        """The bytes of one of NAMES."""
        return self._send("GET", name, parameters).content

    def fetch_map(self, parameters: Parameters) -> MapReply:
        """map.npz with its version."""
        return _map_reply(self._send("GET", "map.npz", parameters))

    def fetch_map_after(self, seen: Version) -> MapReply | None:
        """map.npz, whole, if the map is no longer at version `seen`; else None."""
        etag = f'"{seen.epoch}-{seen.revision}"'
        response = self._send("GET", "map.npz", {}, {"If-None-Match": etag})
        return None if response.status_code == httpx.codes.NOT_MODIFIED else _map_reply(response)

    def reset(self) -> None:
        """Empty the map."""
        self._send("POST", "reset", {})

    def close(self) -> None:
        """Close the connections; closing twice does nothing."""
        self._client.close()

    def _send(
        self, method: str, name: str, parameters: Parameters, headers: dict[str, str] | None = None
    ) -> httpx.Response:
        if self._epoch is None:
            self._check_map()
        response = self._request(method, name, parameters, headers)
        if response.headers.get("OGM-Epoch", self._epoch) != self._epoch:
            self._check_map()  # by now somebody else may be there
        return response

    def _check_map(self) -> None:
        """Ask which map is served, if that matters."""
        if self._map_name is None:
            return
        status = json_object("status", self._request("GET", "status", {}, None).content)
        if status.get("map") != self._map_name:
            raise NobodyAnswered(
                f"{self._url} serves map {status.get('map')!r}, and not {self._map_name!r}: "
                "is the address right, or the map's name?"
            )
        self._epoch = status.get("epoch")

    def _request(
        self, method: str, name: str, parameters: Parameters, headers: dict[str, str] | None
    ) -> httpx.Response:
        if self._client.is_closed:
            raise ClientError(f"{name}: the client is closed")
        checked, self._epoch = self._epoch, None
        try:
            response = self._client.request(method, f"/{name}", params=parameters, headers=headers)
        except (httpx.ConnectError, httpx.ConnectTimeout) as error:
            raise CannotConnect(
                f"cannot connect to {self._url} ({error}): is `ogm mapper` running there?"
            ) from error
        except httpx.TimeoutException as error:
            raise NobodyAnswered(
                f"{self._url} did not answer /{name} within {self._timeout:g} s: is a mapper running there?"
            ) from error
        except httpx.InvalidURL as error:
            raise BadParameter(f"{name}: cannot be asked: {error}") from error
        except httpx.TransportError as error:
            raise BadReply(f"{self._url}: no HTTP answer to /{name} ({error}): is it a mapper's?") from error
        self._epoch = checked
        self._check(name, response)
        return response

    def _check(self, name: str, response: httpx.Response) -> None:
        if response.is_success or response.status_code == httpx.codes.NOT_MODIFIED:
            return
        if response.headers.get("content-type", "").partition(";")[0].strip() == _PROBLEM:
            raise mapper_error(f"/{name}", response.content)
        raise BadReply(
            f"{self._url}: /{name} was answered with {response.status_code} {response.reason_phrase}, "
            "and not as a mapper does: is the address right?"
        )


def _map_reply(response: httpx.Response) -> MapReply:
    headers = response.headers
    stamp = headers.get("OGM-Stamp")
    try:
        revision = int(headers["OGM-Revision"])
        return map_reply(
            response.content, headers["OGM-Epoch"], revision, None if stamp == "null" else int(stamp)
        )
    except (KeyError, TypeError, ValueError) as error:
        raise BadReply(f"{response.url}: headers OGM-Epoch, OGM-Revision and OGM-Stamp are needed") from error
