"""The command `ogm ros2` and its flags; what it does is in `ros2`, which is loaded when it runs."""

import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import typer

from ogm_core.errors import BadInput, BadSetting
from ogm_services.commands.topic_flags import TOPICS, TopicFlags
from ogm_services.runtime.loading import loading
from ogm_services.runtime.logged_service import logged_service
from ogm_services.settings.flag_groups import with_flag_groups
from ogm_services.settings.flags import ConfigFile, LoggingFlags, NetworkFlags, PrintConfig, settings_from
from ogm_services.settings.robot_flags import RobotFlags, SensorFlags

if TYPE_CHECKING:
    from ogm_services.commands.ros2 import Networks
    from ogm_services.ros2.options import Ros2Options

DOMAIN_VARIABLE = "ROS_DOMAIN_ID"
_ROBOTS, _PUBLISHED = "Robots", "Map for robots"


@dataclass(frozen=True)
class WhereFlags:
    """Flags of where robots are."""

    dds: Annotated[
        bool,
        typer.Option(
            "--dds",
            help="Robots on DDS, the default of ROS 2: join it. It makes itself known by multicast.",
            rich_help_panel=_ROBOTS,
        ),
    ] = False
    interface: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Network interface for --dds (default: that of the default route); lo: this machine alone.",
            rich_help_panel=_ROBOTS,
        ),
    ] = None
    zenoh: Annotated[
        str | None,
        typer.Option(
            metavar="ENDPOINTS",
            help="Robots on Zenoh: rmw_zenoh's router, or a zenoh-bridge-ros2dds, as tcp/ROBOT:7447; several "
            "are separated by commas.",
            rich_help_panel=_ROBOTS,
        ),
    ] = None
    domain: Annotated[
        str | None,
        typer.Option(
            metavar="N,...",
            help=f"Domains to look in (default: {DOMAIN_VARIABLE}, else 0). A bridge tells none.",
            rich_help_panel=_ROBOTS,
        ),
    ] = None

    def networks(self) -> "Networks":
        """The networks that they name.

        Raises:
            BadInput: they name none, or contradict each other.
        """
        from ogm_services.commands.ros2 import Networks

        endpoints = tuple(part.strip() for part in (self.zenoh or "").split(",") if part.strip())
        return Networks(self.dds, endpoints, _domains(self.domain), self.interface)


@dataclass(frozen=True)
class FrameFlags:
    """Flags of what the frames of robots are called, and how long they hold."""

    tf_hold: Annotated[
        float,
        typer.Option(
            metavar="SECONDS",
            help="So long map->odom holds past its newest transform; odom->base never does.",
            rich_help_panel=TOPICS,
        ),
    ] = 1.0
    map_frame: Annotated[
        str, typer.Option(metavar="NAME", help="The frame that the map is in.", rich_help_panel=TOPICS)
    ] = "map"
    odom_frame: Annotated[
        str, typer.Option(metavar="NAME", help="The frame of the odometry.", rich_help_panel=TOPICS)
    ] = "odom"

    def options(self, topics: TopicFlags) -> "Ros2Options":
        """What is read of robots, and how, checked.

        Raises:
            BadInput: something is not allowed.
        """
        if topics.mount is not None and not topics.pose_topic:
            raise BadSetting(
                "--mount: it goes with --pose-topic; with tf say --sensor 'ROBOT/SENSOR:mount=X,Y,THETA'"
            )
        return replace(
            topics.options(),
            tf_hold=self.tf_hold,
            map_frame=self.map_frame,
            odom_frame=self.odom_frame,
        )


@dataclass(frozen=True)
class PublishFlags:
    """Flags of what robots are told; nothing, unless asked."""

    publish_map: Annotated[
        str | None,
        typer.Option(
            metavar="TOPIC",
            help="Publish the map as an OccupancyGrid, as on /ogm/map, and its changes on TOPIC_updates; "
            "over Zenoh also answer nav_msgs/GetMap beside it, as /ogm/get_map.",
            rich_help_panel=_PUBLISHED,
        ),
    ] = None
    publish_probabilities: Annotated[
        str | None,
        typer.Option(
            metavar="TOPIC",
            help="Publish how likely each cell is occupied, 0 to 100, likewise.",
            rich_help_panel=_PUBLISHED,
        ),
    ] = None


@with_flag_groups
def ros2(
    where: WhereFlags,
    topics: TopicFlags,
    frames: FrameFlags,
    publish: PublishFlags,
    network: NetworkFlags,
    logging: LoggingFlags,
    config: ConfigFile = None,
    print_config: PrintConfig = False,
    sensor: SensorFlags = None,
    robot: RobotFlags = None,
    listed: Annotated[
        bool, typer.Option("--list", help="List the topics that robots publish, and do nothing else.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="With --list: print JSON.")] = False,
) -> None:
    """Put robots that run ROS 2, as they are, on a mapper's map."""
    groups = network, logging
    settings = settings_from(config, *groups, sensors=sensor, robots=robot, print_config=print_config)
    if as_json and not listed:
        raise BadInput("--json: it goes with --list")
    with logged_service(*settings.log.as_given):
        with loading():
            from ogm_services.commands.ros2 import (
                Published,
                check_robots,
                check_sensors,
                list_topics,
                run_ros2,
            )
        networks = where.networks()
        if listed:
            list_topics(networks, as_json=as_json)
        else:
            check_sensors(sensor)
            check_robots(robot)
            published = Published(publish.publish_map, publish.publish_probabilities)
            run_ros2(networks, frames.options(topics), settings, published)


def _domains(text: str | None) -> tuple[int, ...]:
    name, text = (
        ("--domain", text) if text is not None else (DOMAIN_VARIABLE, os.environ.get(DOMAIN_VARIABLE))
    )
    parts = [part.strip() for part in (text or "0").split(",")]
    if not all(part.isascii() and part.isdigit() and len(part) <= 3 for part in parts):
        raise BadSetting(f"{name}: whole numbers such as 0 or 0,1 are needed, got {text!r}")
    return tuple(dict.fromkeys(map(int, parts)))
