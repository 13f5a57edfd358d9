"""The command `ogm simulate` and its flags; what it does is in `simulator`, which is loaded when it runs."""

import math
from pathlib import Path
from typing import Annotated

import typer

from ogm_core.errors import BadInput
from ogm_services.commands.simulator_options import SimulatorOptions
from ogm_services.commands.world_flags import Start, World, point
from ogm_services.results.written import out_path
from ogm_services.runtime.endings import INTERRUPTED
from ogm_services.runtime.loading import loading
from ogm_services.runtime.logged_service import logged_service
from ogm_services.settings.flag_groups import with_flag_groups
from ogm_services.settings.flags import ConfigFile, LoggingFlags, NetworkFlags, PrintConfig, settings_from


@with_flag_groups
def simulate(
    network: NetworkFlags,
    logging: LoggingFlags,
    config: ConfigFile = None,
    print_config: PrintConfig = False,
    world: World = "lab",
    start: Start = None,
    robots: Annotated[int, typer.Option(metavar="N", help="How many robots drive.")] = 1,
    robot_prefix: Annotated[
        str, typer.Option(metavar="NAME", help="The robots' names: NAME1, NAME2 and so on.")
    ] = "robot",
    robot_radius: Annotated[
        float | None,
        typer.Option(
            metavar="METRES", help="How large they are to each other's LiDARs (default: they see no robots)."
        ),
    ] = None,
    rate: Annotated[float, typer.Option(metavar="HZ", help="Scans a second of each robot.")] = 20.0,
    seed: Annotated[
        int | None,
        typer.Option(metavar="N", help="Seed of the noise: equal seeds, equal ranges (default: fresh)."),
    ] = None,
    beams: Annotated[int | None, typer.Option(metavar="N", help="Beams of a scan (default: 360).")] = None,
    fov: Annotated[
        float | None, typer.Option(metavar="DEGREES", help="Field of view in degrees (default: 360).")
    ] = None,
    range_max: Annotated[
        float | None, typer.Option(metavar="METRES", help="Range of the LiDAR (default: 8).")
    ] = None,
    noise: Annotated[
        float | None, typer.Option(metavar="METRES", help="Standard deviation of a range (default: 0.02).")
    ] = None,
    scans: Annotated[
        int | None, typer.Option(metavar="N", help="End after N scans of each robot; needed with --out.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            parser=out_path,
            metavar="FILE.jsonl",
            help="Record into this file (.jsonl, .jsonl.gz, .mcap), without network.",
        ),
    ] = None,
    connect_timeout: Annotated[
        float,
        typer.Option(
            metavar="SECONDS",
            help="Give up when no mapper or router takes connections for so long (default: never).",
            show_default=False,
        ),
    ] = math.inf,
) -> None:
    """Drive simulated robots through a world and publish their poses and scans, or record them."""
    radians = None if fov is None else math.radians(fov)
    lidar = (beams, radians, range_max, noise)
    begin = point("--start", start)
    fleet = robot_prefix, connect_timeout, robot_radius
    options = SimulatorOptions(world, robots, rate, seed, *lidar, scans, begin, *fleet)
    settings = settings_from(config, network, logging, print_config=print_config)
    if out is not None and scans is None:
        raise BadInput("--out needs --scans N: a recording has an end")
    with logged_service(*settings.log.as_given, interrupted=0 if out is None else INTERRUPTED):
        with loading():
            from ogm_services.commands.simulator import record, run_simulator
        if out is None:
            run_simulator(settings.network, options)
        else:
            record(options, out)
