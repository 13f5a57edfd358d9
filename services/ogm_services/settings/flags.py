"""The flags that commands share, each group defined once, and the decorator that gives them to a command.

A group is a frozen dataclass whose fields are annotated with `typer.Option`. Flags that give settings pass
on text and nothing else: `settings.settings` judges values, whichever source they come from.
"""

import inspect
import os
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, ClassVar, get_args, get_type_hints

import typer

from ogm_core.cells.log_odds import CellType
from ogm_core.errors import BadInput
from ogm_core.grid_settings import CellModelName, Outside, SensorModel, Traversal
from ogm_core.wire.keys import DEFAULT_ADDRESS
from ogm_services.runtime.log_lines import log_to_stderr, tell
from ogm_services.settings.described import described
from ogm_services.settings.entries import FORM, check_for_whom
from ogm_services.settings.settings import SECTIONS, Settings
from ogm_services.settings.sources import flag_name, settings_and_origins
from ogm_services.settings.values import LogFormat, LogLevel, Preset

PANELS = {"map": "Map", "network": "Network", "http": "HTTP", "mapper": "Mapper", "log": "Logging"}


def _setting(section: str, key: str, metavar: str, text: str) -> Any:  # noqa: ANN401 (typer's own type)
    """Option of a setting: its flag, its help with the default, its panel of the help page."""
    default = SECTIONS[section].model_fields[key].default
    shown = "none" if default in (None, ()) else default
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
class _SettingFlags:
    """A group whose fields are the keys of one section of the settings."""

    section: ClassVar[str]

    def given(self) -> dict[str, Any]:
        """What was given on the command line, by key."""
        return {
            field.name: value for field in fields(self) if (value := getattr(self, field.name)) is not None
        }


@dataclass(frozen=True)
class MapFlags(_SettingFlags):
    """Map flags of demo, mapper and build."""

    section = "map"

    preset: Annotated[
        str | None, _setting("map", "preset", _choices(Preset), "Replace all map defaults by a preset's")
    ] = None
    resolution: Annotated[str | None, _setting("map", "resolution", "METRES", "Size of a cell")] = None
    sensor_model: Annotated[
        str | None, _setting("map", "sensor_model", _choices(SensorModel), "How a scan is read")
    ] = None
    model: Annotated[str | None, typer.Option("--model", hidden=True)] = None
    """What `sensor_model` was called at first."""
    cell_model: Annotated[
        str | None, _setting("map", "cell_model", _choices(CellModelName), "What a cell keeps")
    ] = None
    traversal: Annotated[
        str | None,
        _setting("map", "traversal", _choices(Traversal), "How a beam is traced through the cells"),
    ] = None
    p_occ: Annotated[str | None, _setting("map", "p_occ", "P", "Probability that a hit stands for")] = None
    p_free: Annotated[
        str | None, _setting("map", "p_free", "P", "Probability that a passing beam stands for")
    ] = None
    p_prior: Annotated[
        str | None, _setting("map", "p_prior", "P", "Probability of a cell before any beam")
    ] = None
    alpha: Annotated[
        str | None,
        _setting(
            "map", "alpha", "METRES", "Obstacle thickness, 3 to 6 standard deviations of the range noise"
        ),
    ] = None
    l_min: Annotated[str | None, _setting("map", "l_min", "LOGODDS", "Lower clamp of the log odds")] = None
    l_max: Annotated[str | None, _setting("map", "l_max", "LOGODDS", "Upper clamp of the log odds")] = None
    reach: Annotated[
        str | None, _setting("map", "reach", "METRES", "No beam writes farther from the sensor than this")
    ] = None
    clear_range: Annotated[
        str | None,
        _setting("map", "clear_range", "METRES", "A beam without return clears no farther than this"),
    ] = None
    cells: Annotated[
        str | None, _setting("map", "cells", _choices(CellType), "How a cell's log odds are stored")
    ] = None
    bounds: Annotated[
        str | None,
        _setting("map", "bounds", "XMIN,YMIN,XMAX,YMAX", "Limit the map to this rectangle, in metres"),
    ] = None
    outside: Annotated[
        str | None,
        _setting(
            "map", "outside", _choices(Outside), "With bounds: cut off a beam that leaves them, or ignore it"
        ),
    ] = None
    half_life: Annotated[
        str | None,
        _setting("map", "half_life", "SECONDS", "Let the map forget: half of what a cell knows in this time"),
    ] = None


@dataclass(frozen=True)
class NetworkFlags(_SettingFlags):
    """Network flags of every service."""

    section = "network"

    map_name: Annotated[str | None, _setting("network", "map_name", "NAME", "Name of the map")] = None
    listen: Annotated[
        str | None,
        _setting(
            "network",
            "listen",
            "ENDPOINTS",
            "Zenoh endpoints to listen on, separated by commas; "
            f"a mapper told nothing listens on {DEFAULT_ADDRESS}",
        ),
    ] = None
    connect: Annotated[
        str | None,
        _setting(
            "network",
            "connect",
            "ENDPOINTS",
            f"Zenoh endpoints to connect to, separated by commas; others than a mapper try {DEFAULT_ADDRESS}",
        ),
    ] = None
    zenoh_config: Annotated[
        str | None, _setting("network", "zenoh_config", "FILE.json5", "Zenoh configuration file")
    ] = None


@dataclass(frozen=True)
class ClientFlags(_SettingFlags):
    """Network flags of who only asks a mapper, and gives its address as --url."""

    section = "network"

    map_name: Annotated[
        str | None,
        _setting(
            "network", "map_name", "NAME", "Name of the map; without it, over HTTP, whichever is served"
        ),
    ] = None
    zenoh_config: Annotated[
        str | None, _setting("network", "zenoh_config", "FILE.json5", "Zenoh configuration file")
    ] = None


