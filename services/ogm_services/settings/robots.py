"""Settings of robots: what `ogm ros2` is told of them."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict

from ogm_core.types import Pose
from ogm_core.wire.keys import check_name
from ogm_services.settings.values import parse_pose


class RobotSettings(BaseModel):
    """One entry of the section `robots`: what holds for the robots that `match`, a glob on their names.

    `origin`: where the frame that a robot's poses are in, as its odom, lies in the map: x, y (m), theta
    (rad). `name`: how it is called on the map, in place of the name that ROS 2 gives it.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    match: str
    origin: Annotated[Pose, BeforeValidator(parse_pose)] | None = None
    name: Annotated[str, AfterValidator(lambda name: check_name(name, "robots.name"))] | None = None
