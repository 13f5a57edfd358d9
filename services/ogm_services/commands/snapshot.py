"""`ogm snapshot`: the maps that a running mapper has saved under names.

It imports what it needs when it runs, so that `ogm --help` answers at once.
"""

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from ogm_core.status import SnapshotInfo
from ogm_services.commands.write_flags import AsJson, WriteFlags
from ogm_services.settings.flag_groups import with_flag_groups
from ogm_services.settings.flags import ClientFlags, ConfigFile, Url, settings_from

if TYPE_CHECKING:
    from rich.table import Table

    from ogm_client import MapClient

SECONDS = len("2026-01-31 12:00:00")
"""So much of a time fits into a table beside another one."""
app = typer.Typer(
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Save a running mapper's map under names, and go on with one of them.",
)
Name = Annotated[str, typer.Argument(metavar="NAME", help="Of the snapshot: 1 to 64 of A-Z a-z 0-9 _ - .")]


@app.command("list")
@with_flag_groups
def list_all(
    network: ClientFlags, url: Url = None, config: ConfigFile = None, as_json: AsJson = False
) -> None:
    """List the maps that are saved."""
    from ogm_services.commands.mapper_client import asking, mapper_client

    with mapper_client(url, settings_from(config, network).network) as client, asking():
        if as_json:
            _print_json(client, "snapshots")
            return
        found = client.snapshots()
    if not found:
        typer.echo("no map is saved")
        return
    from rich.console import Console

    Console().print(snapshots_table(found))


@app.command()
@with_flag_groups
def save(name: Name, network: ClientFlags, asked: WriteFlags) -> None:
    """Save the map of this moment under a name that is not taken."""
    with asked.client(network) as client:
        saved = client.save_snapshot(name)
    if asked.as_json:
        typer.echo(json.dumps(asdict(saved), indent=2))
    else:
        typer.echo(f"{saved.name}: revision {saved.revision}, {saved.bytes / 1e6:.1f} MB")


@app.command()
@with_flag_groups
def restore(name: Name, network: ClientFlags, asked: WriteFlags) -> None:
    """Go on with the map that is saved under a name, in place of the one that there is."""
    with asked.client(network) as client:
        client.restore_snapshot(name)
        if asked.as_json:
            _print_json(client, "status")
            return
        status = client.status()
    typer.echo(f"{name}: the map goes on from it, now at revision {status.revision}, epoch {status.epoch}")


@app.command()
@with_flag_groups
def delete(name: Name, network: ClientFlags, asked: WriteFlags) -> None:
    """Delete the map that is saved under a name; the live map stays as it is."""
    with asked.client(network) as client:
        client.delete_snapshot(name)
        if asked.as_json:
            _print_json(client, "snapshots")
            return
    typer.echo(f"{name}: deleted")


def snapshots_table(found: list[SnapshotInfo]) -> "Table":
    """A row for every saved map: when it was saved, and which map it is; or what is wrong with its file."""
    from ogm_services.commands.status import local_time, plain_table

    table = plain_table("snapshot", "saved", right=("revision", "newest scan", "MB"))
    if any(saved.damage for saved in found):
        table.add_column("damage")
    for saved in found:
        row = [saved.name, local_time(saved.saved)[:SECONDS]]
        if saved.damage is None:
            row += [str(saved.revision), local_time(saved.stamp)[:SECONDS], f"{saved.bytes / 1e6:.1f}"]
        else:
            row += ["", "", f"{saved.bytes / 1e6:.1f}", saved.damage]
        table.add_row(*row)
    return table


def _print_json(client: "MapClient", name: str) -> None:
    from ogm_client.transport import json_object

    typer.echo(json.dumps(json_object(name, client.fetch(name)), indent=2))
