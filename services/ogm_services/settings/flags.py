"""The flags of settings, each group defined once for the commands that share it (see `flag_groups`).

They pass on text and nothing else: `settings.settings` judges values, whichever source they come from.
"""

import os
from contextlib import nullcontext
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, get_args

import typer

from ogm_core.cells.log_odds import CellType
from ogm_core.grid_settings import CellModelName, Outside, SensorModel, Traversal
from ogm_core.wire.keys import DEFAULT_ADDRESS
from ogm_services.runtime.log_lines import log_to_stderr, tell
from ogm_services.settings.described import described
from ogm_services.settings.settings import SECTIONS, Settings
from ogm_services.settings.sources import flag_name, settings_and_origins
from ogm_services.settings.values import LogFormat, LogLevel, Preset

PANELS = {
    "map": "Map",
    "network": "Network",
    "http": "HTTP",
    "mapper": "Mapper",
    "shares": "Shares",
    "log": "Logging",
}


def setting(section: str, key: str, metavar: str | None, text: str) -> Any:  # noqa: ANN401 (typer's own type)
    """Option of a setting: its flag, its help with the default, its panel of the help page."""
    default = SECTIONS[section].model_fields[key].default
    shown = "none" if default in (None, ()) else default
    if isinstance(default, bool):
        shown = "on" if default else "off"
    if isinstance(default, float):
        shown = f"{default:g}"
    return typer.Option(
        flag_name(section, key),
        metavar=metavar,
        help=f"{text} (default: {shown}).",
        rich_help_panel=PANELS[section],
    )


def _choices(kind: Any) -> str:  # noqa: ANN401 (any Literal)
    return "|".join(get_args(kind))


@dataclass(frozen=True)
class SettingFlags:
    """A group whose fields are the keys of one section of the settings."""

    section: ClassVar[str]

    def given(self) -> dict[str, Any]:
        """What was given on the command line, by key."""
        return {
            field.name: value
            for field in fields(self)
            if (value := getattr(self, field.name)) is not None and value is not False
        }


@dataclass(frozen=True)
class MapFlags(SettingFlags):
    """Map flags of demo, mapper and build."""

    section = "map"

    preset: Annotated[
        str | None, setting("map", "preset", _choices(Preset), "Replace all map defaults by a preset's")
    ] = None
    resolution: Annotated[str | None, setting("map", "resolution", "METRES", "Size of a cell")] = None
    sensor_model: Annotated[
        str | None, setting("map", "sensor_model", _choices(SensorModel), "How a scan is read")
    ] = None
    model: Annotated[str | None, typer.Option("--model", hidden=True)] = None
    """What `sensor_model` was called at first."""
    cell_model: Annotated[
        str | None, setting("map", "cell_model", _choices(CellModelName), "What a cell keeps")
    ] = None
    traversal: Annotated[
        str | None,
        setting("map", "traversal", _choices(Traversal), "How a beam is traced through the cells"),
    ] = None
    p_occ: Annotated[str | None, setting("map", "p_occ", "P", "Probability that a hit stands for")] = None
    p_free: Annotated[
        str | None, setting("map", "p_free", "P", "Probability that a passing beam stands for")
    ] = None
    p_prior: Annotated[
        str | None, setting("map", "p_prior", "P", "Probability of a cell before any beam")
    ] = None
    alpha: Annotated[
        str | None,
        setting(
            "map", "alpha", "METRES", "Obstacle thickness, 3 to 6 standard deviations of the range noise"
        ),
    ] = None
    l_min: Annotated[str | None, setting("map", "l_min", "LOGODDS", "Lower clamp of the log odds")] = None
    l_max: Annotated[str | None, setting("map", "l_max", "LOGODDS", "Upper clamp of the log odds")] = None
    reach: Annotated[
        str | None, setting("map", "reach", "METRES", "No beam writes farther from the sensor than this")
    ] = None
    clear_range: Annotated[
        str | None,
        setting("map", "clear_range", "METRES", "A beam without return clears no farther than this"),
    ] = None
    cells: Annotated[
        str | None, setting("map", "cells", _choices(CellType), "How a cell's log odds are stored")
    ] = None
    bounds: Annotated[
        str | None,
        setting("map", "bounds", "XMIN,YMIN,XMAX,YMAX", "Limit the map to this rectangle, in metres"),
    ] = None
    outside: Annotated[
        str | None,
        setting(
            "map", "outside", _choices(Outside), "With bounds: cut off a beam that leaves them, or ignore it"
        ),
    ] = None
    half_life: Annotated[
        str | None,
        setting("map", "half_life", "SECONDS", "Let the map forget: half of what a cell knows in this time"),
    ] = None
    free_below: Annotated[
        str | None,
        setting("map", "free_below", "P", "Call cells free below this probability: .05 for cautious robots"),
    ] = None


