"""Sources of the settings: defaults < preset < file (YAML) < environment `OGM_<SECTION>__<KEY>` < flags.

A preset replaces the defaults, whichever source names it; every other setting that a source gives overrides
it.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from ogm_core.errors import BadSetting
from ogm_core.files.strict_yaml import parse_yaml
from ogm_services.settings.entries import parse_entry, read_entry
from ogm_services.settings.settings import LISTS, SECTIONS, Settings
from ogm_services.settings.values import OF_LOG_ODDS, PRESETS, did_you_mean

RENAMED = {("map", "model"): ("map", "sensor_model")}
"""Former names of settings: they hold for one release, and say so."""

SECRET = frozenset({("http", "token")})
"""Their values are shown nowhere."""


_FLAGS = {
    ("network", "map_name"): "--map",
    ("http", "root_path"): "--root-path",
    ("shares", "index"): "--share",
}
"""The flags that are not their keys' names; --root-path is called so by the servers that have one."""


class _Given(NamedTuple):
    """A value as some source gives it, and how the user knows that source."""

    value: Any
    source: str


_Source = dict[tuple[str, str], _Given]
"""What a source gives, by section and key."""


@dataclass(frozen=True)
class Origins:
    """Where settings come from, as the user knows it: by section and key; of lists in their order.

    What is not there is a default.
    """

    settings: Mapping[tuple[str, str], str]
    lists: Mapping[str, Sequence[str]]


def load_settings(
    *,
    config: Path | None,
    flags: Mapping[str, Mapping[str, Any]],
    environ: Mapping[str, str],
    sensors: Iterable[str] = (),
    robots: Iterable[str] = (),
    tell: Callable[[str], None] = lambda _: None,
) -> Settings:
    """Settings from all sources, as `settings_and_origins` finds them."""
    return settings_and_origins(
        config=config, flags=flags, environ=environ, sensors=sensors, robots=robots, tell=tell
    )[0]


def settings_and_origins(
    *,
    config: Path | None,
    flags: Mapping[str, Mapping[str, Any]],
    environ: Mapping[str, str],
    sensors: Iterable[str] = (),
    robots: Iterable[str] = (),
    tell: Callable[[str], None] = lambda _: None,
) -> tuple[Settings, Origins]:
    """Settings from all sources: `config` is a YAML file, `flags` the values given as flags, by section.

    `sensors` and `robots` are the texts of `--sensor` and `--robot`. Of lists, the entries of a later source
    are looked at first.

    `tell` is told what is no error, but should be changed.

    Raises:
        BadSetting: the file cannot be read, a name is unknown, a value is not allowed or contradicts another.
    """
    content = _file_content(config) if config else {}
    sources = _from_file(content, config), _from_environment(environ), _from_flags(flags)
    given: _Source = {}
    for source in sources:
        given |= _by_present_names(source, tell)
    named = given.get(("map", "preset"))
    if named is not None:
        preset = PRESETS.get(str(named.value), {})
        model = given.get(("map", "cell_model"))
        if model is not None and model.value != preset.get("cell_model"):
            preset = {key: value for key, value in preset.items() if key not in OF_LOG_ODDS}
        origin = f"preset {named.value}, {named.source}"
        given = {("map", key): _Given(value, origin) for key, value in preset.items()} | given
    values: dict[str, Any] = {}
    for (section, key), item in given.items():
        values.setdefault(section, {})[key] = item.value
    lists: dict[str, list[str]] = {}
    for section, texts in (("sensors", sensors), ("robots", robots)):
        entries = [*_entries_as_text(section, texts, environ), *_entries_of_file(section, content, config)]
        lists[section] = [source for _, source in entries]
        if entries:
            values[section] = [entry for entry, _ in entries]
    origins = Origins({name: item.source for name, item in given.items()}, lists)
    try:
        return Settings.model_validate(values), origins
    except ValidationError as error:
        raise BadSetting("; ".join(_in_words(problem, given) for problem in error.errors())) from None


def _by_present_names(source: _Source, tell: Callable[[str], None]) -> _Source:
    given = dict(source)
    for old, new in RENAMED.items():
        if old in given:
            value = given.pop(old)
            if new in given:
                raise BadSetting(f"{'.'.join(old)} is {'.'.join(new)} now: give one of them ({value.source})")
            tell(f"{value.source}: {'.'.join(old)} is called {'.'.join(new)} now ({flag_name(*new)})")
            given[new] = value
    return given


