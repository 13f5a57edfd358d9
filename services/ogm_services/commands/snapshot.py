"""`ogm snapshot`: the maps that a running mapper has saved under names.

It imports what it needs when it runs, so that `ogm --help` answers at once.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ogm_core.errors import BadInput
from ogm_core.status import SnapshotInfo
from ogm_services.settings.flags import (
    ClientFlags,
    ConfigFile,
    Url,
    settings_from,
    with_flag_groups,
)

if TYPE_CHECKING:
    from rich.table import Table

    from ogm_client import MapClient

SECONDS = len("2026-01-31 12:00:00")
"""So much of a time fits into a table beside another one."""
WRITE_TIMEOUT = 60.0
"""How long a mapper may take to write a map to its disk, s."""

app = typer.Typer(
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Save a running mapper's map under names, and go on with one of them.",
)
Name = Annotated[str, typer.Argument(metavar="NAME", help="Of the snapshot: 1 to 64 of A-Z a-z 0-9 _ - .")]
TokenFile = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="File with the mapper's token, for HTTP (default: that of the settings, if any)."
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]


@dataclass(frozen=True)
class WriteFlags:
    """Flags of who changes something: at which mapper, with which token, and how it is told."""

    url: Url = None
    token_file: TokenFile = None
    config: ConfigFile = None
    as_json: AsJson = False

    @contextmanager
    def client(self, network: ClientFlags) -> Iterator["MapClient"]:
        """A client that may change something, with the mapper's token if there is one."""
        from ogm_services.commands.mapper_client import asking, is_http, mapper_client
        from ogm_services.settings.settings import token_in

        settings = settings_from(self.config, network)
        options: dict[str, Any] = {"timeout": WRITE_TIMEOUT}
        if is_http(self.url):
            from_file = None if self.token_file is None else token_in(self.token_file, "--token-file")
            token = from_file or settings.http.write_token()
            options["token"] = None if token is None else token.decode("ascii")
        elif self.token_file is not None:
            raise BadInput(
                f"--token-file {self.token_file}: the token is for HTTP alone (--url http://HOST:PORT); over "
                "Zenoh certificates say who may"
            )
        with mapper_client(self.url, settings.network, **options) as client, asking():
            yield client


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
