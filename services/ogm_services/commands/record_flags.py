"""The command `ogm record` and its flags; what it does is in `record`, which is loaded when it runs."""

from pathlib import Path
from typing import Annotated

import typer

from ogm_core.errors import BadInput
from ogm_services.results.written import out_path
from ogm_services.runtime.endings import INTERRUPTED
from ogm_services.runtime.loading import loading
from ogm_services.runtime.log_lines import log_nothing
from ogm_services.runtime.logged_service import logged_service
from ogm_services.runtime.signals import running_service
from ogm_services.settings.flag_groups import with_flag_groups
from ogm_services.settings.flags import ConfigFile, LoggingFlags, NetworkFlags, PrintConfig, settings_from


@with_flag_groups
def record(
    network: NetworkFlags,
    logging: LoggingFlags,
    config: ConfigFile = None,
    print_config: PrintConfig = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", parser=out_path, metavar="FILE.mcap", help="A new file to record into."),
    ] = None,
    repair: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.mcap",
            help="Make a recording whole that was cut short, and do nothing else.",
        ),
    ] = None,
) -> None:
    """Record what all robots of a map publish, until Ctrl-C."""
    settings = settings_from(config, network, logging, print_config=print_config)
    if repair is not None:
        if out is not None:
            raise BadInput("--repair, -o: give one of them")
        with log_nothing(), running_service(interrupted=INTERRUPTED):
            from ogm_services.recorder.repair import repair_recording

            typer.echo(repair_recording(repair))
        return
    if out is None:
        raise BadInput("-o FILE.mcap is needed: where to record to (or --repair FILE.mcap)")
    with logged_service(*settings.log.as_given):
        with loading():
            from ogm_services.commands.record import run_record
        run_record(settings, out)