@dataclass(frozen=True)
class HttpFlags(_SettingFlags):
    """HTTP flags of the mapper."""

    section = "http"

    host: Annotated[str | None, _setting("http", "host", "ADDRESS", "Address to serve HTTP on")] = None
    port: Annotated[
        str | None, _setting("http", "port", "PORT", "Port to serve HTTP on, 0 for any free one")
    ] = None
    hosts: Annotated[
        str | None,
        _setting(
            "http",
            "hosts",
            "NAMES",
            "Names that HTTP is asked by, besides the machine's own, separated by commas",
        ),
    ] = None
    token_file: Annotated[
        str | None,
        _setting("http", "token_file", "FILE", "File with the bearer token that guards writes over HTTP"),
    ] = None


@dataclass(frozen=True)
class MapperFlags(_SettingFlags):
    """Flags of the mapper alone."""

    section = "mapper"

    data: Annotated[
        str | None,
        _setting("mapper", "data", "DIR", "Store the map in this folder, and go on with the one in it"),
    ] = None
    start_map: Annotated[
        str | None,
        _setting("mapper", "start_map", "FILE", "Start with this ROS map (YAML) or map.npz, on its lattice"),
    ] = None
    start_confidence: Annotated[
        str | None,
        _setting("mapper", "start_confidence", "P", "Probability that the start map is right about a cell"),
    ] = None


@dataclass(frozen=True)
class LoggingFlags(_SettingFlags):
    """Flags of what a service logs."""

    section = "log"

    level: Annotated[
        str | None, _setting("log", "level", _choices(LogLevel), "What is logged, from this level on")
    ] = None
    format: Annotated[
        str | None,
        _setting("log", "format", _choices(LogFormat), "Lines of text, or a JSON object on each"),
    ] = None


@dataclass(frozen=True)
class LogFlags:
    """Log flags of build and replay; the reader of the log judges the values."""

    range_max: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            help="Ranges from here on mean 'no return' in this log, whatever it says itself.",
            rich_help_panel="Log",
        ),
    ] = None
    robot: Annotated[
        list[str] | None,
        typer.Option(
            metavar=f"NAME|{FORM}",
            help="Rename the log's one robot; or what robots do not say: radius, in a bag origin, name "
            "(repeatable).",
            rich_help_panel="Log",
        ),
    ] = None
    odometry: Annotated[
        bool,
        typer.Option(
            "--odometry",
            help="Take poses from the ODOM lines of a CARMEN log, instead of those in its laser's lines.",
            rich_help_panel="Log",
        ),
    ] = False

    @property
    def name(self) -> str | None:
        """The new name of the log's robot.

        Raises:
            BadInput: there are several.
        """
        names = [text for text in self.robot or () if ":" not in text]
        if len(names) > 1:
            raise BadInput(f"--robot: the log's one robot gets one name, not {' and '.join(names)}")
        return names[0] if names else None

    @property
    def robots(self) -> list[str]:
        """What is said of robots, GLOB:KEY=VALUE,... of each."""
        return [text for text in self.robot or () if ":" in text]


Url = Annotated[
    str | None,
    typer.Option(
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
SensorFlags = Annotated[
    list[str] | None,
    typer.Option(
        "--sensor",
        metavar=FORM,
        help="What a sensor does not say itself; GLOB is that of ROBOT/SENSOR (repeatable).",
        rich_help_panel=PANELS["map"],
    ),
]
RobotFlags = Annotated[
    list[str] | None,
    typer.Option(
        "--robot",
        metavar=FORM,
        help="What a robot of ROS 2 does not say: origin, name; GLOB is that of its name (repeatable).",
    ),
]


RadiusFlags = Annotated[
    list[str] | None,
    typer.Option(
        "--robot",
        metavar=FORM,
        help="What a robot does not say: radius, within which others see it; GLOB is that of its name "
        "(repeatable).",
        rich_help_panel=PANELS["map"],
    ),
]


def check_radii(texts: list[str] | None) -> None:
    """Refuse what --robot says that is not the mapper's to know.

    Raises:
        BadSetting: there is such a key.
    """
    check_for_whom("robots", texts or (), "--robot", {"radius"}, "ogm ros2: ogm ros2 --robot {!r}")


def check_replayed(texts: list[str]) -> None:
    """Refuse what --robot says of a log's robots that is the mapper's to know.

    Raises:
        BadSetting: there is such a key.
    """
    mapper = "the mapper: ogm mapper --robot {!r}; here origin and name can be given, of a bag's robots"
    check_for_whom("robots", texts, "--robot", {"origin", "name"}, mapper)


def settings_from(
    config: Path | None,
    *groups: _SettingFlags,
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


def with_flag_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Replace every parameter of `command` whose type is a group by the group's flags.

    Typer sees the flags; the command gets one object per group.
    """
    groups: dict[str, Any] = {}
    flags: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        if is_dataclass(parameter.annotation):
            groups[name] = parameter.annotation
            flags += _flags_of(parameter.annotation)
        else:
            flags.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))

    @wraps(command)
    def run(**values: Any) -> None:  # noqa: ANN401 (whatever typer has read)
        objects = {
            name: group(**{field.name: values.pop(field.name) for field in fields(group)})
            for name, group in groups.items()
        }
        command(**values, **objects)

    run.__dict__["__signature__"] = inspect.Signature(flags)
    run.__annotations__ = {flag.name: flag.annotation for flag in flags}
    return run


def _flags_of(group: Any) -> list[inspect.Parameter]:  # noqa: ANN401 (any dataclass)
    hints = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=hints[field.name]
        )
        for field in fields(group)
    ]
