"""`ogm`, the command line: one command per service, and what fetches from a running mapper.

Commands import what they need when they run, so that `ogm --help` answers at once.
"""

import json
import math
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from ogm_core.errors import BadInput
from ogm_services.commands import snapshot
from ogm_services.commands.bag_flags import BagFlags
from ogm_services.commands.compare import compare
from ogm_services.commands.erase import erase
from ogm_services.commands.foxglove_flags import foxglove
from ogm_services.commands.held_scans import HeldScans
from ogm_services.commands.log_flags import Log, LogFlags, check_replayed
from ogm_services.commands.quality_flags import quality
from ogm_services.commands.record_flags import record
from ogm_services.commands.ros2_flags import ros2
from ogm_services.commands.simulator_options import SimulatorOptions
from ogm_services.commands.topic_flags import TopicFlags
from ogm_services.runtime.endings import INTERRUPTED, OneLineErrors
from ogm_services.runtime.kernel_cache import kernel_cache
from ogm_services.runtime.loading import loading
from ogm_services.runtime.log_lines import log_nothing
from ogm_services.runtime.logged_service import logged_service
from ogm_services.runtime.signals import running_service
from ogm_services.runtime.terminal import outlive_terminal
from ogm_services.settings.flag_groups import with_flag_groups
from ogm_services.settings.flags import (
    ClientFlags,
    ConfigFile,
    HttpFlags,
    LoggingFlags,
    MapFlags,
    MapperFlags,
    NetworkFlags,
    PrintConfig,
    Url,
    settings_from,
)
from ogm_services.settings.robot_flags import RadiusFlags, SensorFlags, check_radii

LIVE = "Live: mapper, robots and recorder"
FILES = "Recordings and stored maps, without network"
RUNNING = "A running mapper and its map"
"""What commands are listed under, in `ogm --help`."""

app = typer.Typer(
    name="ogm",
    cls=OneLineErrors,
    context_settings={"help_option_names": ["-h", "--help"]},
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Live occupancy grid maps from robots' poses and 2D LiDAR scans, over Zenoh and HTTP.",
)
app.add_typer(snapshot.app, name="snapshot", rich_help_panel=RUNNING)


def main() -> None:
    """Run the program."""
    outlive_terminal()
    app(prog_name="ogm")


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"ogm {version('zenoh-ogm')}")
        raise typer.Exit


@app.callback()
def program(
    _version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and exit."),
    ] = False,
) -> None:
    """Take the program's own flags; the commands do the work."""


World = Annotated[
    str,
    typer.Option("--world", metavar="WORLD", help="lab, office, or the YAML file of a world or a ROS map."),
]
Start = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y",
        help="Where in a ROS map the first robot begins, in metres (default: 0,0 if free, else its largest "
        "free space inside).",
    ),
]
MapperOut = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR", help="At the end write map.png, map.pgm, map.yaml, map.npz, quality.json here."
    ),
]


@app.command(rich_help_panel=LIVE)
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
    begin = _point("--start", start)
    groups = map_flags, network, http, logging
    settings = settings_from(config, *groups, sensors=sensor, robots=robot, print_config=print_config)
    check_radii(robot)
    with logged_service(*settings.log.as_given), kernel_cache():
        with loading():
            from ogm_services.commands.demo import run_demo
        run_demo(settings, world=world, start=begin, duration=duration, out=out)


@app.command(rich_help_panel=LIVE)
@with_flag_groups
def mapper(
    map_flags: MapFlags,
    mapper_flags: MapperFlags,
    network: NetworkFlags,
    http: HttpFlags,
    logging: LoggingFlags,
    config: ConfigFile = None,
    print_config: PrintConfig = False,
    sensor: SensorFlags = None,
    robot: RadiusFlags = None,
    out: MapperOut = None,
) -> None:
    """Integrate the robots' scans into a map, and serve it over Zenoh and HTTP."""
    groups = map_flags, mapper_flags, network, http, logging
    settings = settings_from(config, *groups, sensors=sensor, robots=robot, print_config=print_config)
    check_radii(robot)
    with logged_service(*settings.log.as_given), kernel_cache():
        with loading():
            from ogm_services.mapper.service import run_mapper
        run_mapper(settings, out)


@app.command(rich_help_panel=LIVE)
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
            metavar="FILE.jsonl", help="Record into this file (.jsonl, .jsonl.gz, .mcap), without network."
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
    begin = _point("--start", start)
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


def _point(flag: str, text: str | None) -> tuple[float, float] | None:
    """The point X,Y that a flag gives, m."""
    if text is None:
        return None
    try:
        x, y = map(float, text.split(","))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise BadInput(f"{flag}: two numbers X,Y in metres are needed, got {text!r}")
    return x, y


def _speed(text: str) -> float | None:
    """Factor of --speed; None for "max"."""
    if text == "max":
        return None
    try:
        factor = float(text)
    except ValueError:
        factor = math.nan
    if not 0.0 < factor < math.inf:
        raise BadInput(f"--speed: a number above 0, or max, is needed, got {text!r}")
    return factor


