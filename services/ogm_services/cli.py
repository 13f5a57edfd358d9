"""`ogm`, the command line: one command per service, and what fetches from a running mapper.

Commands import what they need when they run, so that `ogm --help` answers at once.
"""

import json
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from ogm_core.errors import BadInput
from ogm_services.commands import snapshot
from ogm_services.commands.build_flags import build
from ogm_services.commands.compare import compare
from ogm_services.commands.erase import erase
from ogm_services.commands.forget import forget
from ogm_services.commands.foxglove_flags import foxglove
from ogm_services.commands.gateway_flags import gateway
from ogm_services.commands.log_flags import Log
from ogm_services.commands.mapper_flags import demo, mapper
from ogm_services.commands.merge import merge
from ogm_services.commands.quality_flags import quality
from ogm_services.commands.record_flags import record
from ogm_services.commands.replay_flags import replay
from ogm_services.commands.ros2_flags import ros2
from ogm_services.commands.simulator_flags import simulate
from ogm_services.results.written import out_path
from ogm_services.runtime.endings import INTERRUPTED, OneLineErrors
from ogm_services.runtime.kernel_cache import kernel_cache
from ogm_services.runtime.loading import loading
from ogm_services.runtime.log_lines import log_nothing
from ogm_services.runtime.signals import running_service
from ogm_services.runtime.terminal import outlive_terminal
from ogm_services.settings.flag_groups import with_flag_groups
from ogm_services.settings.flags import ClientFlags, ConfigFile, Url, settings_from

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


app.command(rich_help_panel=LIVE)(demo)
app.command(rich_help_panel=LIVE)(mapper)
app.command(rich_help_panel=LIVE)(gateway)
app.command(rich_help_panel=LIVE)(simulate)
app.command(rich_help_panel=LIVE)(replay)
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
            "--out",
            "-o",
            parser=out_path,
            metavar="FILE",
            help="File to write; - for stdout (default: NAME, here).",
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
app.command(rich_help_panel=RUNNING)(forget)
app.command(rich_help_panel=RUNNING)(foxglove)


app.command(rich_help_panel=FILES)(build)
app.command(rich_help_panel=FILES)(quality)
app.command(rich_help_panel=FILES)(compare)
app.command(rich_help_panel=FILES)(merge)


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
        Path,
        typer.Option(parser=out_path, metavar="NEW", help="Folder for a new store; it is made, or is empty."),
    ],
) -> None:
    """Save what is intact of a damaged stored map into a new store, and tell what is not."""
    with running_service(interrupted=INTERRUPTED), kernel_cache():
        with loading():
            from ogm_services.commands.repair import run_repair
        run_repair(folder, out)
