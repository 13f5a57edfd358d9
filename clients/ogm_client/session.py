"""Zenoh sessions: the one place where they are configured and opened.

Hermetic by default: a session talks to the endpoints that it is given and finds nobody else by itself, so two
maps on one network never meet by accident, and tests leave loopback alone.
"""

import json
import logging
import re
import socket
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import zenoh

from ogm_client.certificates import check_certificates, of_certificates, speaks_tls
from ogm_client.endpoints import check_endpoint, check_hosts
from ogm_client.errors import CannotConnect, CannotListen
from ogm_client.zenoh_errors import reason, wrong_in_file
from ogm_core.errors import BadSetting
from ogm_core.wire.addresses import masked
from ogm_core.wire.keys import DEFAULT_ADDRESS

CONNECT_TIMEOUT = 2.0
"""How long a connection is tried before it counts as failed, s: services may start in any order."""
ATTEMPT = 1.0
"""How long Zenoh itself tries all endpoints, s: Python sees to Ctrl-C between two attempts."""
LEASE_MS = 2000
"""A process that freezes counts as gone after this long, ms."""
SEND_TIME_US = 500_000
"""How long a message may wait for room in the buffers of a link until whoever serves many closes it, us."""

_OF_FILE = "zenoh_config (--zenoh-config, OGM_NETWORK__ZENOH_CONFIG):"
_RETRY = {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2}
_PORT_0 = re.compile(r"(?P<protocol>tcp|tls|ws)/(?P<host>.+):0(?P<rest>[?#].*)?")

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class NetworkConfig:
    """What a session listens on and connects to; endpoints as Zenoh writes them ("tcp/127.0.0.1:7447").

    `mode` None: "peer" with an endpoint to listen on, else "client". `config_file`, a Zenoh JSON5 file,
    replaces all of our defaults; `mode`, `listen` and `connect` still override what it says, if given.
    `connect_timeout`: how long to try until something takes connections, s; inf: until something does.
    `serves`: many connect here, who are not to be held up by one that takes nothing.
    """

    mode: Literal["client", "peer"] | None = None
    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()
    config_file: Path | None = None
    connect_timeout: float = CONNECT_TIMEOUT
    serves: bool = False

    @classmethod
    def of_client(
        cls, address: str | None, zenoh_config: str | Path | None, connect_timeout: float = CONNECT_TIMEOUT
    ) -> "NetworkConfig":
        """How a client connects: to `address`, or as a Zenoh JSON5 file says.

        An address overrides the file's; with neither, to a mapper on this machine.

        Raises:
            BadSetting: the file is not given as a path.
        """
        if not isinstance(zenoh_config, str | Path | None):
            raise BadSetting(f"zenoh_config: the path of a file is needed, got {zenoh_config!r}")
        if address is None and zenoh_config is None:
            address = DEFAULT_ADDRESS
        return cls(
            connect=() if address is None else (address,),
            config_file=None if zenoh_config is None else Path(zenoh_config),
            connect_timeout=connect_timeout,
        )

    @property
    def where(self) -> str:
        """Where others are looked for, for a sentence: "at ADDRESS", or by which file."""
        if not self.connect:
            return f"as {self.config_file} says"
        return f"at {masked(', '.join(map(str, self.connect)))}"


def open_session(config: NetworkConfig) -> zenoh.Session:
    """Open a session; the caller closes it (`with`), or its process hangs at exit.

    Whoever is to wait longer than CONNECT_TIMEOUT is told so, once, in the log.

    Raises:
        BadSetting: an endpoint or the configuration file is ill-formed, or there is no endpoint at all; or a
            certificate or key that the file names is missing, or is none.
        CannotConnect: no host of the endpoints to connect to is known, which is said at once; or nothing
            takes connections there in time.
        CannotListen: an endpoint to listen on is taken, or is not this machine's.
    """
    for endpoint in config.connect:
        check_endpoint("connect", endpoint)
    for endpoint in config.listen:
        check_endpoint("listen", endpoint)
    settings = _hermetic(config) if config.config_file is None else _from_file(config.config_file, config)
    check_hosts(config.connect)
    check_certificates(settings, f"{_endpoints(settings, 'listen')}, {_endpoints(settings, 'connect')}")
    began, told = time.monotonic(), config.connect_timeout <= CONNECT_TIMEOUT
    turn, attempt = config.connect, _attempt(config)
    while True:
        tried = time.monotonic()
        try:
            return zenoh.open(settings)
        except zenoh.ZError as error:
            failure, now = _failure(settings, error, serves=config.serves), time.monotonic()
            if not isinstance(failure, CannotConnect) or now - began >= config.connect_timeout:
                raise failure from error
        if not told:
            told = True
            endpoints = masked(_endpoints(settings, "connect"))
            log.warning(
                "waiting for a mapper or a Zenoh router at %s%s", endpoints, of_certificates(endpoints)
            )
        if len(turn) > 1:  # a client tries the first one for all of its time, and never comes to the others
            turn = (*turn[1:], turn[0])
            _insert(settings, "connect/endpoints", turn)
        # A file may say that Zenoh itself tries only once.
        time.sleep(max(0.0, min(tried + attempt, began + config.connect_timeout) - now))


