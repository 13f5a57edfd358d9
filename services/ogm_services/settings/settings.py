"""Settings of every service: what may be set, within which limits, and which source wins.

Defaults < preset < file (YAML) < environment `OGM_<SECTION>__<KEY>` < flags. A preset replaces the defaults,
whichever source names it; every other setting that a source gives overrides it.
"""

import difflib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Self

import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    FilePath,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import ErrorDetails

from ogm_core.cells.log_odds import CellType, LogOdds
from ogm_core.errors import BadSetting
from ogm_core.files.strict_yaml import YAML_ERRORS
from ogm_core.grid_settings import (
    DEFAULT_MAX_BYTES,
    DEFAULT_MAX_CELLS,
    GridSettings,
    Outside,
    SensorModel,
    Traversal,
)
from ogm_core.lattice import MAX_RESOLUTION, MIN_RESOLUTION
from ogm_core.wire.keys import check_name
from ogm_services.settings.values import (
    LOOPBACK,
    NONE,
    PRESETS,
    Bounds,
    Count,
    Endpoints,
    Finite,
    NotNegative,
    Positive,
    Preset,
    Probability,
    WholeNumber,
)

if TYPE_CHECKING:
    from ogm_client.session import NetworkConfig


class _Section(BaseModel):
    """A group of settings: frozen, closed to unknown keys; text is read as what each key needs."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @field_validator("*", mode="before")
    @classmethod
    def _no_setting_is_a_switch(cls, value: object) -> object:
        if isinstance(value, bool):
            raise ValueError("this is not a switch")  # noqa: TRY004 (pydantic collects ValueErrors only)
        return value


class MapSettings(_Section):
    """The map and its sensor model; lengths in metres. Text "none" means none where none is allowed."""

    preset: Annotated[Preset | None, NONE] = None
    resolution: Annotated[Finite, Field(ge=MIN_RESOLUTION, le=MAX_RESOLUTION)] = 0.05
    p_prior: Probability = 0.5
    p_occ: Probability = 0.7
    p_free: Probability = 0.3
    l_min: Finite = -8.0
    l_max: Finite = 8.0
    alpha: NotNegative = 0.1
    model: SensorModel = "beam"
    traversal: Traversal = "bresenham"
    reach: Annotated[Positive | None, NONE] = None
    clear_range: Annotated[NotNegative | None, NONE] = None
    cells: CellType = "int16"
    bounds: Annotated[Bounds | None, NONE] = None
    outside: Outside = "clip"

    def log_odds(self) -> LogOdds:
        """The cell model.

        Raises:
            BadSetting: probabilities and clamps contradict each other.
        """
        return LogOdds(self.cells, self.p_prior, self.p_occ, self.p_free, self.l_min, self.l_max)


class NetworkSettings(_Section):
    """The map's name, and the way to the other services.

    A relative `zenoh_config` starts at the working folder.
    """

    map_name: Annotated[str, AfterValidator(lambda name: check_name(name, "network.map_name"))] = "default"
    listen: Endpoints = ()
    connect: Endpoints = ()
    zenoh_config: Annotated[FilePath | None, NONE] = None

    def for_mapper(self) -> "NetworkConfig":
        """How a mapper opens its session: as told, else it listens on loopback."""
        return self._config(listen=(LOOPBACK,), connect=())

    def for_client(self) -> "NetworkConfig":
        """How everyone else opens a session: as told, else connected to the mapper on loopback."""
        return self._config(listen=(), connect=(LOOPBACK,))

    def _config(self, *, listen: tuple[str, ...], connect: tuple[str, ...]) -> "NetworkConfig":
        from ogm_client.session import NetworkConfig

        if self.listen or self.connect or self.zenoh_config:
            listen, connect = self.listen, self.connect
        return NetworkConfig(listen=listen, connect=connect, config_file=self.zenoh_config)


class HttpSettings(_Section):
    """Where the mapper serves HTTP; port 0 picks a free one."""

    host: str = "127.0.0.1"
    port: Annotated[WholeNumber, Field(ge=0, le=65535)] = 8000


class MapperSettings(_Section):
    """The mapper's limits, and what its map starts with.

    `max_cells` of the known rectangle, `max_bytes` of the map's own memory, `max_beams` of one scan,
    `pose_wait` in seconds without a message from a robot, `queue` in messages. `start_map` is the YAML file
    of a ROS map, a relative path starts at the working folder; `start_confidence` the probability that its
    occupied cells are occupied, and its free ones free.
    """

    max_cells: Count = DEFAULT_MAX_CELLS
    max_bytes: Count = DEFAULT_MAX_BYTES
    max_beams: Count = 200_000
    pose_wait: NotNegative = 2.0
    queue: Count = 4096
    start_map: Annotated[FilePath | None, NONE] = None
    start_confidence: Annotated[Finite, Field(gt=0.5, lt=1.0)] = 0.9


class Settings(BaseModel):
    """All settings of a service, checked against each other.

    Raises:
        BadSetting: map settings contradict each other.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    map: MapSettings = MapSettings()
    network: NetworkSettings = NetworkSettings()
    http: HttpSettings = HttpSettings()
    mapper: MapperSettings = MapperSettings()

    @model_validator(mode="after")
    def _agree(self) -> Self:
        self.grid_settings()
        if self.map.bounds is not None and self.mapper.start_map is not None:
            raise BadSetting(
                "map.bounds: a map that starts with mapper.start_map has no bounds; leave out one of the two"
            )
        return self

    def grid_settings(self) -> GridSettings:
        """What the map is made of."""
        return GridSettings(
            resolution=self.map.resolution,
            model=self.map.log_odds(),
            sensor=self.map.model,
            traversal=self.map.traversal,
            alpha=self.map.alpha,
            reach=self.map.reach,
            clear_range=self.map.clear_range,
            bounds=self.map.bounds,
            outside=self.map.outside,
            max_cells=self.mapper.max_cells,
            max_bytes=self.mapper.max_bytes,
        )

    def to_yaml(self) -> str:
        """Every setting that was given, as a file from which `load_settings` makes equal settings."""
        return yaml.safe_dump(self.model_dump(mode="json", exclude_unset=True), sort_keys=False)


