"""Names of zenoh-bridge-ros2dds, which carries the topics of DDS over Zenoh: keys and liveliness tokens.

Data key: the topic's name without its first "/", after the bridge's own namespace if it has one. It tells
neither domain nor type; the tokens tell the type.
"""

import re

from ogm_core.ros2.topics import Qos, Topic, is_topic

TOKENS = "@/*/@ros2_lv/**"
"""The key expression of all tokens. Zenoh matches nothing that begins with @ by chance."""
_SLASH = "\u00a7"
_TOKEN = re.compile(r"@/[0-9a-f]+/@ros2_lv/(MP|MS)/([^/]+)/([^/]+)/([^/]*)")
_SERVICE = re.compile(r"@/[0-9a-f]+/@ros2_lv/SS/([^/]+)/([^/]+)")
_TYPE = re.compile(r"[A-Za-z0-9_]+/(?:msg|srv|action)/[A-Za-z0-9_]+")
_QOS = re.compile(r"K?:(?P<reliable>\d?):(?P<durable>\d?):(?P<all>\d?),?(?P<depth>-?\d{1,9}|)(?P<rest>:.*)?")
_HASH = re.compile(r":typehash=(RIHS01_[0-9a-f]{64});")


def data_key(name: str) -> str:
    """Where the bridge puts, and takes, messages of a topic."""
    return name.removeprefix("/")


def service_token(zid: str, name: str, service_type: str) -> str:
    """The token of who offers a service, without which bridges tell their robots nothing of it."""
    told, of = (text.replace("/", _SLASH) for text in (data_key(name), service_type))
    return f"@/{zid}/@ros2_lv/SS/{told}/{of}"


def read_token(token: str) -> Topic | None:
    """The topic that a token tells of; None for services, and what is no token."""
    match = _TOKEN.fullmatch(token)
    if match is None:
        return None
    kind, key, message_type, qos_text = match.groups()
    name, message_type = "/" + key.replace(_SLASH, "/"), message_type.replace(_SLASH, "/")
    qos = _QOS.fullmatch(qos_text)
    if qos is None or not is_topic(name) or not _TYPE.fullmatch(message_type):
        return None
    found = _HASH.search(qos["rest"] or "")
    return Topic(
        form="bridge",
        name=name,
        type=message_type,
        type_hash=found[1] if found else "",
        qos=Qos(
            reliable=qos["reliable"] != "0",
            transient_local=qos["durable"] == "1",
            depth=0 if qos["all"] == "1" else max(1, int(qos["depth"] or 1)),
        ),
        publisher=kind == "MP",
    )


def read_service_token(token: str) -> Topic | None:
    """The service that a token of who offers it tells of, without a node; None for all others."""
    match = _SERVICE.fullmatch(token)
    if match is None:
        return None
    name, service_type = (text.replace(_SLASH, "/") for text in match.groups())
    return Topic("bridge", f"/{name}", service_type)