def flag_name(section: str, key: str) -> str:
    """The flag of the command line that gives a setting."""
    if (section, key) in _FLAGS:
        return _FLAGS[section, key]
    prefix = f"{section}-" if section in ("http", "log") else ""
    return f"--{prefix}{key.replace('_', '-')}"


def without_settings(environ: Mapping[str, str]) -> dict[str, str]:
    """`environ` without settings, for a child process that gets all of them from a file."""
    return {name: value for name, value in environ.items() if not _is_setting(name)}


def _file_content(path: Path) -> Mapping[Any, Any]:
    try:
        return _mapping(parse_yaml(path.read_text(encoding="utf-8")), f"{path}")
    except OSError as error:
        raise BadSetting(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise BadSetting(f"{path}: not YAML: it is not UTF-8 text ({error})") from None
    except ValueError as error:
        raise BadSetting(f"{path}: {error}") from None


def _from_file(content: Mapping[Any, Any], path: Path | None) -> _Source:
    given: _Source = {}
    for section, values in content.items():
        if section in LISTS:
            continue
        _check_known(f"{path}: ", str(section), {**SECTIONS, **LISTS})
        for key, value in _mapping(values, f"{path}: {section}").items():
            _check_known(f"{path}: ", f"{section}.{key}", _names("{}.{}"))
            given[section, key] = _Given(value, f"file {path}")
    return given


def _entries_of_file(
    section: str, content: Mapping[Any, Any], path: Path | None
) -> list[tuple[BaseModel, str]]:
    entries = content.get(section) or []
    if not isinstance(entries, list):
        raise BadSetting(f"{path}: {section}: a list of mappings is needed, got {entries!r:.40}")
    return [(read_entry(LISTS[section], section, entry, f"file {path}"), f"file {path}") for entry in entries]


def _entries_as_text(
    section: str, flags: Iterable[str], environ: Mapping[str, str]
) -> list[tuple[BaseModel, str]]:
    texts = [(text, f"--{section.removesuffix('s')}") for text in flags]
    variable = _variable(section)
    in_variable = filter(str.strip, environ.get(variable, "").split(";"))
    texts += [(text, f"environment {variable}") for text in in_variable]
    return [
        (read_entry(LISTS[section], section, parse_entry(section, text, source), source), source)
        for text, source in texts
    ]


def _variable(section: str) -> str:
    """The variable of the environment that holds the entries of a list."""
    return f"OGM_{section.upper()}"


def _mapping(content: object, where: str) -> Mapping[Any, Any]:
    if content is None:  # an empty file or section
        return {}
    if not isinstance(content, Mapping):
        raise BadSetting(f"{where}: a mapping of names to values is needed, got {content!r:.40}")
    return content


def _from_environment(environ: Mapping[str, str]) -> _Source:
    known = {name.upper(): setting for name, setting in _names("OGM_{}__{}").items()}
    given: _Source = {}
    single = {name.replace("__", "_"): name for name in known}
    for name in filter(single.__contains__, environ):
        raise BadSetting(f"environment {name}: unknown setting (did you mean {single[name]}?)")
    for name in filter(_is_setting, environ):
        if "__" not in name:
            continue  # of a list
        _check_known("environment ", name, known)
        given[known[name]] = _Given(environ[name], f"environment {name}")
    return given


def _is_setting(variable: str) -> bool:
    return variable.startswith("OGM_") and ("__" in variable or variable in map(_variable, LISTS))


def _from_flags(flags: Mapping[str, Mapping[str, Any]]) -> _Source:
    given: _Source = {}
    for section, values in flags.items():
        for key, value in values.items():
            _check_known("flag ", f"{section}.{key}", _names("{}.{}"))
            given[section, key] = _Given(value, flag_name(section, key))
    return given


def _names(form: str) -> dict[str, tuple[str, str]]:
    """Every setting's (section, key), by its name in the given form."""
    names = [(section, key) for section, kind in SECTIONS.items() for key in kind.model_fields]
    return {form.format(*name): name for name in [*names, *RENAMED]}


def _check_known(source: str, name: str, known: Mapping[str, object]) -> None:
    if name not in known:
        current = [other for other, setting in known.items() if setting not in RENAMED]
        raise BadSetting(f"{source}{name}: unknown setting{did_you_mean(name, current)}")


def _in_words(problem: ErrorDetails, given: _Source) -> str:
    section, key = str(problem["loc"][0]), str(problem["loc"][1])
    value, source = given[section, key]
    message = problem["msg"].removeprefix("Value error, ")
    told = (section, key) in SECRET or f", got {value!r}" in message
    got = "" if told else f", got {value!r}"
    return f"{section}.{key}: {message[0].lower()}{message[1:]}{got} ({source})"