class _Given(NamedTuple):
    """A value as some source gives it, and how the user knows that source."""

    value: Any
    source: str


_Source = dict[tuple[str, str], _Given]
"""What a source gives, by section and key."""


def load_settings(
    *, config: Path | None, flags: Mapping[str, Mapping[str, Any]], environ: Mapping[str, str]
) -> Settings:
    """Settings from all sources: `config` is a YAML file, `flags` the values given as flags, by section.

    Raises:
        BadSetting: the file cannot be read, a name is unknown, a value is not allowed or contradicts another.
    """
    given = (_from_file(config) if config else {}) | _from_environment(environ) | _from_flags(flags)
    named = given.get(("map", "preset"))
    if named is not None:
        preset = PRESETS.get(str(named.value), {})
        given = {("map", key): _Given(value, named.source) for key, value in preset.items()} | given
    values: dict[str, dict[str, Any]] = {}
    for (section, key), item in given.items():
        values.setdefault(section, {})[key] = item.value
    try:
        return Settings.model_validate(values)
    except ValidationError as error:
        raise BadSetting("; ".join(_in_words(problem, given) for problem in error.errors())) from None


def flag_name(section: str, key: str) -> str:
    """The flag of the command line that gives a setting."""
    if (section, key) == ("network", "map_name"):
        return "--map"
    prefix = "http-" if section == "http" else ""
    return f"--{prefix}{key.replace('_', '-')}"


def without_settings(environ: Mapping[str, str]) -> dict[str, str]:
    """`environ` without settings, for a child process that gets all of them from a file."""
    return {name: value for name, value in environ.items() if not _is_setting(name)}


def _from_file(path: Path) -> _Source:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadSetting(f"{path}: cannot be read: {error.strerror}") from None
    except YAML_ERRORS as error:
        raise BadSetting(f"{path}: not YAML: {' '.join(str(error).split())}") from None
    given: _Source = {}
    for section, values in _mapping(content, f"{path}").items():
        _check_known(f"{path}: ", str(section), Settings.model_fields)
        for key, value in _mapping(values, f"{path}: {section}").items():
            _check_known(f"{path}: ", f"{section}.{key}", _names("{}.{}"))
            given[section, key] = _Given(value, f"file {path}")
    return given


def _mapping(content: object, where: str) -> Mapping[Any, Any]:
    if content is None:  # an empty file or section
        return {}
    if not isinstance(content, Mapping):
        raise BadSetting(f"{where}: a mapping of names to values is needed, got {content!r:.40}")
    return content


def _from_environment(environ: Mapping[str, str]) -> _Source:
    known = {name.upper(): setting for name, setting in _names("OGM_{}__{}").items()}
    given: _Source = {}
    for name in filter(_is_setting, environ):
        _check_known("environment ", name, known)
        given[known[name]] = _Given(environ[name], f"environment {name}")
    return given


def _is_setting(variable: str) -> bool:
    return variable.startswith("OGM_") and "__" in variable


def _from_flags(flags: Mapping[str, Mapping[str, Any]]) -> _Source:
    given: _Source = {}
    for section, values in flags.items():
        for key, value in values.items():
            _check_known("flag ", f"{section}.{key}", _names("{}.{}"))
            given[section, key] = _Given(value, flag_name(section, key))
    return given


def _names(form: str) -> dict[str, tuple[str, str]]:
    """Every setting's (section, key), by its name in the given form."""
    sections = Settings().model_dump()
    return {form.format(section, key): (section, key) for section in sections for key in sections[section]}


def _check_known(source: str, name: str, known: Iterable[str]) -> None:
    names = list(known)
    if name not in names:
        close = difflib.get_close_matches(name, names, n=1)
        raise BadSetting(f"{source}{name}: unknown setting{f' (did you mean {close[0]}?)' if close else ''}")


def _in_words(problem: ErrorDetails, given: _Source) -> str:
    section, key = str(problem["loc"][0]), str(problem["loc"][1])
    value, source = given[section, key]
    message = problem["msg"].removeprefix("Value error, ")
    return f"{section}.{key}: {message[0].lower()}{message[1:]}, got {value!r} ({source})"
