"""Client of a running mapper, over Zenoh or HTTP: asks for its map and its status."""

import math
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import zenoh
from numpy.typing import ArrayLike

from ogm_client.errors import BadReply, PartialMap
from ogm_client.follower import MapFollower
from ogm_client.map_grid import MapGrid
from ogm_client.map_queries import MapQueries
from ogm_client.map_writes import MapWrites
from ogm_client.parameters import Resolution, Value, check_interval, check_watch, is_coarse, texts
from ogm_client.session import NetworkConfig
from ogm_client.status_reply import read_status
from ogm_client.transport import NAMES, Limits, MapReply, Transport, Version, json_object
from ogm_client.zenoh_transport import ZenohTransport
from ogm_core.errors import BadInput, BadParameter, BadSetting
from ogm_core.files.map_files import MAX_NPZ_BYTES, read_npz
from ogm_core.status import Status
from ogm_core.wire.addresses import masked
from ogm_core.wire.keys import DEFAULT_ADDRESS

DEFAULT_TIMEOUT = 5.0
DEFAULT_MAX_BYTES = MAX_NPZ_BYTES
DEFAULT_INTERVAL = 0.5
DEFAULT_PATIENCE = 60.0
DEFAULT_MAP = "default"


class MapClient(MapQueries, MapWrites):
    """A connection to the mapper of one map.

        with MapClient() as mapper:
            grid = mapper.get_map()
            grid.save_png("map.png")

    Every request may raise, besides what its own text says: CannotConnect, NobodyAnswered (no mapper of that
    map is there, or it took longer than the timeout), MapperError (it refused) and BadReply.

    Threads may share a client.
    """

    def __init__(
        self,
        address: str | None = None,
        *,
        zenoh_config: str | Path | None = None,
        map_name: str | None = None,
        timeout: float = DEFAULT_TIMEOUT,
        max_bytes: int = DEFAULT_MAX_BYTES,
        session: zenoh.Session | None = None,
        token: str | None = None,
    ) -> None:
        """Connect to "http://host:port" or "https://...", or by Zenoh to an endpoint such as "tcp/host:port".

        Without an address: as `zenoh_config` says, a Zenoh configuration file (JSON5, with TLS if you like),
        else to a mapper on this machine. With both, the address overrides the file's.
        `map_name` None: the map "default" over Zenoh, over HTTP whichever is served there; one that is given
        must be the one served, else requests raise NobodyAnswered. An answer has to be there, to its last
        byte, `timeout` seconds after the question, and may have `max_bytes`, the cells of a map unpacked. An
        open Zenoh `session` is used in place of `address`, and stays open. `token` is the mapper's
        `http.token`, without which it may refuse what changes something; it is for HTTP
        alone.

        Raises:
            BadSetting: the address, the map's name, the timeout, `max_bytes` or the file is ill-formed, or
                they do not go together.
            CannotConnect: nothing takes Zenoh connections at the address (HTTP connects when first asked).
        """
        if not 0.0 < timeout < math.inf:
            raise BadSetting(f"timeout: a positive number of seconds is needed, got {timeout}")
        if isinstance(max_bytes, bool) or not isinstance(max_bytes, int) or max_bytes < 1:
            raise BadSetting(f"max_bytes: a positive whole number is needed, got {max_bytes!r}")
        self._max_bytes = max_bytes
        limits = Limits(timeout, max_bytes)
        self._transport = _transport(address, zenoh_config, map_name, limits, session, token)

    def get_map(
        self,
        region: ArrayLike | None = None,
        *,
        at: str | None = None,
        partial: bool = False,
        resolution: Resolution = "fine",
    ) -> MapGrid:
        """The map, or the part of it that covers `region`: (xmin, ymin, xmax, ymax), m, rounded outward.

        `at`: the map as it was saved under that name. A map without a known cell has shape (0, 0).
        `resolution`: of a map that counts "fine" are halves of the cells that it counts in, "coarse" those
        cells, as wide as its mapper was told; of all others both are the same.

        `partial`: also one of which shares are missing (see docs/fleet.md), which its `missing` names.

        Raises:
            BadParameter: there is no such resolution, or a parameter cannot be sent.
            MapperError: the region is inverted, not finite, or wholly outside the map; or no map is saved
                under the name ("unknown-snapshot").
            PartialMap: shares are missing, and it is not asked for such a map.
        """
        wanted = "coarse" if is_coarse(resolution) else None
        given = texts({"region": region, "at": at, "resolution": wanted})
        grid = self._grid(self._transport.fetch_map(given))
        if grid.missing and not partial:
            raise PartialMap(grid, grid.missing)
        return grid

    def fetch(self, name: str, /, **parameters: Value) -> bytes:
        """The bytes of one of the routes that answer a GET, such as map.png, distance.npz, cell or status.

        The parameters are those of the HTTP route, such as `palette="probability"`, `max_size=500`,
        `region=(-1, -1, 1, 1)` or `at="monday"`.

        Raises:
            BadParameter: nothing has that name, or a parameter cannot be sent.
            MapperError: the mapper does not take a parameter, or the map is empty ("map-empty", images only).
            PartialMap: shares of the map are missing; with `complete=0` the rest of it is fetched.
        """
        if name not in NAMES:
            raise BadParameter(f"{name!r} cannot be fetched, only {', '.join(NAMES)}")
        if "format" in parameters:
            raise BadParameter(f"format: the name says it, {name}")
        return self._transport.fetch(name, texts(parameters))

    def status(self) -> Status:
        """What the mapper has received, integrated and dropped, and from whom.

        `fetch("status")` has all that the mapper says, as JSON.
        """
        return read_status(self.fetch("status"))

    def quality(self) -> dict[str, Any]:
        """The quality figures of the map."""
        return json_object("quality", self.fetch("quality"))

    def cell(self, x: float, y: float) -> dict[str, Any]:
        """The cell at the point (x, y), m: `{x, y, ix, iy, known, log_odds, probability}`."""
        return json_object("cell", self.fetch("cell", x=x, y=y))

    def follow(self, *, interval: float = DEFAULT_INTERVAL, resolution: Resolution = "fine") -> MapFollower:
        """Follow the map: a copy that is kept up to date by what changes, and says what that is.

            with mapper.follow() as follower:
                change = follower.wait()
                grid = follower.grid()

        The copy's tiles may take `max_bytes`. Over Zenoh the mapper tells what changes, within a tenth of a
        second; over HTTP it is asked every `interval` seconds, and so it is where access control keeps that
        from being heard. `resolution` as of `get_map`.

        Raises:
            BadParameter: the interval is not a positive number, or there is no such resolution.
        """
        check_interval(interval)
        return MapFollower(self._transport, self._max_bytes, interval, coarse=is_coarse(resolution))

    def watch(
        self,
        interval: float = DEFAULT_INTERVAL,
        patience: float = DEFAULT_PATIENCE,
        *,
        resolution: Resolution = "fine",
    ) -> Iterator[MapGrid]:
        """Yield the map at once, and again whenever it has changed; looks every `interval` seconds.

        Only what has changed is sent (see `follow`). That of a mapper which was started anew is: only its
        `run` may tell it from the one before. A mapper that is away after the first map, or that starts,
        stops or is busy (503), is waited for: `patience` seconds, 0 not at all, math.inf for ever; then what
        was wrong is raised. Ends only by an error or with the loop around it. `resolution` as of `get_map`.

        Raises:
            BadParameter: the interval is not a positive number, the patience is negative or none, or there is
                no such resolution.
        """
        check_watch(interval, patience)
        is_coarse(resolution)
        return self._watch(interval, patience, resolution)

    def close(self) -> None:
        """Close the connection; a session that was given stays open. Closing twice does nothing."""
        self._transport.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _watch(self, interval: float, patience: float, resolution: Resolution) -> Iterator[MapGrid]:
        with self.follow(interval=interval, resolution=resolution) as follower:
            seen: Version | None = None
            while True:
                grid = follower.next_grid(seen, patience)
                seen, shown = Version(grid.epoch, grid.run, grid.revision), time.monotonic()
                yield grid
                time.sleep(max(0.0, shown + interval - time.monotonic()))

    def _grid(self, reply: MapReply) -> MapGrid:
        try:
            npz = read_npz(reply.npz, max_bytes=self._max_bytes)
        except BadInput as error:
            raise BadReply(str(error)) from error
        epoch, run, revision = reply.version
        place = npz.resolution, npz.anchor, npz.offset
        return MapGrid(npz.log_odds, *place, epoch, revision, reply.stamp, run, npz.free_below, reply.missing)


