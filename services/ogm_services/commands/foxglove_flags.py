"""The command `ogm foxglove` and its flags; what it does is in `foxglove`, which is loaded when it runs."""

from pathlib import Path
from typing import Annotated

import typer

from ogm_services.results.written import out_path
from ogm_services.runtime.loading import loading
from ogm_services.runtime.logged_service import logged_service
from ogm_services.settings.flag_groups import with_flag_groups
from ogm_services.settings.flags import ClientFlags, ConfigFile, LoggingFlags, PrintConfig, Url, settings_from


@with_flag_groups
def foxglove(
    network: ClientFlags,
    logging: LoggingFlags,
    url: Url = None,
    config: ConfigFile = None,
    print_config: PrintConfig = False,
    host: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Address to serve viewers on; nobody is asked who it is.")
    ] = "127.0.0.1",
    port: Annotated[
        int,
        typer.Option(
            "--port", metavar="PORT", help="Port to serve viewers on, 0 for any free one.", min=0, max=65535
        ),
    ] = 8765,
    layout: Annotated[
        Path | None,
        typer.Option(
            parser=out_path,
            metavar="FILE.json",
            help="Write a layout for viewers, of map, robots and scans there are now, and do nothing else.",
        ),
    ] = None,
) -> None:
    """Show a running mapper's map, robots and scans live in Foxglove or Lichtblick, until Ctrl-C."""
    settings = settings_from(config, network, logging, print_config=print_config)
    with logged_service(*settings.log.as_given):
        with loading():
            from ogm_services.foxglove.installed import check_installed

            check_installed()
            from ogm_services.commands.foxglove import run_foxglove, write_layout
        if layout is not None:
            write_layout(url, settings.network, layout)
        else:
            run_foxglove(url, settings.network, host, port)
