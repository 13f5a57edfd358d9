"""Entries of settings that are lists of mappings: each says what holds for all that its `match` matches."""

from collections.abc import Collection, Iterable, Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from ogm_core.errors import BadSetting
from ogm_services.settings.values import did_you_mean

FORM = "GLOB:KEY=VALUE,..."

_Entry = TypeVar("_Entry", bound=BaseModel)


def read_entry(kind: type[_Entry], section: str, entry: object, source: str) -> _Entry:
    """One entry, as YAML gives it or `parse_entry`; `source` is how the user knows where it stands.

    Raises:
        BadSetting: a key is unknown, or a value not allowed.
    """
    if not isinstance(entry, Mapping):
        raise BadSetting(f"{section}: mappings with the key match are needed, got {entry!r:.60} ({source})")
    for key in map(str, entry):
        if key not in kind.model_fields:
            meant = did_you_mean(key, kind.model_fields)
            raise BadSetting(f"{section}.{key}: unknown setting{meant} ({source})")
    try:
        return kind.model_validate(dict(entry))
    except ValidationError as error:
        problem = error.errors()[0]
        said = problem["msg"].removeprefix("Value error, ")
        if not problem["loc"]:  # of several keys, which the text names
            raise BadSetting(f"{section}.{said} ({source})") from None
        key = str(problem["loc"][0])
        given = f", got {entry[key]!r}" if key in entry else ""
        raise BadSetting(f"{section}.{key}: {said[0].lower()}{said[1:]}{given} ({source})") from None


def parse_entry(section: str, text: str, source: str) -> Mapping[str, Any]:
    """One entry from the text GLOB:KEY=VALUE,...; values may hold commas.

    Raises:
        BadSetting: it is of another form.
    """
    glob, colon, rest = text.partition(":")
    entry: dict[str, Any] = {"match": glob.strip()}
    key = ""
    for part in rest.split(","):
        name, equals, value = part.partition("=")
        if equals:
            key = name.strip()
            if key in entry:
                raise BadSetting(f"{section}.{key}: given twice in {text!r} ({source})")
            entry[key] = value.strip()
        elif key:
            entry[key] += f",{part.strip()}"
        else:
            colon = ""
    if not (colon and entry["match"] and len(entry) > 1):
        raise BadSetting(f"{section}: {FORM} is needed, got {text!r} ({source})")
    return entry


def check_for_whom(section: str, texts: Iterable[str], flag: str, ours: Collection[str], others: str) -> None:
    """Refuse what a flag says that another command is to be told; `others` says in words which, and how.

    Raises:
        BadSetting: there is a key that is not `ours`.
    """
    for text in texts:
        for key in sorted(parse_entry(section, text, flag).keys() - {"match", *ours}):
            raise BadSetting(f"{section}.{key}: that is for {others.format(text)} ({flag})")
