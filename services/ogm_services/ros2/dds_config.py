"""Configuration of Cyclone DDS for one domain: which interface it speaks on, and whom it understands."""

import socket
from pathlib import Path
from xml.sax.saxutils import quoteattr

from ogm_core.errors import BadSetting

LOOPBACK = "lo"
_COMPATIBILITY = "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>"
"""Fast DDS (vendor 1.15) of Kilted describes types in a way that Cyclone cannot read: names have to do."""
_LOOPBACK_ONLY = (
    '<General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General>"
    "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>30</MaxAutoParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery>'
)
_ROUTES = Path("/proc/net/route")


def dds_config(interface: str | None) -> str:
    """The configuration, as XML: on `interface`; on loopback without multicast; None: Cyclone chooses."""
    if interface == LOOPBACK:
        general = _LOOPBACK_ONLY
    elif interface is None:
        general = ""
    else:
        name = quoteattr(interface)
        general = f"<General><Interfaces><NetworkInterface name={name}/></Interfaces></General>"
    return f"<CycloneDDS><Domain>{general}{_COMPATIBILITY}</Domain></CycloneDDS>"


def chosen_interface(asked: str | None) -> str | None:
    """The interface to speak on: the one asked for, else the one of the default route, if there is one.

    Raises:
        BadSetting: the machine has no interface of that name.
    """
    names = [name for _, name in socket.if_nameindex()]
    if asked is not None and asked not in names:
        raise BadSetting(f"--interface {asked}: this machine has {', '.join(names)}")
    return asked or _of_default_route()


def _of_default_route() -> str | None:
    try:
        lines = _ROUTES.read_text().splitlines()[1:]
    except OSError:
        return None
    routes = (line.split() for line in lines)
    return next((route[0] for route in routes if len(route) > 1 and route[1] == "00000000"), None)
