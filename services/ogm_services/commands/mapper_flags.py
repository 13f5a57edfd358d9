"""The commands `ogm mapper` and `ogm demo` and their flags; what they do is loaded when they run."""

import math
from pathlib import Path
from typing import Annotated

import typer

from ogm_core.errors import BadInput
from ogm_services.commands.world_flags import Start, World, point
from ogm_services.results.written import out_path
from ogm_services.runtime.kernel_cache import kernel_cache
from ogm_services.runtime.loading import loading
from ogm_services.runtime.logged_service import logged_service
from ogm_services.settings.flag_groups import with_flag_groups
from ogm_services.settings.flags import (
    ConfigFile,
    HttpFlags,
    LoggingFlags,
    MapFlags,
    NetworkFlags,
    PrintConfig,
    settings_from,
)
from ogm_services.settings.keeping_flags import MapperFlags, SharesFlags
from ogm_services.settings.robot_flags import RadiusFlags, SensorFlags, check_radii

MapperOut = Annotated[
    Path | None,
    typer.Option(
        parser=out_path,
        metavar="DIR",
        help="At the end write map.png, map.pgm, map.yaml, map.npz, quality.json here.",
    ),
]


@with_flag_groups
def mapper(
    map_flags: MapFlags,
    mapper_flags: MapperFlags,
    network: NetworkFlags,
    http: HttpFlags,
    shares: SharesFlags,
    logging: LoggingFlags,
    config: ConfigFile = None,
    print_config: PrintConfig = False,
    sensor: SensorFlags = None,
    robot: RadiusFlags = None,
    out: MapperOut = None,
) -> None:
    """Integrate the robots' scans into a map, and serve it over Zenoh and HTTP."""
    groups = map_flags, mapper_flags, network, http, shares, logging
    settings = settings_from(config, *groups, sensors=sensor, robots=robot, print_config=print_config)
    check_radii(robot)
    with logged_service(*settings.log.as_given), kernel_cache():
        with loading():
            from ogm_services.mapper.service import run_mapper
        run_mapper(settings, out)


@with_flag_groups
def demo(
    map_flags: MapFlags,
    network: NetworkFlags,
    http: HttpFlags,
    logging: LoggingFlags,
    config: ConfigFile = None,
    print_config: PrintConfig = False,
    sensor: SensorFlags = None,
    robot: RadiusFlags = None,
    world: World = "lab",
    start: Start = None,
    duration: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", help="End this long after the first scan in the map (default: never)."
        ),
    ] = None,
    out: MapperOut = None,
) -> None:
    """Start a simulator and a mapper on this machine, and print the URL of the live map."""
    if duration is not None and not 0.0 < duration < math.inf:
        raise BadInput(f"--duration: more than 0 s is needed, got {duration:g}")
    begin = point("--start", start)
    groups = map_flags, network, http, logging
    settings = settings_from(config, *groups, sensors=sensor, robots=robot, print_config=print_config)
    check_radii(robot)
    with logged_service(*settings.log.as_given), kernel_cache():
        with loading():
            from ogm_services.commands.demo import run_demo
        run_demo(settings, world=world, start=begin, duration=duration, out=out)
