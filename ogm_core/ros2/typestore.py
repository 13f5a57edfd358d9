"""Typestore: what rosbags (the extra `ros2`) knows of ROS 2's messages; loaded when the first is met."""

from functools import lru_cache
from types import SimpleNamespace
from typing import Any, Protocol

from ogm_core.errors import MissingExtra

_UPDATE = "map_msgs/msg/OccupancyGridUpdate"
_UPDATE_DEFINITION = """std_msgs/Header header
int32 x
int32 y
uint32 width
uint32 height
int8[] data
"""
"""The one type that rosbags does not know."""


class Typestore(Protocol):
    """What is used of a typestore of rosbags."""

    types: Any

    def deserialize_cdr(self, rawdata: bytes | memoryview, typename: str) -> object:
        """A message; rosbags' SerdeError if it is none."""
        ...

    def serialize_cdr(self, message: object, typename: str, *, little_endian: bool) -> memoryview:
        """Its CDR."""
        ...


def check_installed() -> None:
    """Find out, before the first message, whether messages can be read.

    Raises:
        MissingExtra: they cannot.
    """
    rosbags_types()


def field_definitions(name: str) -> list[tuple[str, tuple[str, Any]]]:
    """The fields of a message type: name, and (kind, what).

    ("base", "float32"), ("name", "std_msgs/msg/Header"), ("array", (field, count)), ("sequence", (field, 0)).
    """
    return [(field, _plain_field(node)) for field, node in rosbags_types().store.fielddefs[name][1]]


def _plain_field(node: Any) -> tuple[str, Any]:  # noqa: ANN401 - a node of rosbags' parse tree
    kind, what = node[0].name.lower(), node[1]
    if kind == "base":
        return kind, what[0]
    return kind, what if kind == "name" else (_plain_field(what[0]), what[1])


@lru_cache(maxsize=1)
def rosbags_types() -> SimpleNamespace:
    """What is used of rosbags; read when the first message is, so that nobody else needs it."""
    try:
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise MissingExtra("ROS 2 messages need rosbags: pip install 'zenoh-ogm[ros2]'") from error
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(_UPDATE_DEFINITION, _UPDATE))
    return SimpleNamespace(store=store, error=SerdeError)


def typestore() -> Typestore:
    """Makes messages of CDR, and CDR of messages."""
    store: Typestore = rosbags_types().store
    return store
