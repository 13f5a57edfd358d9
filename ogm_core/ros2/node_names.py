"""Names of the nodes behind the publishers and subscribers of DDS, as ROS 2's middlewares tell them.

DDS itself knows no nodes: each of its participants tells of those in it on a topic of their own.
"""

from functools import lru_cache
from typing import Any

from ogm_core.errors import BadCdr

TOPIC = "ros_discovery_info"
TYPE = "rmw_dds_common/msg/ParticipantEntitiesInfo"
GUID_BYTES = 16
_DEFINITIONS = """rmw_{n}/Gid gid
rmw_{n}/NodeEntitiesInfo[] nodes
================================================================================
MSG: rmw_{n}/NodeEntitiesInfo
string namespace
string name
rmw_{n}/Gid[] readers
rmw_{n}/Gid[] writers
================================================================================
MSG: rmw_{n}/Gid
uint8[{n}] data
"""
_SIZES = (16, 24)
"""Bytes of an end's id: from Iron on, and in Humble, which adds eight zeros."""


def node_names(payload: bytes) -> dict[bytes, str]:
    """The full name of the node of each publisher and subscriber, by its id: what a participant tells.

    Raises:
        BadCdr: it is no such message.
    """
    for size in _SIZES:
        try:
            nodes = _store().deserialize_cdr(payload, f"rmw_{size}/msg/Info").nodes
        except _error():
            continue
        return {
            bytes(end.data[:GUID_BYTES]): f"{node.namespace.rstrip('/')}/{node.name}"
            for node in nodes
            for end in (*node.readers, *node.writers)
        }
    raise BadCdr(f"payload: {len(payload)} bytes are not a {TYPE}")


@lru_cache(maxsize=1)
def _store() -> Any:  # noqa: ANN401 - rosbags' typestore
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    for size in _SIZES:
        store.register(get_types_from_msg(_DEFINITIONS.format(n=size), f"rmw_{size}/msg/Info"))
    return store


def _error() -> type[Exception]:
    from rosbags.serde import SerdeError

    return SerdeError
