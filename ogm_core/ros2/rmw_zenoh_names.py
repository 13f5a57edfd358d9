"""Names of ROS 2's middleware for Zenoh, rmw_zenoh: keys, liveliness tokens, and what goes with a message.

Data key: `<domain>/<name without its first />/<type on the wire>/<hash>`. A token tells of each publisher and
subscriber; in it a name's slashes are `%`, and a quality of service that is the default is left empty.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass

from ogm_core.errors import MissingExtra
from ogm_core.ros2.topics import NO_HASH, Qos, Topic, dds_type, is_topic, ros_type

TOKENS = "@ros2_lv"
BUFFERED = "_buf_cpu"
"""What Lyrical adds to a data key of types that hold bytes, as PointCloud2 does."""
DEFAULT_DEPTH = 42
_ATTACHMENT = struct.Struct("<qqB16s")
_GID_BYTES = 16
_KINDS = {"MP": True, "MS": False}
_LEAST_PARTS = 13
"""Of the token of a publisher or subscriber; newer ones may have more."""


@dataclass(frozen=True, slots=True)
class Entity:
    """Who declares a token: the session's id as Zenoh prints it, and numbers that it counts from 0."""

    zid: str
    node: int
    number: int


def data_key(domain: int, name: str, message_type: str, type_hash: str = "*") -> str:
    """Where messages of a topic are put; with "*" whatever their type's hash."""
    return f"{domain}/{name.strip('/')}/{dds_type(message_type)}/{type_hash}"


def tokens_of(domain: int) -> str:
    """The key expression of all tokens of a domain."""
    return f"{TOKENS}/{domain}/**"


def node_token(domain: int, entity: Entity, node: str) -> str:
    """The token of a node; `node` is its full name, as "/robot1/driver"."""
    namespace, _, name = node.rpartition("/")
    return f"{TOKENS}/{domain}/{entity.zid}/{entity.node}/{entity.node}/NN/%/{_mangled(namespace)}/{name}"


def topic_token(topic: Topic, entity: Entity) -> str:
    """The token of a publisher or subscriber.

    Raises:
        ValueError: the topic has no domain.
    """
    return _end_token(topic, entity, "MP" if topic.publisher else "MS")


def service_token(service: Topic, entity: Entity) -> str:
    """The token of who offers a service, which is told of as a topic; raises as `topic_token`."""
    return _end_token(service, entity, "SS")


def read_token(token: str) -> Topic | None:
    """The topic that a token tells of; None for nodes, services, and what is no token."""
    return _read(token, _KINDS)


def read_service_token(token: str) -> Topic | None:
    """The service that a token of who offers it tells of; None for all others."""
    return _read(token, {"SS": True})


def _read(token: str, kinds: Mapping[str, bool]) -> Topic | None:
    """What a token of one of the kinds tells; `kinds` says whether one publishes."""
    parts = token.split("/")
    if len(parts) < _LEAST_PARTS or parts[0] != TOKENS or parts[5] not in kinds:
        return None
    domain, namespace, node, name = parts[1], _unmangled(parts[7]), parts[8], _unmangled(parts[9])
    message_type, qos = ros_type(parts[10]), _read_qos(parts[12])
    if message_type is None or qos is None or not is_topic(name):
        return None
    if not (domain.isascii() and domain.isdigit() and len(domain) <= 3):
        return None
    return Topic(
        form="rmw_zenoh",
        name=name,
        type=message_type,
        type_hash="" if parts[11] == NO_HASH else parts[11],
        qos=qos,
        node=f"{namespace.rstrip('/')}/{node}",
        domain=int(domain),
        publisher=kinds[parts[5]],
    )


def gid(token: str) -> bytes:
    """What a publisher is known by in its messages: 16 bytes made of its token."""
    try:
        import xxhash
    except ImportError as error:
        raise MissingExtra("ROS 2 over Zenoh needs xxhash: pip install 'zenoh-ogm[ros2]'") from error
    number = xxhash.xxh3_128_intdigest(token.encode())
    return number.to_bytes(_GID_BYTES, "little")


def attachment(seq: int, stamp: int, publisher: bytes) -> bytes:
    """What goes with a message: its number, from 1 on, the time (ns), and the gid of its publisher."""
    return _ATTACHMENT.pack(seq, stamp, _GID_BYTES, publisher)


def reply_attachment(request: bytes, stamp: int) -> bytes:
    """What goes with a reply: what came with the request, by which it is known, and the time (ns).

    With a request of before April 2025 another form came, which goes back as it is.
    """
    if len(request) != _ATTACHMENT.size:
        return request
    seq, _, _, client = _ATTACHMENT.unpack(request)
    return attachment(seq, stamp, client)


def _end_token(topic: Topic, entity: Entity, kind: str) -> str:
    if topic.domain is None:
        raise ValueError("rmw_zenoh's topics are in a domain")
    namespace, _, node = topic.node.rpartition("/")
    ends = f"{TOKENS}/{topic.domain}/{entity.zid}/{entity.node}/{entity.number}/{kind}"
    names = f"%/{_mangled(namespace)}/{node}/{_mangled(topic.name)}"
    return f"{ends}/{names}/{dds_type(topic.type)}/{topic.type_hash or NO_HASH}/{_qos_text(topic.qos)}"


def _mangled(name: str) -> str:
    return name.replace("/", "%") or "%"


def _unmangled(name: str) -> str:
    return name.replace("%", "/")


def _qos_text(qos: Qos) -> str:
    """Reliability, durability, history and depth; the rest is left at its defaults."""
    history = f",{qos.depth}" if qos.depth else "2,"
    if qos.depth == DEFAULT_DEPTH:
        history = ","
    return f"{'' if qos.reliable else 2}:{1 if qos.transient_local else ''}:{history}:,:,:,,"


def _read_qos(text: str) -> Qos | None:
    """Of what `_qos_text` writes, and of others, who may write defaults out."""
    parts = text.split(":")
    if len(parts) < 3:
        return None
    kept, _, depth = parts[2].partition(",")
    if depth and not (depth.isascii() and depth.isdigit() and len(depth) <= 9):
        return None
    number = 0 if kept == "2" else int(depth or DEFAULT_DEPTH)
    return Qos(reliable=parts[0] != "2", transient_local=parts[1] == "1", depth=number)
