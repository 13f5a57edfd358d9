"""Settings of robots: what `ogm ros2` is told of them, and how large they are for a mapper."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from ogm_core.placing.robot_rules import RobotRule
from ogm_core.types import Pose
from ogm_core.wire.keys import check_name
from ogm_services.settings.values import Positive, no_switch, parse_pose

MAX_RADIUS = 100.0
"""m"""


class RobotSettings(BaseModel):
    """One entry of the section `robots`: what holds for the robots that `match`, a glob on their names.

    `origin`: where the frame that a robot's poses are in, as its odom, lies in the map: x, y (m), theta
    (rad). `name`: how it is called on the map, in place of the name that ROS 2 gives it. `radius`: how far
    from its pose other robots see it, m.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    match: str
    origin: Annotated[Pose, BeforeValidator(parse_pose)] | None = None
    name: Annotated[str, AfterValidator(lambda name: check_name(name, "robots.name"))] | None = None
    radius: Annotated[Positive, Field(le=MAX_RADIUS), BeforeValidator(no_switch)] | None = None

    def rule(self) -> RobotRule:
        """What the mapper knows of it."""
        return RobotRule(self.match, self.radius)
