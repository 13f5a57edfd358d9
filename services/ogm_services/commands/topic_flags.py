"""Flags of which topics of robots are mapped, and how: of robots that drive, and of bags."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from ogm_core.errors import BadInput
from ogm_core.types import Pose
from ogm_services.settings.values import parse_pose

if TYPE_CHECKING:
    from ogm_services.ros2.options import Ros2Options

TOPICS = "Topics of ROS"


@dataclass(frozen=True)
class TopicFlags:
    """Flags of which topics are read, and how."""

    scan_topic: Annotated[
        list[str] | None,
        typer.Option(
            metavar="GLOB",
            help="LaserScans to map (repeatable; default: all; of a bag, the one there is).",
            rich_help_panel=TOPICS,
        ),
    ] = None
    cloud_topic: Annotated[
        list[str] | None,
        typer.Option(
            metavar="GLOB", help="PointCloud2s to map as scans (repeatable).", rich_help_panel=TOPICS
        ),
    ] = None
    z_band: Annotated[
        str | None,
        typer.Option(
            metavar="MIN,MAX",
            help="Heights above the base between which points of clouds count, m (default: 0.1,1.5).",
            rich_help_panel=TOPICS,
        ),
    ] = None
    bins: Annotated[
        int | None,
        typer.Option(metavar="N", help="Beams of a cloud's scan (default: 720).", rich_help_panel=TOPICS),
    ] = None
    pose_topic: Annotated[
        list[str] | None,
        typer.Option(
            metavar="GLOB",
            help="Take poses from it, not from tf: a PoseStamped, PoseWithCovarianceStamped or Odometry.",
            rich_help_panel=TOPICS,
        ),
    ] = None
    mount: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,THETA",
            help="Where the sensor is on the robot, m and rad: with --pose-topic, or of a bag.",
            rich_help_panel=TOPICS,
        ),
    ] = None
    scan_delay: Annotated[
        float,
        typer.Option(metavar="SECONDS", help="Is added to the stamps of all scans.", rich_help_panel=TOPICS),
    ] = 0.0

    def options(self) -> "Ros2Options":
        """The same, checked; without globs of scans all LaserScans are meant.

        Raises:
            BadInput: one is not allowed.
        """
        from ogm_core.ros2.point_cloud import DEFAULT_BINS, Flattening
        from ogm_services.ros2.options import DEFAULT_BAND, Ros2Options

        clouds = tuple(self.cloud_topic or ())
        if not clouds and (self.z_band is not None or self.bins is not None):
            raise BadInput("--z-band, --bins: they are for clouds, so --cloud-topic is needed, too")
        low, high = DEFAULT_BAND if self.z_band is None else _band(self.z_band)
        return Ros2Options(
            scan_topics=tuple(self.scan_topic or ("*",)),
            cloud_topics=clouds,
            flattening=Flattening(low, high, DEFAULT_BINS if self.bins is None else self.bins),
            pose_topics=tuple(self.pose_topic or ()),
            mount=None if self.mount is None else _mount(self.mount),
            scan_delay=self.scan_delay,
        )


def _mount(text: str) -> Pose:
    try:
        return parse_pose(text)
    except ValueError as error:
        raise BadInput(f"--mount: {error}, got {text!r}") from None


def _band(text: str) -> tuple[float, float]:
    try:
        low, high = map(float, text.split(","))
    except ValueError:
        low = high = math.nan
    if not (math.isfinite(low) and math.isfinite(high)):
        raise BadInput(f"--z-band: two numbers MIN,MAX in metres are needed, got {text!r}")
    return low, high
