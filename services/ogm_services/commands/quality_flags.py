"""The command `ogm quality` and its flags; what it does is in `quality`, which is loaded when it runs."""

from pathlib import Path
from typing import Annotated

import typer

from ogm_core.errors import BadInput
from ogm_services.commands.bag_flags import BagFlags
from ogm_services.commands.held_scans import HeldScans
from ogm_services.commands.log_flags import LogFlags, Logs
from ogm_services.commands.topic_flags import TopicFlags
from ogm_services.results.written import out_path
from ogm_services.runtime.endings import INTERRUPTED
from ogm_services.runtime.kernel_cache import kernel_cache
from ogm_services.runtime.loading import loading
from ogm_services.runtime.log_lines import log_nothing
from ogm_services.runtime.signals import running_service
from ogm_services.settings.flag_groups import with_flag_groups
from ogm_services.settings.flags import ConfigFile, MapFlags, PrintConfig, settings_from
from ogm_services.settings.robot_flags import SensorFlags

_NAMED = ("sensor_model", "model", "traversal", "cell_model")
"""Map flags that a name of --models stands for."""


@with_flag_groups
def quality(
    logs: Logs,
    map_flags: MapFlags,
    log_flags: LogFlags,
    topics: TopicFlags,
    bag: BagFlags,
    config: ConfigFile = None,
    print_config: PrintConfig = False,
    sensor: SensorFlags = None,
    models: Annotated[
        str | None,
        typer.Option(
            "--models",
            metavar="NAME,...",
            help="Judge these side by side: bresenham, dda, sector, rate (default: what the map flags say).",
        ),
    ] = None,
    hold_out: Annotated[
        int,
        typer.Option("--hold-out", metavar="N", help="Every Nth scan (N >= 2) judges, and is not mapped."),
    ] = 10,
    blocks: Annotated[
        bool, typer.Option("--blocks", help="Hold out N scans in a row of every 10 N, which is harder.")
    ] = False,
    every: Annotated[
        int, typer.Option("--every", metavar="K", help="Thin a dense log: only every Kth scan counts.")
    ] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
    figure: Annotated[
        Path | None,
        typer.Option(
            "--figure",
            parser=out_path,
            metavar="FILE",
            help="Draw how reliable the probabilities are: .png, .pdf or .svg; needs matplotlib.",
        ),
    ] = None,
) -> None:
    """Judge maps of recorded logs by scans that are held out of them."""
    held = HeldScans(hold_out, every, blocks)
    given = [name.replace("_", "-") for name in _NAMED if models and getattr(map_flags, name) is not None]
    if given:
        raise BadInput(f"--models says how each map is made: leave out --{given[0]}")
    settings = settings_from(
        config, map_flags, sensors=sensor, robots=log_flags.robots, print_config=print_config
    )
    with log_nothing(), running_service(interrupted=INTERRUPTED), kernel_cache():
        with loading():
            from ogm_services.commands.map_variants import variants
            from ogm_services.commands.quality import run_quality
        run_quality(
            logs,
            variants(models, settings),
            held,
            read_as=log_flags.read_as(bag.options(topics)),
            as_json=as_json,
            figure=figure,
        )
