"""Flags of the commands that change something at a running mapper.

It imports what it needs when it runs, so that `ogm --help` answers at once.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ogm_core.errors import BadInput
from ogm_services.settings.flags import ClientFlags, ConfigFile, Url, settings_from

if TYPE_CHECKING:
    from ogm_client import MapClient

WRITE_TIMEOUT = 60.0
"""How long a mapper may take to write a map to its disk, s."""
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
        from ogm_services.settings.http import token_in

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
