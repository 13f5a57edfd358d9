"""`ogm demo`: a simulator and a mapper, each a process of its own, on this machine."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import typer

from ogm_client.map_client import MapClient
from ogm_client.session import listens_on, resolve_listen
from ogm_core.errors import BadSetting, OgmError
from ogm_core.simulation.catalogue import world_named
from ogm_core.status import ScanCounts
from ogm_services.mapper.service import LIVE_MAP
from ogm_services.results.map_folder import check_folder
from ogm_services.runtime.signals import held_signals
from ogm_services.settings.http import HttpSettings
from ogm_services.settings.settings import Settings
from ogm_services.settings.sources import without_settings

SHUTDOWN = 15.0
FIRST_SCAN = 30.0
"""Time for the first scan to be integrated, s."""
DRAIN = 10.0
"""Time for the scans on their way to be handled after the simulator's end, s."""
POLL = 0.1

Process = subprocess.Popen[str]


class DemoFailed(OgmError):
    """One of the demo's processes failed; it has said why."""

    slug = "demo-failed"


def run_demo(
    settings: Settings,
    *,
    world: str,
    start: tuple[float, float] | None = None,
    duration: float | None,
    out: Path | None,
) -> None:
    """Run a simulated robot and its mapper until KeyboardInterrupt, or `duration` s after the first scan.

    `start`, m, is where in a ROS map the robot begins. With `out` the mapper writes `build`'s files there at
    its end.

    Raises:
        BadSetting: the map is cut.
        BadWorld: there is no such world.
        DemoFailed: the mapper or the simulator failed.
    """
    if settings.shares.cuts.count > 1 or settings.shares.index is not None:
        raise BadSetting("shares: a demo has one mapper: leave out cuts_x, cuts_y and index")
    world_named(world, start)  # whatever there is to tell of it, the simulator tells
    if out is not None:
        check_folder(out)
    with tempfile.TemporaryDirectory(prefix="ogm-demo-") as folder:
        for_mapper, for_robot = _settings_files(settings, Path(folder))
        target = [] if out is None else ["--out", str(out)]
        begin = [] if start is None else ["--start", "{!r},{!r}".format(*start)]
        with _process("mapper", "--config", str(for_mapper), *target) as mapper:
            url = _announced(mapper)
            with _process("simulate", "--config", str(for_robot), "--world", world, *begin) as simulator:
                _run(mapper, simulator, url, duration)
            _until(lambda: _scans(url).pending == 0, mapper, deadline=time.monotonic() + DRAIN)


def _settings_files(settings: Settings, folder: Path) -> tuple[Path, Path]:
    """Write the settings of the mapper, its ports chosen, and of the robot that finds it."""
    network = settings.network
    listen = tuple(map(resolve_listen, network.for_mapper().listen))
    mapper_network = network.model_copy(update={"listen": listen})
    theirs = listen or listens_on(network.zenoh_config)
    there = {"listen": (), "connect": theirs, "zenoh_config": None} if theirs else {}
    robot_network = network.model_copy(update=there)
    mapper, robot = folder / "mapper.yaml", folder / "robot.yaml"
    for_mapper = settings.model_copy(update={"network": mapper_network})
    for_robot = settings.model_copy(update={"network": robot_network, "http": HttpSettings()})
    mapper.touch(mode=0o600)  # it may hold a token
    mapper.write_text(for_mapper.to_yaml(secrets=True), encoding="utf-8")
    robot.write_text(for_robot.to_yaml(), encoding="utf-8")
    return mapper, robot


def _announced(mapper: Process) -> str:
    """Pass on what the mapper prints when it is ready; return the URL of its live map."""
    assert mapper.stdout is not None
    for line in mapper.stdout:
        typer.echo(line.rstrip())
        if line.startswith(LIVE_MAP):
            return line.removeprefix(LIVE_MAP).strip()
    raise DemoFailed(f"the mapper ended with exit code {mapper.wait()}")


def _run(mapper: Process, simulator: Process, url: str, duration: float | None) -> None:
    if duration is not None:
        soon = time.monotonic() + FIRST_SCAN
        _until(lambda: _scans(url).integrated > 0, mapper, simulator, deadline=soon)
        scans = _scans(url)
        if not scans.integrated:
            raise DemoFailed(
                f"no scan was integrated within {FIRST_SCAN:g} s: {scans.received} received, {scans.pending} "
                f"pending, {sum(scans.dropped.values())} dropped"
            )
    _until(
        lambda: False, mapper, simulator, deadline=None if duration is None else time.monotonic() + duration
    )


def _until(reached: Callable[[], bool], *processes: Process, deadline: float | None = None) -> None:
    """Poll until `reached` or the deadline, as long as all processes run."""
    while not (reached() or (deadline is not None and time.monotonic() >= deadline)):
        for process in processes:
            if process.poll() is not None:
                raise DemoFailed(f"{_name(process)} ended with exit code {process.returncode}")
        time.sleep(POLL)


def _scans(url: str) -> ScanCounts:
    with MapClient(url) as client:
        return client.status().scans


@contextmanager
def _process(*arguments: str) -> Iterator[Process]:
    """Run `ogm` with these arguments, in this terminal's process group; stop it at the end."""
    with ExitStack() as ending:
        with held_signals():  # a signal between the start and the callback would leave the process behind
            process = subprocess.Popen(
                [sys.executable, "-m", "ogm_services", *arguments],
                env=without_settings(os.environ),
                stdout=subprocess.PIPE,
                text=True,
            )
            ending.callback(_stop, process)
        yield process
    if process.returncode != 0:
        raise DemoFailed(f"{_name(process)} ended with exit code {process.returncode}")


def _stop(process: Process) -> None:
    """End a process as Ctrl-C would, or by force if it takes too long; pass on what it printed."""
    process.terminate()
    try:
        printed, _ = process.communicate(timeout=SHUTDOWN)
    except subprocess.TimeoutExpired:
        process.kill()
        printed, _ = process.communicate()
    if printed:
        typer.echo(printed.rstrip())


def _name(process: Process) -> str:
    """Which of the demo's processes this is, by its command."""
    command = list(process.args) if isinstance(process.args, list) else []
    return "the simulator" if "simulate" in command else "the mapper"
