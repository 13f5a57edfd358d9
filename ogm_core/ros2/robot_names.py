"""Names of ROS 2's robots and their sensors, in whichever of the three ways their nodes tell them apart.

By namespaces (`/robot1/tf`, `/robot1/scan`, the same frames in each), by the frames of one `/tf`
(`robot1/base_link`), or by domains.
"""

import re

from ogm_core.wire.keys import MAX_NAME

_NOT_IN_NAMES = re.compile(r"[^A-Za-z0-9_.\-]")


def robot_name(namespace: str, prefix: str, otherwise: str) -> str:
    """The name of a robot whose tf is in `namespace` ("" at the root) and whose frames begin with `prefix`.

    `otherwise` is that of one with neither. A prefix that only repeats the namespace adds nothing.
    """
    namespace, prefix = namespace.strip("/"), prefix.strip("/")
    if prefix and not f"/{namespace}".endswith(f"/{prefix}"):
        namespace = f"{namespace}/{prefix}".strip("/")
    return _name(namespace or otherwise)


def sensor_name(topic: str, namespace: str, robot: str) -> str:
    """The name of the sensor behind a topic: what its name adds to the robot's namespace, or to its name."""
    name = topic.removeprefix(f"{namespace}/").strip("/")
    within = name.removeprefix(f"{robot.replace('.', '/')}/")
    return _name(within or name)


def longest_namespace(topic: str, namespaces: list[str]) -> str | None:
    """The namespace that a topic is in, the longest one; None if it is in none of them."""
    within = [each for each in namespaces if topic.startswith(f"{each}/")]
    return max(within, key=len, default=None)


def prefix_of(frame: str) -> str:
    """What a frame's name begins with: "robot1" of "robot1/base_link", "" of "base_link"."""
    return frame.rpartition("/")[0]


def _name(path: str) -> str:
    return _NOT_IN_NAMES.sub("_", path.replace("/", "."))[:MAX_NAME]
