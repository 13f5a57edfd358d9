"""`ogm get` and `ogm status`: what a running mapper serves, as files and as a table."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import parse_qsl

from rich import box
from rich.table import Table

from ogm_client import MapClient, MapperError
from ogm_core.errors import BadInput, BadParameter
from ogm_core.lattice import Region
from ogm_services.settings.values import parse_region

STDOUT = Path("-")


def fetch(client: MapClient, name: str, out: Path, stdout: BinaryIO) -> None:
    """Write what the mapper serves as `name` into `out`, or to `stdout` if that is "-".

    `name` may carry parameters: map.png?palette=probability&max_size=500. map.yaml comes with its PGM,
    beside it and of the same map.

    Raises:
        BadInput: a parameter is wrong, or `out` cannot be written.
        ClientError: the mapper does not answer, or refuses.
    """
    name, _, query = name.lstrip("/").partition("?")
    parameters = _parameters(query)
    if name == "map.yaml":
        if out == STDOUT:
            raise BadInput("map.yaml comes with its map.pgm, two files: give -o FILE.yaml")
        with _asking():
            grid = client.get_map(_region(parameters))
        with _writing(out):
            grid.save_ros_map(out)
        return
    with _asking():
        content = client.fetch(name, **parameters)
    with _writing(out):
        if out == STDOUT:
            stdout.write(content)
            stdout.flush()
        else:
            out.write_bytes(content)


@contextmanager
def _asking() -> Iterator[None]:
    """What a mapper finds wrong with a request is what the user gave."""
    try:
        yield
    except MapperError as error:
        if error.status == 400:
            raise BadParameter(error.detail) from None
        raise


@contextmanager
def _writing(out: Path) -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:  # the reader of stdout has had enough
        raise
    except OSError as error:
        raise BadInput(f"{out}: cannot be written: {error.strerror}") from None


def _parameters(query: str) -> dict[str, str]:
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError:
        raise BadParameter(f"{query!r}: parameters are written KEY=VALUE&KEY=VALUE") from None
    parameters = dict(pairs)
    if len(parameters) < len(pairs):
        raise BadParameter(f"{query!r}: every parameter is given once")
    return parameters


def _region(parameters: Mapping[str, str]) -> Region | None:
    unknown = sorted(parameters.keys() - {"region"})
    if unknown:
        raise BadParameter(f"map.yaml takes the parameter region only, not {', '.join(unknown)}")
    if "region" not in parameters:
        return None
    try:
        return parse_region(parameters["region"])
    except ValueError as error:
        raise BadParameter(f"region: {error}") from None


def status_tables(status: Mapping[str, Any]) -> list[Table]:
    """The mapper's status for the eye: the map as a whole, then a row for every robot and sensor."""
    scans, poses, info = status["scans"], status["poses"], status["map_info"]
    whole = Table(box=box.SIMPLE, show_header=False, title=f"map {status['map']}", title_justify="left")
    whole.add_column(style="bold")
    whole.add_column()
    rows = {
        "epoch": status["epoch"],
        "revision": status["revision"],
        "stamp": _time(status["stamp"]),
        "scans": _counts(scans, "received", "integrated", "pending"),
        "dropped": _nonzero(scans["dropped"]),
        "poses": _counts(poses, "received", "malformed", "late"),
        "ignored": status["other"]["ignored"],
        "size": f"{info['width']} x {info['height']} cells of {info['resolution']:g} m",
        "known": f"{info['known_cells']} cells",
        "memory": f"{info['bytes'] / 1e6:.1f} MB",
        "up": f"{status['uptime_s']:.0f} s",
    }
    for label, value in rows.items():
        whole.add_row(label, str(value))
    return [whole, _sources(status["robots"])]


def _sources(robots: Mapping[str, Any]) -> Table:
    table = Table(box=box.SIMPLE, collapse_padding=True, pad_edge=False)
    for column in ("robot", "x", "y", "theta", "sensor", "received", "integrated", "pending", "last seq"):
        table.add_column(column, justify="left" if column in ("robot", "sensor") else "right")
    for name, robot in sorted(robots.items()):
        pose = [f"{value:.2f}" for value in robot["pose"] or ()] or [""] * 3
        for sensor, source in sorted(robot["sources"].items()) or [("", {})]:
            counts = (source.get(key) for key in ("received", "integrated", "pending", "last_seq"))
            table.add_row(name, *pose, sensor, *("" if count is None else str(count) for count in counts))
            name, pose = "", [""] * 3  # once per robot
    return table


def _counts(values: Mapping[str, int], *keys: str) -> str:
    return ", ".join(f"{values[key]} {key}" for key in keys)


def _nonzero(dropped: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in dropped.items() if count) or "none"


def _time(stamp: int | None) -> str:
    if stamp is None:
        return "none"
    return (
        datetime.fromtimestamp(stamp / 1e9, tz=UTC).astimezone().isoformat(sep=" ", timespec="milliseconds")
    )
