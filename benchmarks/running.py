"""Running services that are measured: started on free loopback ports, and stopped whatever happens."""

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import zenoh

from ogm_client import MapClient, RobotPublisher
from ogm_client.session import resolve_listen
from ogm_core.types import PlacedScan
from ogm_services.settings.sources import without_settings

ROOT = Path(__file__).parents[1]
PACKAGES = (".", "services", "clients")
"""Where the packages of a checkout lie."""
STARTED, STOPPED, HANDLED = 180.0, 15.0, 60.0
"""How long a service may take to start, to end, and to handle what it was sent, s."""


@dataclass(frozen=True)
class RunningMapper:
    """A mapper that is ready, and where it is reached: `endpoint` over Zenoh, `url` over HTTP."""

    endpoint: str
    url: str


@contextmanager
def mapper(*flags: str) -> Iterator[RunningMapper]:
    """An `ogm mapper` process with these flags."""
    command = ["mapper", "--http-port", "0", "--listen", "tcp/127.0.0.1:0", "--log-level", "warning", *flags]
    with ogm(*command) as process:
        endpoint = line_after(process, "on Zenoh at ")
        yield RunningMapper(endpoint, line_after(process, "live map "))


@contextmanager
def router() -> Iterator[str]:
    """A Zenoh router in this process, and where it is reached."""
    endpoint = resolve_listen("tcp/127.0.0.1:0")
    scouting = "scouting: {multicast: {enabled: false}, gossip: {enabled: false}}"
    config = zenoh.Config.from_json5(f'{{mode: "router", listen: {{endpoints: ["{endpoint}"]}}, {scouting}}}')
    with zenoh.open(config):
        yield endpoint


@contextmanager
def ogm(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """An `ogm` process without settings in its environment; its standard output is a pipe."""
    with program([sys.executable, "-X", "faulthandler", "-m", "ogm_services", *arguments]) as process:
        yield process


@contextmanager
def program(
    command: Sequence[str], log: IO[bytes] | None = None, folder: Path = ROOT
) -> Iterator[subprocess.Popen[bytes]]:
    """A process in the project's folder that is told to end, and made to if it does not.

    Its standard error goes to `log`; None: to this process's own. With another `folder`, a checkout of the
    project, it is that one's code that runs.
    """
    own = {} if folder == ROOT else {"PYTHONPATH": ":".join(str(folder / part) for part in PACKAGES)}
    process = subprocess.Popen(
        command, cwd=folder, env=environment() | own, stdout=subprocess.PIPE, stderr=log, bufsize=0
    )
    with process:
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(STOPPED)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGABRT)  # Python then shows where all its threads stand
                print(f"{process.args!r} did not end within {STOPPED:g} s and was killed")


def environment() -> dict[str, str]:
    """This process's environment without `ogm`'s settings."""
    return without_settings(os.environ)


def line_after(process: subprocess.Popen[bytes], beginning: str) -> str:
    """The rest of the first line of its output that holds `beginning`.

    Raises:
        RuntimeError: it ended without, or did not write it in time.
    """
    assert process.stdout is not None
    deadline, line = time.monotonic() + STARTED, b""
    while select.select([process.stdout], [], [], max(0.0, deadline - time.monotonic()))[0]:
        byte = process.stdout.read(1)  # not buffered: what follows the line is left to the next call
        line += byte
        if byte in (b"", b"\n"):
            _, found, rest = line.decode().partition(beginning)
            if found:
                return rest.strip()
            if not byte:
                break
            line = b""
    raise RuntimeError(f"{process.args!r} did not print {beginning!r} within {STARTED:g} s")


def wait_for_revision(client: MapClient, revision: int, pause: float = 0.002) -> None:
    """Return when the map has come so far; ask every `pause` seconds.

    Raises:
        TimeoutError: it did not in time.
    """
    deadline = time.monotonic() + HANDLED
    while client.status().revision < revision:
        if time.monotonic() >= deadline:
            raise TimeoutError(f"revision {revision} was not reached within {HANDLED:g} s")
        time.sleep(pause)


def map_scans(running: RunningMapper, scans: Sequence[PlacedScan]) -> None:
    """Have an empty map made of scans, fewer than a mapper's queue takes; return when they are in it."""
    with (
        MapClient(running.endpoint) as client,
        RobotPublisher("before", address=running.endpoint, reliable=True) as robot,
    ):
        robot.wait_for_mapper()
        for placed in scans:
            robot.put_scan("laser", placed.scan)
        wait_for_revision(client, len(scans), pause=0.02)
