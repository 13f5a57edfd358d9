"""Topics of ROS 2: what is told of one wherever it is met, and the names of message types on the wire."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from ogm_core.errors import BadSetting, cut
from ogm_core.ros2 import cdr

Form = Literal["dds", "rmw_zenoh", "bridge"]
"""How a topic's messages come: DDS itself, Zenoh as rmw_zenoh speaks it, or through zenoh-bridge-ros2dds."""
TF, TF_STATIC = "tf", "tf_static"
"""The last parts of the names of topics with transforms."""
NO_HASH = "TypeHashNotSupported"
"""What Humble says in place of a type's hash."""
TYPE_HASHES: Mapping[str, str] = {
    cdr.LASER_SCAN: "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
    cdr.POINT_CLOUD2: "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    cdr.TF_MESSAGE: "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    cdr.POSE_STAMPED: "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    cdr.POSE_WITH_COVARIANCE_STAMPED: (
        "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"
    ),
    cdr.ODOMETRY: "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    cdr.OCCUPANCY_GRID: "RIHS01_8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7",
    cdr.OCCUPANCY_GRID_UPDATE: "RIHS01_c4095b0be2e4363f8978a1570e0293ee093436f1e1c61d99b48502ac317025e8",
}
"""Hashes (RIHS01, REP-2016) of the types that are read or written here; from Iron on all have the same."""
MAX_DOMAIN = 232
"""The largest ROS_DOMAIN_ID whose ports exist."""

_TOPIC = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")
_DDS_TYPE = re.compile(r"([A-Za-z0-9_]+)::(msg|srv|action)::dds_::([A-Za-z0-9_]+)_")


@dataclass(frozen=True, slots=True)
class Qos:
    """What a publisher or subscriber offers or asks for; `depth` 0: all are kept."""

    reliable: bool = True
    transient_local: bool = False
    depth: int = 10

    def __str__(self) -> str:
        """In the words of `ros2 topic info`."""
        parts = ["reliable" if self.reliable else "best effort"]
        if self.transient_local:
            parts.append("transient local")
        return ", ".join([*parts, f"last {self.depth}" if self.depth else "all"])


@dataclass(frozen=True, slots=True)
class Topic:
    """One end of a topic, as its node told it.

    `name` begins with "/"; `type` is as sensor_msgs/msg/LaserScan; `type_hash` is "" where none is told, as
    by Humble; `node` is the full name of the one who publishes, "" if it is not told. `domain` is the
    ROS_DOMAIN_ID; None where none is told, which is not domain 0. `publisher`: else it is a subscriber.
    """

    form: Form
    name: str
    type: str
    type_hash: str = ""
    qos: Qos = Qos()
    node: str = ""
    domain: int | None = None
    publisher: bool = True

    @property
    def namespace(self) -> str:
        """What comes before the last part of the name, as "/robot1"; "" at the root."""
        return self.name.rpartition("/")[0]

    @property
    def last(self) -> str:
        """The last part of the name, as "scan"."""
        return self.name.rpartition("/")[2]


def check_topic(name: str, what: str) -> str:
    """A topic's full name, as "/robot1/scan".

    Raises:
        BadSetting: it is none; the text names `what`.
    """
    if not _TOPIC.fullmatch(name):
        raise BadSetting(f"{what}: a topic's full name such as /ogm/map is needed, got {cut(name)!r}")
    return name


def is_topic(name: str) -> bool:
    """Whether a name can be a topic's full one."""
    return _TOPIC.fullmatch(name) is not None


def dds_type(name: str) -> str:
    """The name of a message type on the wire: sensor_msgs::msg::dds_::LaserScan_."""
    package, kind, message = name.split("/")
    return f"{package}::{kind}::dds_::{message}_"


def ros_type(name: str) -> str | None:
    """The type that a name on the wire stands for, as sensor_msgs/msg/LaserScan; None if it is none."""
    match = _DDS_TYPE.fullmatch(name)
    return None if match is None else "/".join(match.groups())
