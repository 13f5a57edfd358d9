"""Settings as people read them: every one with its origin, and those that differ from the defaults."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, SecretStr

from ogm_core.errors import printable
from ogm_core.files.strict_yaml import dump_yaml
from ogm_core.wire.addresses import MASKED, masked
from ogm_services.settings.settings import LISTS, SECTIONS, Settings

if TYPE_CHECKING:
    from ogm_services.settings.sources import Origins

_NO_BREAK = 2**30
"""Width of a line that is never reached."""


def described(settings: Settings, origins: "Origins") -> str:
    """Every setting as YAML, each with its origin as a comment; secrets are masked.

    Defaults are comments as a whole, since what is given may contradict what a default does not.
    `load_settings` makes equal settings of it, masked ones apart.
    """
    lines = []
    for section, kind in SECTIONS.items():
        lines.append(f"{section}:")
        for key in kind.model_fields:
            line = _line(key, _plain(getattr(getattr(settings, section), key)))
            origin = origins.settings.get((section, key))
            # Names of files may hold anything.
            lines.append(f"  # {line}  # default" if origin is None else f"  {line}  # {printable(origin)}")
    for name in LISTS:
        entries: tuple[BaseModel, ...] = getattr(settings, name)
        lines.append(f"{name}:" if entries else f"# {name}: []  # default")
        for each, origin in zip(entries, origins.lists[name], strict=True):
            entry = each.model_dump(mode="json", exclude_none=True)
            first, *rest = [_line(key, value) for key, value in entry.items()]
            lines += [f"- {first}  # {printable(origin)}", *(f"  {line}" for line in rest)]
    return "\n".join(lines) + "\n"


def differences(settings: Settings) -> list[str]:
    """The settings that differ from the defaults, as `section.key=value`; secrets are masked."""
    found = []
    for section, kind in SECTIONS.items():
        ours, usual = getattr(settings, section), kind()
        found += [
            f"{section}.{key}={_short(_plain(getattr(ours, key)))}"
            for key in kind.model_fields
            if getattr(ours, key) != getattr(usual, key)
        ]
    for name in LISTS:
        if entries := getattr(settings, name):
            found.append(f"{name}=" + "; ".join(entry.match for entry in entries))
    return found


def _plain(value: object) -> Any:  # noqa: ANN401 (whatever YAML has)
    """A setting's value as YAML and JSON know it."""
    if isinstance(value, SecretStr):
        return MASKED
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, tuple):
        return [masked(part) if isinstance(part, str) else _plain(part) for part in value]
    if value is None or isinstance(value, bool | int | float):
        return value
    return str(value)


def _line(key: str, value: object) -> str:
    """A key and its value on one line of YAML."""
    line = dump_yaml({key: value}, width=_NO_BREAK).rstrip("\n")
    return line[1:-1] if line.startswith("{") else line


def _short(value: object) -> str:
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ",".join(map(str, value))
    return str(value)