def _transport(
    address: str | None,
    zenoh_config: str | Path | None,
    map_name: str | None,
    limits: Limits,
    session: zenoh.Session | None,
    token: str | None,
) -> Transport:
    if session is not None and zenoh_config is not None:
        raise BadSetting("zenoh_config: an open session has a configuration already; give one of the two")
    if session is None and isinstance(address, str):
        if address.startswith(("http://", "https://")):
            if zenoh_config is not None:
                raise BadSetting(f"zenoh_config: {masked(address)} is asked over HTTP; give one of the two")
            # Here, because it loads httpx, which who speaks Zenoh need not wait for.
            from ogm_client.http_transport import HttpTransport

            return HttpTransport(address, limits, map_name, token)
        if "://" in address or "/" not in address:
            raise BadSetting(
                f"address {masked(address)!r}: http://HOST:PORT, or a Zenoh endpoint such as "
                f"{DEFAULT_ADDRESS}, is needed"
            )
    if token is not None:
        raise BadSetting(
            "token: it is for HTTP alone (http://HOST:PORT); over Zenoh certificates and access control say "
            "who may write"
        )
    network = NetworkConfig.of_client(address, zenoh_config)
    return ZenohTransport(network, DEFAULT_MAP if map_name is None else map_name, limits, session)