@dataclass(frozen=True)
class NetworkFlags(SettingFlags):
    """Network flags of every service."""

    section = "network"

    map_name: Annotated[str | None, setting("network", "map_name", "NAME", "Name of the map")] = None
    listen: Annotated[
        str | None,
        setting(
            "network",
            "listen",
            "ENDPOINTS",
            "Zenoh endpoints to listen on, separated by commas; "
            f"a mapper told nothing listens on {DEFAULT_ADDRESS}",
        ),
    ] = None
    connect: Annotated[
        str | None,
        setting(
            "network",
            "connect",
            "ENDPOINTS",
            f"Zenoh endpoints to connect to, separated by commas; others than a mapper try {DEFAULT_ADDRESS}",
        ),
    ] = None
    zenoh_config: Annotated[
        str | None, setting("network", "zenoh_config", "FILE.json5", "Zenoh configuration file")
    ] = None


@dataclass(frozen=True)
class ClientFlags(SettingFlags):
    """Network flags of who only asks a mapper, and gives its address as --url."""

    section = "network"

    map_name: Annotated[
        str | None,
        setting("network", "map_name", "NAME", "Name of the map; without it, over HTTP, whichever is served"),
    ] = None
    zenoh_config: Annotated[
        str | None, setting("network", "zenoh_config", "FILE.json5", "Zenoh configuration file")
    ] = None


@dataclass(frozen=True)
class HttpFlags(SettingFlags):
    """HTTP flags of the mapper."""

    section = "http"

    host: Annotated[str | None, setting("http", "host", "ADDRESS", "Address to serve HTTP on")] = None
    port: Annotated[
        str | None, setting("http", "port", "PORT", "Port to serve HTTP on, 0 for any free one")
    ] = None
    hosts: Annotated[
        str | None,
        setting(
            "http",
            "hosts",
            "NAMES",
            "Names that HTTP is asked by, besides the machine's own, separated by commas",
        ),
    ] = None
    root_path: Annotated[
        str | None,
        setting("http", "root_path", "PATH", "Path that a reverse proxy serves all of it under"),
    ] = None
    token_file: Annotated[
        str | None,
        setting("http", "token_file", "FILE", "File with the bearer token that guards writes over HTTP"),
    ] = None


@dataclass(frozen=True)
class LoggingFlags(SettingFlags):
    """Flags of what a service logs."""

    section = "log"

    level: Annotated[
        str | None, setting("log", "level", _choices(LogLevel), "What is logged, from this level on")
    ] = None
    format: Annotated[
        str | None,
        setting("log", "format", _choices(LogFormat), "Lines of text, or a JSON object on each"),
    ] = None


Url = Annotated[
    str | None,
    typer.Option(
        "--url",  # typer 0.27 and 0.28 would name it as its metavar
        metavar="URL",
        help="The mapper: http://HOST:PORT, or a Zenoh endpoint such as tcp/HOST:PORT "
        f"(default: where the settings connect to, else {DEFAULT_ADDRESS}).",
    ),
]
ConfigFile = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE.yaml", help="Settings file; environment and flags override it."),
]


PrintConfig = Annotated[
    bool,
    typer.Option(
        "--print-config", help="Print every setting as YAML, with where it comes from, and do nothing else."
    ),
]


def settings_from(
    config: Path | None,
    *groups: SettingFlags,
    sensors: list[str] | None = None,
    robots: list[str] | None = None,
    print_config: bool = False,
) -> Settings:
    """Settings of a command, from its flags, this process's environment and its settings file.

    What should be changed in them is told, in the form of the log if the command has one.

    Raises:
        Exit: they were to be printed, and are.
    """
    notes: list[str] = []
    settings, origins = settings_and_origins(
        config=config,
        flags={group.section: group.given() for group in groups},
        environ=os.environ,
        sensors=sensors or (),
        robots=robots or (),
        tell=notes.append,
    )
    logs = any(isinstance(group, LoggingFlags) for group in groups)
    with log_to_stderr(settings.log.level, settings.log.format) if logs else nullcontext():
        for note in notes:
            tell(note)
    if print_config:
        typer.echo(described(settings, origins), nl=False)
        raise typer.Exit
    return settings
