"""Flags of `ogm build` and `ogm replay` for bags."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from ogm_core.errors import BadInput
from ogm_core.types import Pose
from ogm_services.settings.values import parse_pose

if TYPE_CHECKING:
    from ogm_services.ros2.bag_reader import BagOptions

_BAG = "Bag"


@dataclass(frozen=True)
class BagFlags:
    """Flags of which topics and frames of a bag are read, and how."""

    scan_topic: Annotated[
        list[str] | None,
        typer.Option(
            metavar="GLOB",
            help="LaserScans to map (repeatable); needed if there are several.",
            rich_help_panel=_BAG,
        ),
    ] = None
    pose_topic: Annotated[
        list[str] | None,
        typer.Option(
            metavar="GLOB",
            help="Take poses from it, not from tf: a PoseStamped, PoseWithCovarianceStamped or Odometry.",
            rich_help_panel=_BAG,
        ),
    ] = None
    fixed_frame: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="The frame that poses are in (default: map, else odom).",
            rich_help_panel=_BAG,
        ),
    ] = None
    mount: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,THETA",
            help="Where the sensor is on the robot, m and rad, whatever tf says.",
            rich_help_panel=_BAG,
        ),
    ] = None
    scan_delay: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", help="Is added to the stamps of all scans (default: 0).", rich_help_panel=_BAG
        ),
    ] = None

    def options(self) -> "BagOptions | None":
        """The same, checked; None if none is given.

        Raises:
            BadInput: one is not allowed.
        """
        if self == BagFlags():
            return None
        from ogm_services.ros2.bag_reader import BagOptions
        from ogm_services.ros2.options import Ros2Options

        if self.pose_topic and self.fixed_frame is not None:
            raise BadInput("--fixed-frame: it is for poses of tf; those of --pose-topic say theirs")
        globs = tuple(self.scan_topic or ())
        options = Ros2Options(
            scan_topics=globs,
            pose_topics=tuple(self.pose_topic or ()),
            mount=None if self.mount is None else mount_of(self.mount),
            scan_delay=self.scan_delay or 0.0,
        )
        return BagOptions(options, globs, self.fixed_frame)


def mount_of(text: str) -> Pose:
    """What --mount says.

    Raises:
        BadInput: it is no pose.
    """
    try:
        return parse_pose(text)
    except ValueError as error:
        raise BadInput(f"--mount: {error}, got {text!r}") from None
