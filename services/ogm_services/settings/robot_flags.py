"""Flags that say what robots and sensors do not say themselves; `entries` reads their texts."""

from typing import Annotated

import typer

from ogm_services.settings.entries import FORM, check_for_whom
from ogm_services.settings.flags import PANELS

SensorFlags = Annotated[
    list[str] | None,
    typer.Option(
        "--sensor",
        metavar=FORM,
        help="What a sensor does not say itself; GLOB is that of ROBOT/SENSOR (repeatable).",
        rich_help_panel=PANELS["map"],
    ),
]
RobotFlags = Annotated[
    list[str] | None,
    typer.Option(
        "--robot",
        metavar=FORM,
        help="What a robot of ROS 2 does not say: origin, name; GLOB is that of its name (repeatable).",
    ),
]
RadiusFlags = Annotated[
    list[str] | None,
    typer.Option(
        "--robot",
        metavar=FORM,
        help="What a robot does not say: radius, within which others see it; GLOB is that of its name "
        "(repeatable).",
        rich_help_panel=PANELS["map"],
    ),
]


def check_radii(texts: list[str] | None) -> None:
    """Refuse what --robot says that is not the mapper's to know.

    Raises:
        BadSetting: there is such a key.
    """
    check_for_whom("robots", texts or (), "--robot", {"radius"}, "ogm ros2: ogm ros2 --robot {!r}")