@app.command(rich_help_panel=LIVE)
@with_flag_groups
def replay(
    log: Log,
    network: NetworkFlags,
    log_flags: LogFlags,
    topics: TopicFlags,
    bag: BagFlags,
    logging: LoggingFlags,
    config: ConfigFile = None,
    print_config: PrintConfig = False,
    speed: Annotated[
        str,
        typer.Option(metavar="FACTOR|max", help="1: as recorded, 2: twice as fast, max: as the mapper can."),
    ] = "1",
) -> None:
    """Publish a recorded log as its robots did."""
    factor = _speed(speed)
    settings = settings_from(config, network, logging, robots=log_flags.robots, print_config=print_config)
    check_replayed(log_flags.robots)
    with logged_service(*settings.log.as_given, interrupted=INTERRUPTED):
        with loading():
            from ogm_services.commands.log_readers import ReadAs
            from ogm_services.commands.replay import run_replay
        read_as = ReadAs(log_flags.range_max, log_flags.name, log_flags.odometry, bag.options(topics))
        run_replay(log, settings, speed=factor, read_as=read_as)


app.command(rich_help_panel=LIVE)(ros2)
app.command(rich_help_panel=LIVE)(record)


@app.command(rich_help_panel=RUNNING)
@with_flag_groups
def get(
    name: Annotated[
        str,
        typer.Argument(metavar="NAME", help="map.png, map.yaml (with its PGM), map.json?region=0,0,5,5, ..."),
    ],
    network: ClientFlags,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="FILE", help="File to write; - for stdout (default: NAME, here)."
        ),
    ] = None,
    at: Annotated[
        str | None,
        typer.Option(metavar="SNAPSHOT", help="The map as it was saved under this name (ogm snapshot)."),
    ] = None,
    url: Url = None,
    config: ConfigFile = None,
) -> None:
    """Fetch a file from a running mapper."""
    from ogm_services.commands.get import check_asked, fetch
    from ogm_services.commands.mapper_client import mapper_client

    check_asked(name, at)
    with mapper_client(url, settings_from(config, network).network) as client:
        written = fetch(client, name, out, sys.stdout.buffer, at)
    if out is None:
        typer.echo(" ".join(map(str, written)))


@app.command(rich_help_panel=RUNNING)
@with_flag_groups
def status(
    network: ClientFlags,
    url: Url = None,
    config: ConfigFile = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
    watch: Annotated[
        bool, typer.Option("--watch", help="Look again every SECONDS (default: 2), until Ctrl-C.")
    ] = False,
    seconds: Annotated[
        float | None,
        typer.Argument(metavar="SECONDS", help="With --watch: time between two looks.", show_default=False),
    ] = None,
) -> None:
    """Show what a running mapper is doing."""
    from ogm_client.transport import json_object
    from ogm_services.commands.mapper_client import address_of, mapper_client

    asked = settings_from(config, network).network
    if watch:
        from ogm_services.commands import status_watch

        period = status_watch.check_period(seconds)
        with running_service():
            status_watch.watch(
                lambda: mapper_client(url, asked), address_of(url, asked), period, as_json=as_json
            )
        return
    if seconds is not None:
        raise BadInput(f"{seconds:g}: a time between two looks needs --watch")
    with mapper_client(url, asked) as client:
        if as_json:
            typer.echo(json.dumps(json_object("status", client.fetch("status")), indent=2))
            return
        answer = client.status()
    from rich.console import Console

    from ogm_services.commands.status import status_tables

    console = Console()
    for table in status_tables(answer):
        console.print(table)


app.command(rich_help_panel=RUNNING)(erase)
app.command(rich_help_panel=RUNNING)(foxglove)


@app.command(rich_help_panel=FILES)
@with_flag_groups
def build(
    log: Log,
    out: Annotated[
        Path,
        typer.Option(metavar="DIR", help="Write map.png, map.pgm, map.yaml, map.npz, quality.json here."),
    ],
    map_flags: MapFlags,
    log_flags: LogFlags,
    topics: TopicFlags,
    bag: BagFlags,
    config: ConfigFile = None,
    print_config: PrintConfig = False,
    sensor: SensorFlags = None,
    hold_out: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Keep every Nth scan (N >= 2) out of the map, and judge the map by it."
        ),
    ] = None,
    world: Annotated[
        str | None,
        typer.Option(
            "--world", metavar="WORLD", help="Judge the map by this true world, named as in ogm simulate."
        ),
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Draw the map with axes: .png, .pdf or .svg; needs matplotlib."),
    ] = None,
) -> None:
    """Make a map of a recorded log, without network."""
    held = HeldScans(hold_out)
    robots = log_flags.robots
    settings = settings_from(config, map_flags, sensors=sensor, robots=robots, print_config=print_config)
    with log_nothing(), running_service(interrupted=INTERRUPTED), kernel_cache():
        with loading():
            from ogm_services.commands.build import run_build
            from ogm_services.commands.log_readers import ReadAs
        run_build(
            log,
            out,
            settings,
            read_as=ReadAs(log_flags.range_max, log_flags.name, log_flags.odometry, bag.options(topics)),
            held=held,
            world=world,
            figure=figure,
        )


app.command(rich_help_panel=FILES)(quality)
app.command(rich_help_panel=FILES)(compare)


@app.command(rich_help_panel=FILES)
def info(
    log: Log,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")] = False,
) -> None:
    """Say what a recorded log or a bag holds, and what is missing in it for a map."""
    with log_nothing(), running_service(interrupted=INTERRUPTED):
        with loading():
            from ogm_services.commands.info import run_info
        run_info(log, as_json=as_json)


@app.command(rich_help_panel=FILES)
def repair(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a stored map.")],
    out: Annotated[
        Path, typer.Option(metavar="NEW", help="Folder for a new store; it is made, or is empty.")
    ],
) -> None:
    """Save what is intact of a damaged stored map into a new store, and tell what is not."""
    with running_service(interrupted=INTERRUPTED), kernel_cache():
        with loading():
            from ogm_services.commands.repair import run_repair
        run_repair(folder, out)
