"""`ogm foxglove`: a mapper's map and robots, live, for Foxglove and Lichtblick; until Ctrl-C."""

import math
import threading
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import typer
import zenoh

from ogm_client import MapClient
from ogm_client.session import open_session
from ogm_core.whole_files import write_files
from ogm_services.commands.mapper_client import address_of, is_http, mapper_client
from ogm_services.foxglove.bridge import PERIOD, FoxgloveBridge
from ogm_services.foxglove.heard_robots import HeardRobots
from ogm_services.foxglove.layout import layout
from ogm_services.foxglove.server import FoxgloveServer
from ogm_services.results.written import written
from ogm_services.settings.settings import NetworkSettings


def write_layout(url: str | None, network: NetworkSettings, path: Path) -> None:
    """Write a layout file for viewers, with the scans of the robots that a mapper shows.

    Raises:
        ClientError: no mapper answers.
        BadInput, DiskFull: the file cannot be written.
    """
    with mapper_client(url, network) as client:
        content = layout(client.status().robots)
    with written(path, "--layout"):
        write_files({path: content.encode()})
    typer.echo(f"{path}: a layout to import in Foxglove or Lichtblick")


def run_foxglove(url: str | None, network: NetworkSettings, host: str, port: int) -> None:
    """Serve viewers until KeyboardInterrupt, whether or not a mapper is there.

    Raises:
        BadSetting, CannotConnect: there can be no mapper at the address.
        CannotListen: viewers cannot be served at this address and port.
    """
    where = address_of(url, network)
    with ExitStack() as opening:
        server = FoxgloveServer("zenoh-ogm", host, port)
        opening.callback(server.close)
        typer.echo(f"viewers  {server.url} (Foxglove, Lichtblick: Foxglove WebSocket)")
        client, heard = _connected(opening, url, network)
        bridge = opening.enter_context(FoxgloveBridge(server, client, heard, where))
        typer.echo(f"map of   {where}")
        pause = threading.Event()
        while True:
            pause.wait(PERIOD)
            bridge.step()


def _connected(
    opening: ExitStack, url: str | None, network: NetworkSettings
) -> tuple[MapClient, HeardRobots | None]:
    """A client of the mapper and, over Zenoh, what robots publish."""
    if is_http(url):
        return opening.enter_context(mapper_client(url, network)), None
    session = opening.enter_context(_session(url, network))
    client = opening.enter_context(MapClient(map_name=network.map_name, session=session))
    heard = HeardRobots(session, network.map_name)
    opening.callback(heard.close)
    return client, heard


def _session(url: str | None, network: NetworkSettings) -> zenoh.Session:
    """A session with the mapper or router, once one takes connections."""
    asked = network if url is None else network.model_copy(update={"connect": (url,)})
    return open_session(replace(asked.for_client(), connect_timeout=math.inf))
