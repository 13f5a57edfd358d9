"""Endpoints as Zenoh writes them, "tcp/127.0.0.1:7447": what Zenoh would try in vain is refused before."""

import re
import socket
from typing import Literal

from ogm_client.errors import CannotConnect
from ogm_core.errors import BadSetting
from ogm_core.wire.addresses import masked
from ogm_core.wire.keys import DEFAULT_ADDRESS

_WITH_PORTS = ("tcp", "udp", "tls", "quic", "ws")
_PROTOCOLS = (*_WITH_PORTS, "quic_datagram", "unixsock-stream", "unixpipe", "serial", "vsock")


def check_endpoint(side: Literal["connect", "listen"], endpoint: str) -> None:
    """Refuse what Zenoh would try in vain, without a word of what is wrong with it."""
    if not isinstance(endpoint, str):
        raise BadSetting(f"{side}: a text such as {DEFAULT_ADDRESS} is needed, got {endpoint!r}")
    protocol, slash, rest = endpoint.partition("/")
    endpoint = masked(endpoint)
    example = f"an endpoint looks like {DEFAULT_ADDRESS}"
    if rest.startswith("/"):
        raise BadSetting(f"{side} {endpoint}: a URL is no Zenoh endpoint; {example}")
    if not slash:
        raise BadSetting(f"{side} {endpoint}: {example}")
    if protocol not in _PROTOCOLS:
        raise BadSetting(
            f"{side} {endpoint}: {masked(protocol)!r} is none of {', '.join(_PROTOCOLS)}; {example}"
        )
    if protocol in _WITH_PORTS:
        host, port = _host_and_port(rest)
        lowest = 1 if side == "connect" else 0  # port 0 takes a free one
        if not (host and port.isascii() and port.isdigit() and lowest <= int(port[:6]) < 65536):
            raise BadSetting(
                f"{side} {endpoint}: a host and a port, {lowest} to 65535, are needed; {example}"
            )


def check_hosts(endpoints: tuple[str, ...]) -> None:
    """Refuse endpoints whose hosts are all unknown; of one that a name server may know later, say nothing."""
    unknown = []
    for endpoint in endpoints:
        protocol, _, rest = endpoint.partition("/")
        if protocol not in _WITH_PORTS:
            return
        host, port = _host_and_port(rest)
        try:
            socket.getaddrinfo(host, int(port), type=socket.SOCK_STREAM)
        except UnicodeError:  # what cannot be a name
            unknown.append(f"{masked(endpoint)}: unknown host {masked(host)!r}")
        except socket.gaierror as error:
            if error.errno == socket.EAI_AGAIN:
                return
            unknown.append(f"{masked(endpoint)}: unknown host {masked(host)!r} ({error.strerror})")
        else:
            return
    if unknown:
        raise CannotConnect(f"cannot connect to {'; '.join(unknown)}")


def _host_and_port(address: str) -> tuple[str, str]:
    """The host, without the brackets of IPv6, and the port of what follows an endpoint's protocol."""
    host, _, port = re.split("[?#]", address, maxsplit=1)[0].rpartition(":")
    return host.removeprefix("[").removesuffix("]"), port