def resolve_listen(endpoint: str) -> str:
    """Replace port 0 of a TCP, TLS or WebSocket endpoint by a free port; any other endpoint stays as it is.

    Zenoh binds port 0 as well, but has no way to ask which port it got. Another process can take the port
    before it is listened on; `open_session` then raises CannotListen.

    Raises:
        CannotListen: the host is not an address of this machine.
    """
    match = _PORT_0.fullmatch(endpoint)
    if match is None:
        return endpoint
    host = match["host"].strip("[]")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(address)
            port = probe.getsockname()[1]
    except OSError as error:
        raise CannotListen(f"cannot listen on {masked(endpoint)}: {error.strerror or error}") from error
    return f"{match['protocol']}/{match['host']}:{port}{match['rest'] or ''}"


def listens_on(config_file: Path | None) -> tuple[str, ...]:
    """The endpoints that a Zenoh configuration file names to listen on; none without a file.

    Raises:
        BadSetting: the file is missing or ill-formed.
    """
    if config_file is None:
        return ()
    return tuple(filter(None, _endpoints(_from_file(config_file, NetworkConfig()), "listen").split(", ")))


def is_secured(session: zenoh.Session) -> bool:
    """Whether certificates say who is at the ends of a session's links: then its questions may be denied."""
    return any(speaks_tls(str(link.dst)) for link in session.info.links())


def _hermetic(config: NetworkConfig) -> zenoh.Config:
    if not (config.listen or config.connect):
        raise BadSetting(
            "network: nothing to listen on and nothing to connect to; give at least one endpoint"
        )
    settings = zenoh.Config()
    _insert(settings, "mode", config.mode or ("peer" if config.listen else "client"))
    # Without exit_on_failure a peer that cannot connect would start silently alone.
    timeout_ms = round(_attempt(config) * 1000)
    _insert(settings, "connect", {"timeout_ms": timeout_ms, "exit_on_failure": True, "retry": _RETRY})
    _insert(settings, "listen", {"timeout_ms": 0, "exit_on_failure": True})
    # Set even if empty: a peer's own default listens on every interface.
    _insert(settings, "listen/endpoints", config.listen)
    _insert(settings, "connect/endpoints", config.connect)
    _insert(settings, "scouting/multicast/enabled", False)
    _insert(settings, "scouting/gossip/enabled", False)
    # Zenoh's default sends payloads of 3 KB and up through /dev/shm, which containers share or not; scans are
    # around that size, and loopback TCP carries far more of them than a mapper can integrate.
    _insert(settings, "transport/shared_memory/enabled", False)
    _insert(settings, "transport/link/tx/lease", LEASE_MS)
    # A session that connects has one link for everybody: to close it would cost more than to wait.
    if config.serves and config.listen and not config.connect:
        # While a message waits for one link, Zenoh can neither open nor close any other; past a lease, it
        # takes all who are well for dead. Its own 5 s are longer than that.
        tx = "transport/link/tx/queue/congestion_control/block/wait_before_close"
        _insert(settings, tx, SEND_TIME_US)
    return settings


def _from_file(path: Path, config: NetworkConfig) -> zenoh.Config:
    if not path.is_file():
        raise BadSetting(f"{_OF_FILE} {path}: no such file")
    try:
        settings = zenoh.Config.from_file(path)
    except zenoh.ZError as error:
        raise BadSetting(f"{_OF_FILE} {path}: {wrong_in_file(error)}") from None  # its text may hold secrets
    if config.mode is not None:
        _insert(settings, "mode", config.mode)
    if config.listen:
        _insert(settings, "listen/endpoints", config.listen)
    if config.connect:
        _insert(settings, "connect/endpoints", config.connect)
    return settings


def _attempt(config: NetworkConfig) -> float:
    """How long each endpoint to connect to is tried at a time, s."""
    return min(config.connect_timeout, ATTEMPT) / max(1, len(config.connect))


def _insert(settings: zenoh.Config, key: str, value: Any) -> None:  # noqa: ANN401 - any JSON value
    try:
        settings.insert_json5(key, json.dumps(value))
    except zenoh.ZError as error:
        if not key.endswith("endpoints"):
            raise
        raise BadSetting(
            f"{key.split('/')[0]} {masked(', '.join(value))}: an endpoint looks like {DEFAULT_ADDRESS}"
        ) from error


def _failure(settings: zenoh.Config, error: zenoh.ZError, *, serves: bool) -> CannotConnect | CannotListen:
    text = masked(reason(error))
    listen, connect = masked(_endpoints(settings, "listen")), masked(_endpoints(settings, "connect"))
    if connect and (not listen or text.startswith("Unable to connect")):
        who, start, running = "mapper", "with `ogm mapper`", "mapper or Zenoh router"
        if serves:  # mappers and gateways meet their robots, and each other, at a router
            who, start, running = "Zenoh router", "(`zenohd`)", "one"
        return CannotConnect(
            f"cannot connect to {connect}: is a {who} running there? Start one {start}, or give "
            f"the address of a running {running}{of_certificates(connect)}"
        )
    if listen:
        why = text.rpartition(": ")[2].rstrip("]")
        if "in use" in why:
            why += ". Is another mapper running? Choose another address (--listen); port 0 takes a free one"
        return CannotListen(f"cannot listen on {listen}: {why}")
    return CannotConnect(f"cannot open a Zenoh session: {text}")


def _endpoints(settings: zenoh.Config, key: str) -> str:
    """The endpoints of a configuration, as text; "" if there are none."""
    value = json.loads(settings.get_json(f"{key}/endpoints"))
    if isinstance(value, dict):  # one list per mode
        value = value.get(json.loads(settings.get_json("mode")) or "peer")
    return ", ".join(str(endpoint) for endpoint in value or [])
