"""`ogm status --watch`: the status again and again, with rates, as long as anybody looks."""

import json
import math
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from datetime import datetime
from typing import Protocol

import typer
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

import ogm_client
from ogm_client.errors import CannotConnect, ClientError, NobodyAnswered
from ogm_client.status_reply import read_status
from ogm_client.transport import json_object
from ogm_core.errors import BadInput
from ogm_core.status import Status
from ogm_services.commands.status import Rates, status_tables

DEFAULT_PERIOD = 2.0
MIN_PERIOD = 0.1

Connect = Callable[[], AbstractContextManager[ogm_client.MapClient]]


class View(Protocol):
    """Where what is seen is shown."""

    def show(self, body: bytes) -> None:
        """Show a status, as the mapper sends it."""

    def nobody(self, why: str) -> None:
        """Say that there is none just now, and why."""


def check_period(period: float | None) -> float:
    """The time between two looks, s.

    Raises:
        BadInput: it is none.
    """
    if period is None:
        return DEFAULT_PERIOD
    if not MIN_PERIOD <= period < math.inf:
        raise BadInput(f"--watch: {MIN_PERIOD:g} s or more are needed, got {period:g}")
    return period


def watch(connect: Connect, address: str, period: float, *, as_json: bool) -> None:
    """Show the status every `period` seconds until KeyboardInterrupt, whether or not a mapper answers.

    `as_json`: a line each. On a terminal a table stays in its place; elsewhere one follows the other.

    Raises:
        BadSetting: there can be no mapper at the address, now or later.
    """
    console = Console()
    if as_json:
        _look(connect, address, period, _Lines())
    elif not console.is_terminal:
        _look(connect, address, period, _Tables(console.print, in_place=False))
    else:
        with Live(console=console, auto_refresh=False) as live:
            tables = _Tables(lambda shown: live.update(shown, refresh=True), in_place=True)
            _look(connect, address, period, tables)


def _look(connect: Connect, address: str, period: float, view: View) -> None:
    """Look again and again; after a failure by a new connection, for a mapper may come back elsewhere."""
    while True:
        try:
            with connect() as client:
                while True:
                    began = time.monotonic()
                    view.show(client.fetch("status"))
                    time.sleep(max(0.0, began + period - time.monotonic()))
        except (CannotConnect, NobodyAnswered):
            view.nobody(f"no mapper answers at {address}, trying again")
        except ClientError as error:
            view.nobody(f"{error}, trying again")
        time.sleep(period)


class _Lines:
    """A line of JSON for each status on stdout; on stderr, once, that there is none."""

    def __init__(self) -> None:
        self._told = ""

    def show(self, body: bytes) -> None:
        self._told = ""
        typer.echo(json.dumps(json_object("status", body)))

    def nobody(self, why: str) -> None:
        if why != self._told:
            typer.echo(f"ogm: {why}", err=True)
        self._told = why


class _Tables:
    """Tables of the newest status, with the rates since the one before.

    `in_place`: what is put takes the place of what was put before, so that a table stays while none comes.
    """

    def __init__(self, put: Callable[[RenderableType], None], *, in_place: bool) -> None:
        self._put = put
        self._in_place = in_place
        self._before: Status | None = None
        self._tables: list[RenderableType] = []

    def show(self, body: bytes) -> None:
        status = read_status(body)
        rates = rates_between(self._before, status)
        self._tables = [Text(f"at {_clock()}"), *status_tables(status, rates)]
        self._before = status
        self._put(Group(*self._tables))

    def nobody(self, why: str) -> None:
        kept = self._tables if self._in_place else []
        self._put(Group(*kept, Text(f"{_clock()}: {why}", style="bold red")))


def rates_between(before: Status | None, now: Status) -> Rates | None:
    """What has happened a second, by the mapper's own clock; None without two looks at the same mapper."""
    if before is None:
        return None
    seconds = now.uptime_s - before.uptime_s
    then, counts = before.scans, now.scans
    if (
        now.run != before.run or seconds <= 0.0 or counts.received < then.received
    ):  # another mapper has taken its place
        return None
    dropped = sum(counts.dropped.values()) - sum(then.dropped.values())
    return Rates(
        (counts.received - then.received) / seconds,
        (counts.integrated - then.integrated) / seconds,
        dropped / seconds,
        _by_source(before, now, seconds),
    )


def _by_source(before: Status, now: Status, seconds: float) -> dict[str, float]:
    """Received scans a second of each sensor; none of one that is counted from the start again."""
    then, counts = _received(before), _received(now)
    gained = {source: count - then.get(source, 0) for source, count in counts.items()}
    return {source: count / seconds for source, count in gained.items() if count >= 0}


def _received(status: Status) -> dict[str, int]:
    return {
        f"{name}/{sensor}": source.received
        for name, robot in status.robots.items()
        for sensor, source in robot.sources.items()
    }


def _clock() -> str:
    return f"{datetime.now().astimezone():%H:%M:%S}"
