"""Robots that were found, by name: each is one robot's, on one map, in the frame that all share."""

from collections.abc import Callable, Iterable
from fnmatch import fnmatchcase
from typing import NamedTuple

from ogm_core.errors import ScanRefused
from ogm_core.ros2.common_frame import CommonFrame
from ogm_core.types import Pose
from ogm_services.ros2.account import Account
from ogm_services.ros2.mapped_robot import MappedRobot, Publisher
from ogm_services.settings.robots import RobotSettings

MAX_ROBOTS = 1000
_ODOMETRY = (
    "there is no {} frame: its poses are odometry, in {}, and the map will smear as that drifts; run a "
    "localisation"
)


class RobotKey(NamedTuple):
    """What makes a robot one: where its poses come from, and what its frames begin with."""

    where: str
    namespace: str
    prefix: str


class Robots:
    """Those that a mapper is told of; a name belongs to the first that has it."""

    def __init__(
        self,
        publisher: Callable[[str], Publisher],
        settings: Iterable[RobotSettings],
        map_frame: str,
        account: Account,
    ) -> None:
        self._publisher, self._account = publisher, account
        self._settings = tuple(settings)
        self._map_frame = map_frame
        self._common = CommonFrame(map_frame)
        self._found: dict[str, tuple[RobotKey, MappedRobot]] = {}
        self._odometry: set[str] = set()

    def called(self, name: str) -> str:
        """How the robot of a name is called on the map."""
        given = (each.name for each in self._settings if fnmatchcase(name, each.match))
        return next((each for each in given if each is not None), name)

    def take_on(self, key: RobotKey, name: str, fixed: str, *, odometry: bool) -> MappedRobot:
        """The robot of a key, whose poses are in the frame `fixed`; again whenever that has changed.

        Raises:
            ScanRefused: its name is another one's, or there are too many.
            NoCommonFrame: nothing says where its frame lies in that of the others.
        """
        called = self.called(name)
        other = self._found.get(called)
        if other is not None and other[0] != key:
            raise ScanRefused(
                f"its name is that of the robot of {other[0].where}{other[0].namespace} already: give robots "
                "namespaces or domains of their own",
                "name",
            )
        if other is None and len(self._found) >= MAX_ROBOTS:
            raise ScanRefused(f"there are {MAX_ROBOTS} robots already", "robots")
        origin = self._origin(name, called)
        self._common.admit(called, fixed, origin)
        if odometry and called not in self._odometry:
            self._odometry.add(called)
            self._account.note(called, _ODOMETRY.format(self._map_frame, fixed))
        if other is None:
            robot = MappedRobot(self._publisher(called), origin)
            self._found[called] = key, robot
        else:
            robot = other[1]
            robot.begin_run()
        return robot

    @property
    def heard(self) -> bool | None:
        """Whether somebody takes what they send; None before there is any."""
        return next((robot.heard for _, robot in self._found.values()), None)

    def close(self) -> None:
        """Withdraw all."""
        for _, robot in self._found.values():
            robot.close()

    def _origin(self, *names: str) -> Pose | None:
        for each in self._settings:
            if each.origin is not None and any(fnmatchcase(name, each.match) for name in names):
                return each.origin
        return None
