"""The command `ogm build` and its flags; what it does is in `build`, which is loaded when it runs."""

from pathlib import Path
from typing import Annotated

import typer

from ogm_core.errors import BadInput
from ogm_services.commands.bag_flags import BagFlags
from ogm_services.commands.held_scans import HeldScans
from ogm_services.commands.log_flags import LogFlags, Logs
from ogm_services.commands.topic_flags import TopicFlags
from ogm_services.results.written import out_path
from ogm_services.runtime.cores import usable_cores
from ogm_services.runtime.endings import INTERRUPTED
from ogm_services.runtime.kernel_cache import kernel_cache
from ogm_services.runtime.loading import loading
from ogm_services.runtime.log_lines import log_nothing, tell
from ogm_services.runtime.signals import running_service
from ogm_services.settings.flag_groups import with_flag_groups
from ogm_services.settings.flags import ConfigFile, MapFlags, PrintConfig, settings_from
from ogm_services.settings.keeping_flags import ThreadFlags
from ogm_services.settings.robot_flags import SensorFlags


@with_flag_groups
def build(
    logs: Logs,
    out: Annotated[
        Path,
        typer.Option(
            parser=out_path,
            metavar="DIR",
            help="Write map.png, map.pgm, map.yaml, map.npz, quality.json here.",
        ),
    ],
    map_flags: MapFlags,
    log_flags: LogFlags,
    topics: TopicFlags,
    bag: BagFlags,
    thread_flags: ThreadFlags,
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
        typer.Option(
            parser=out_path,
            metavar="FILE",
            help="Draw the map with axes: .png, .pdf or .svg; needs matplotlib.",
        ),
    ] = None,
    workers: Annotated[
        int, typer.Option(min=1, max=512, metavar="N", help="Work in so many processes; the map is the same.")
    ] = 1,
    each: Annotated[
        bool,
        typer.Option("--each", help="Map every log by itself, into a folder of DIR that is named after it."),
    ] = False,
    dask: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Work on the Dask cluster of this scheduler, as tcp://host:8786."
        ),
    ] = None,
) -> None:
    """Make a map of recorded logs, one of all of them, without network."""
    if dask is not None and workers > 1:
        raise BadInput("--workers: a Dask cluster has the workers that it has: leave out --workers or --dask")
    if each and figure is not None:
        raise BadInput("--figure draws one map: leave it out with --each")
    held = HeldScans(hold_out)
    robots = log_flags.robots
    groups = map_flags, thread_flags
    settings = settings_from(config, *groups, sensors=sensor, robots=robots, print_config=print_config)
    if workers > (cores := usable_cores()):
        tell(f"--workers {workers}: more than this process has cores ({cores}) take longer, and more memory")
    with log_nothing(), running_service(interrupted=INTERRUPTED), kernel_cache():
        with loading():
            from ogm_services.commands.build_request import BuildRequest

            if each:
                from ogm_services.commands.build_each import run_each as run
            else:
                from ogm_services.commands.build import run_build as run
        read_as = log_flags.read_as(bag.options(topics))
        run(BuildRequest(logs, out, settings, read_as, held, world, figure, workers, dask))
