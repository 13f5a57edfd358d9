"""Types of ROS 2's messages for Cyclone DDS, whose samples stay the CDR bytes that they are.

Cyclone tells others the fields of a type, so these are the true ones.
"""

from functools import lru_cache
from typing import Any

from ogm_core.ros2.topics import dds_type
from ogm_core.ros2.typestore import field_definitions


class CdrSample:
    """A sample as it is on the wire."""

    def __init__(self, payload: bytes) -> None:
        self.payload = payload
        self.sample_info: Any = None


@lru_cache(maxsize=64)
def raw_type(message_type: str, *, opaque: bool = False) -> Any:  # noqa: ANN401 - a class of cyclonedds
    """The class of samples of a message type: made of, and written as, CDR bytes.

    `opaque`: of a type whose fields differ between distributions, one byte is told.
    """
    from cyclonedds.idl import make_idl_struct, types

    fields = {"told": types.uint8} if opaque else _fields(message_type)
    made = make_idl_struct(message_type.rpartition("/")[2], dds_type(message_type), fields)
    made.deserialize = classmethod(_deserialize)
    made.serialize = _serialize
    return made


def sample_of(message_type: str, payload: bytes) -> Any:  # noqa: ANN401 - of the class of raw_type
    """A sample to write."""
    kind = raw_type(message_type)
    sample = kind.__new__(kind)
    sample.payload = payload
    return sample


def _deserialize(_cls: type, data: bytes, /, **_: object) -> CdrSample:
    return CdrSample(bytes(data))


def _serialize(sample: Any, *_: object, **__: object) -> bytes:  # noqa: ANN401 - of the class of raw_type
    payload: bytes = sample.payload
    return payload


def _fields(message_type: str) -> dict[str, Any]:
    return {name: _field(kind, what) for name, (kind, what) in field_definitions(message_type)}


def _field(kind: str, what: Any) -> Any:  # noqa: ANN401 - a type of cyclonedds
    from cyclonedds.idl import types

    if kind == "base":
        plain = {"string": str, "bool": bool}
        return plain.get(what) or getattr(types, what)
    if kind == "name":
        return _plain_struct(what)
    of, count = what
    return types.array[_field(*of), count] if kind == "array" else types.sequence[_field(*of)]


@lru_cache(maxsize=64)
def _plain_struct(message_type: str) -> Any:  # noqa: ANN401 - a class of cyclonedds
    """The class of a message inside of another one."""
    from cyclonedds.idl import make_idl_struct

    return make_idl_struct(message_type.rpartition("/")[2], dds_type(message_type), _fields(message_type))
