"""Options of the simulator; light, so that the command line loads nothing to ask."""

import math
from dataclasses import dataclass

from ogm_core.errors import BadSetting
from ogm_core.wire.keys import check_name

MIN_RATE = 0.001
"""The slowest rate of scans, Hz."""
MAX_ROBOT_RADIUS = 100.0
"""m"""


@dataclass(frozen=True, slots=True)
class SimulatorOptions:
    """World, robots and LiDAR of a simulation; None leaves a value of the LiDAR to `simulation.lidar.Lidar`.

    `world`: lab, office, or the path of the YAML file of a world or a ROS map. The robots are named
    `robot_prefix` and a number from 1 on. `rate`: scans a second of each robot. `seed` of the noise, None for
    a fresh one. `beams` of a scan; `fov` in radians; `range_max` and `noise` (standard deviation of a range)
    in metres. `scans`: how many each robot takes, None for no end. `start`: where in a ROS map the first
    robot begins, m; None leaves that to `simulation.patrol.patrol`. `connect_timeout`: how long a mapper or a
    router is waited for, s. `robot_radius`: how large robots are to each other's LiDARs, m; None: they see
    nothing of each other.

    Raises:
        BadSetting: a value is out of range. The LiDAR's own are judged where it is made.
    """

    world: str = "lab"
    robots: int = 1
    rate: float = 20.0
    seed: int | None = None
    beams: int | None = None
    fov: float | None = None
    range_max: float | None = None
    noise: float | None = None
    scans: int | None = None
    start: tuple[float, float] | None = None
    robot_prefix: str = "robot"
    connect_timeout: float = math.inf
    robot_radius: float | None = None

    def __post_init__(self) -> None:
        if self.robots < 1:
            raise BadSetting(f"robots: at least 1 is needed, got {self.robots}")
        if not MIN_RATE <= self.rate < math.inf:
            raise BadSetting(f"rate: {MIN_RATE:g} scans a second or more are needed, got {self.rate:g}")
        if self.seed is not None and self.seed < 0:
            raise BadSetting(f"seed: 0 or more is needed, got {self.seed}")
        if self.fov is not None and not 0.0 < self.fov <= math.tau:
            degrees = math.degrees(self.fov)
            raise BadSetting(f"fov: more than 0 and at most 360 degrees are needed, got {degrees:g}")
        if self.scans is not None and self.scans < 1:
            raise BadSetting(f"scans: at least 1 is needed, got {self.scans}")
        if self.robot_radius is not None and not 0.0 < self.robot_radius <= MAX_ROBOT_RADIUS:
            raise BadSetting(
                f"robot-radius: more than 0 and at most {MAX_ROBOT_RADIUS:g} m are needed, "
                f"got {self.robot_radius:g}"
            )
        if not self.connect_timeout >= 0.0:
            raise BadSetting(f"connect-timeout: 0 s or more are needed, got {self.connect_timeout:g}")
        check_name(self.names[-1], "robot-prefix")

    @property
    def names(self) -> list[str]:
        """The robots' names."""
        return [f"{self.robot_prefix}{number + 1}" for number in range(self.robots)]
