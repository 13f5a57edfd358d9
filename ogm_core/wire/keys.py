"""Key expressions of one map on Zenoh, names that may stand in them, and the default address."""

import re
from dataclasses import dataclass
from typing import Literal, NamedTuple

from ogm_core.errors import BadSetting

MAX_NAME = 64
"""The longest name, characters."""
NAME = re.compile(r"[A-Za-z0-9_.\-]{1,64}")
ROOT = "ogm/v1"
DEFAULT_ADDRESS = "tcp/127.0.0.1:7447"
"""Where a mapper listens on Zenoh, and where everyone else looks for it, unless told otherwise."""

MAX_TRUTH_BYTES = 256 * 1024
"""The longest text of a simulator's world that a mapper reads: some 10,000 walls."""

Write = Literal["reset", "erase", "forget", "save", "restore", "delete"]
"""What changes a map, or what is saved of it."""
Query = Literal["raycast", "check", "distance", "inflate"]
"""What is computed from a map for who asks."""
ShareService = Literal["part", "status", "reset"]
"""What a share of a map that is cut is asked for."""
Service = Literal["map", "cell", "quality", "status", "snapshots", Query, Write]


def check_name(value: str, what: str) -> str:
    """Return `value` if it can stand in a key.

    Raises:
        BadSetting: it is not 1 to 64 of A-Z a-z 0-9 _ - . (the text names `what`).
    """
    if not isinstance(value, str) or not NAME.fullmatch(value):
        raise BadSetting(f"{what} {value!r}: a name is 1 to 64 of A-Z a-z 0-9 _ - .")
    return value


class Source(NamedTuple):
    """Whose data a key carries: a robot's poses (sensor is None) or one of its sensors' scans."""

    robot: str
    sensor: str | None


class RobotRun(NamedTuple):
    """A run of a robot, as its liveliness token names it."""

    robot: str
    run: str


@dataclass(frozen=True, slots=True)
class MapKeys:
    """The keys of the map named `map_name`."""

    map_name: str

    def __post_init__(self) -> None:
        check_name(self.map_name, "map name")

    @property
    def root(self) -> str:
        """What every key of this map begins with."""
        return f"{ROOT}/{self.map_name}"

    @property
    def robots(self) -> str:
        """Every message of every robot; one subscriber on it keeps their order."""
        return f"{self.root}/robots/**"

    def pose(self, robot: str) -> str:
        """Where `robot` puts its poses."""
        return f"{self.root}/robots/{check_name(robot, 'robot')}/pose"

    def scan(self, robot: str, sensor: str) -> str:
        """Where `robot` puts the scans of `sensor`."""
        return f"{self.root}/robots/{check_name(robot, 'robot')}/scan/{check_name(sensor, 'sensor')}"

    def service(self, name: Service) -> str:
        """A queryable of the mapper."""
        return f"{self.root}/{name}"

    def share(self, index: int | Literal["*"], name: ShareService) -> str:
        """A queryable of share `index` of a map that is cut; "*": of all of its shares."""
        return f"{self.root}/shares/{index}/{name}"

    @property
    def updates(self) -> str:
        """Where the mapper puts what has changed of the map, for those who follow it."""
        return f"{self.root}/updates"

    @property
    def truth(self) -> str:
        """A queryable of the simulator: its world, as YAML."""
        return f"{self.root}/truth"

    def alive(self, service: str, identity: str, run: str) -> str:
        """The liveliness token of a running service: `identity` outlives a restart, `run` does not."""
        return f"{self.root}/alive/{service}/{identity}/{run}"

    def robot_of(self, key: str) -> RobotRun | None:
        """Whose liveliness token `key` is; None if it is no robot's of this map."""
        prefix = f"{self.root}/alive/robot/"
        if not key.startswith(prefix):
            return None
        match key[len(prefix) :].split("/"):
            case [robot, run] if NAME.fullmatch(robot) and NAME.fullmatch(run):
                return RobotRun(robot, run)
        return None

    def source_of(self, key: str) -> Source | None:
        """Whose data `key` carries; None if it is neither a pose key nor a scan key of this map."""
        prefix = f"{self.root}/robots/"
        if not key.startswith(prefix):
            return None
        match key[len(prefix) :].split("/"):
            case [robot, "pose"] if NAME.fullmatch(robot):
                return Source(robot, None)
            case [robot, "scan", sensor] if NAME.fullmatch(robot) and NAME.fullmatch(sensor):
                return Source(robot, sensor)
        return None
