"""Sources of the settings: defaults < preset < file (YAML) < environment `OGM_<SECTION>__<KEY>` < flags.

A preset replaces the defaults, whichever source names it; every other setting that a source gives overrides
it.
"""

import difflib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from ogm_core.errors import BadSetting
from ogm_core.files.strict_yaml import parse_yaml
from ogm_services.settings.settings import SECTIONS, Settings
from ogm_services.settings.values import PRESETS

RENAMED = {("map", "model"): ("map", "sensor_model")}
"""Former names of settings: they hold for one release, and say so."""


class _Given(NamedTuple):
    """A value as some source gives it, and how the user knows that source."""

    value: Any
    source: str


_Source = dict[tuple[str, str], _Given]
"""What a source gives, by section and key."""


def load_settings(
    *,
    config: Path | None,
    flags: Mapping[str, Mapping[str, Any]],
    environ: Mapping[str, str],
    tell: Callable[[str], None] = lambda _: None,
) -> Settings:
    """Settings from all sources: `config` is a YAML file, `flags` the values given as flags, by section.

    `tell` is told what is no error, but should be changed.

    Raises:
        BadSetting: the file cannot be read, a name is unknown, a value is not allowed or contradicts another.
    """
    sources = _from_file(config) if config else {}, _from_environment(environ), _from_flags(flags)
    given: _Source = {}
    for source in sources:
        given |= _by_present_names(source, tell)
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


def _by_present_names(source: _Source, tell: Callable[[str], None]) -> _Source:
    given = dict(source)
    for old, new in RENAMED.items():
        if old in given:
            value = given.pop(old)
            if new in given:
                raise BadSetting(f"{'.'.join(old)} is {'.'.join(new)} now: give one of them ({value.source})")
            tell(f"ogm: {value.source}: {'.'.join(old)} is called {'.'.join(new)} now ({flag_name(*new)})")
            given[new] = value
    return given


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
        content = parse_yaml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadSetting(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise BadSetting(f"{path}: not YAML: it is not UTF-8 text ({error})") from None
    except ValueError as error:
        raise BadSetting(f"{path}: {error}") from None
    given: _Source = {}
    for section, values in _mapping(content, f"{path}").items():
        _check_known(f"{path}: ", str(section), SECTIONS)
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
    names = [(section, key) for section, kind in SECTIONS.items() for key in kind.model_fields]
    return {form.format(*name): name for name in [*names, *RENAMED]}


def _check_known(source: str, name: str, known: Mapping[str, object]) -> None:
    if name not in known:
        current = [other for other, setting in known.items() if setting not in RENAMED]
        close = difflib.get_close_matches(name, current, n=1)
        raise BadSetting(f"{source}{name}: unknown setting{f' (did you mean {close[0]}?)' if close else ''}")


def _in_words(problem: ErrorDetails, given: _Source) -> str:
    section, key = str(problem["loc"][0]), str(problem["loc"][1])
    value, source = given[section, key]
    message = problem["msg"].removeprefix("Value error, ")
    return f"{section}.{key}: {message[0].lower()}{message[1:]}, got {value!r} ({source})"
