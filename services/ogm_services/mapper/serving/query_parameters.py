"""Parameters of questions: what each may be stands once, and is read, refused and described by that.

FastAPI's own parameters would be read over HTTP alone, and refused in other words, and with another status,
than over Zenoh.
"""

import math
import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any, Protocol

from ogm_core.errors import BadParameter, cut
from ogm_services.replies.answer import Parameters
from ogm_services.settings.values import DECIMAL, parse_number

Schema = dict[str, Any]
SAVED_AS = "at"
"""The parameter that names a saved map, in place of that of now."""


class Parameter(Protocol):
    """A parameter of a question, over HTTP and Zenoh alike."""

    @property
    def name(self) -> str:
        """How it is called."""

    @property
    def said(self) -> str:
        """What it means, with units."""

    @property
    def needed(self) -> bool:
        """Whether a question must give it."""

    def schema(self) -> Schema:
        """What it may be, as JSON schema, with an example."""


@dataclass(frozen=True, slots=True)
class NumberParameter:
    """A number from `least` to `most`, or `above` the least one. Without a default it is needed."""

    name: str
    said: str
    least: float = -math.inf
    most: float = math.inf
    default: float | None = None
    above: bool = False
    whole: bool = False
    optional: bool = False
    """Whether who asks looks himself if it is given: there is no default."""
    example: float | None = None

    @property
    def needed(self) -> bool:
        """Whether a request must give it."""
        return self.default is None and not self.optional

    def read(self, given: Parameters) -> float:
        """The number that is given, or the default.

        Raises:
            BadParameter: it is missing, no number, or out of its range.
        """
        if self.name not in given and self.default is not None:
            return self.default
        value = number(self.name, given.get(self.name))
        low = value > self.least if self.above else value >= self.least
        if not (low and value <= self.most and math.isfinite(value)):
            raise BadParameter(f"{self.name}: {self._range} is needed, got {cut(given[self.name])}")
        if self.whole and not given[self.name].lstrip("+-").isdigit():
            raise BadParameter(f"{self.name}: a whole number is needed, got {cut(given[self.name])}")
        return value

    def schema(self) -> Schema:
        """See `Parameter`."""
        described: Schema = {"type": "integer" if self.whole else "number"}
        if math.isfinite(self.least):
            described["exclusiveMinimum" if self.above else "minimum"] = self.least
        if math.isfinite(self.most):
            described["maximum"] = self.most
        example = self.default if self.example is None else self.example
        if example is not None:
            described["examples"] = [example]
        return described if self.default is None else described | {"default": self.default}

    @property
    def _range(self) -> str:
        if math.isinf(self.least) and math.isinf(self.most):
            return "a finite number"
        least, most = (f"{bound:.9g}" for bound in (self.least, self.most))
        return f"more than {least} and at most {most}" if self.above else f"{least} to {most}"


@dataclass(frozen=True, slots=True)
class ChoiceParameter:
    """One of some words, the first of which is the default."""

    name: str
    said: str
    words: tuple[str, ...]

    @property
    def needed(self) -> bool:
        """A request need not give it."""
        return False

    def read(self, given: Parameters) -> str:
        """The word that is given, or the default.

        Raises:
            BadParameter: it is none of them.
        """
        word = given.get(self.name, self.words[0])
        if word not in self.words:
            raise BadParameter(f"{self.name}: one of {', '.join(self.words)} is needed, got {cut(word)!r}")
        return word

    def schema(self) -> Schema:
        """See `Parameter`."""
        return {
            "type": "string",
            "enum": list(self.words),
            "examples": [self.words[0]],
            "default": self.words[0],
        }


@dataclass(frozen=True, slots=True)
class NumbersParameter:
    """Pairs of numbers in one text, with commas between: `least` to `most` pairs, as `form` shows them."""

    name: str
    said: str
    form: str
    least: int
    most: int
    example: str

    @property
    def needed(self) -> bool:
        """Who asks looks himself if it is given."""
        return False

    def read(self, given: Parameters) -> list[float] | None:
        """The numbers that are given, if they are.

        Raises:
            BadParameter: they are too few, too many, odd, or no numbers.
        """
        if self.name not in given:
            return None
        text = given[self.name]
        parts = text.split(",")
        if len(parts) % 2 or not self.least <= len(parts) // 2 <= self.most:
            got = repr(cut(text)) if self.least == self.most else f"{len(parts)} numbers"
            raise BadParameter(f"{self.name}: {self.form} is needed, got {got}")
        return [number(self.name, part) for part in parts]

    def schema(self) -> Schema:
        """See `Parameter`."""
        pair = f"{DECIMAL},{DECIMAL}"
        more = f"{{{self.least - 1},{self.most - 1}}}"
        return {"type": "string", "pattern": f"^{pair}(,{pair}){more}$", "examples": [self.example]}


@dataclass(frozen=True, slots=True)
class TextParameter:
    """A text, of a `pattern` if there is one, which `form` tells people of."""

    name: str
    said: str
    example: str
    pattern: str | None = None
    form: str = ""
    needed: bool = False

    def read(self, given: Parameters) -> str | None:
        """The text that is given, if it is.

        Raises:
            BadParameter: it is missing, and needed, or is not of the pattern.
        """
        text = given.get(self.name)
        if text is None and self.needed:
            raise BadParameter(f"{self.name}: missing: {self.said}")
        if text is not None and self.pattern is not None and re.fullmatch(self.pattern, text) is None:
            raise BadParameter(f"{self.name}: {self.form} is needed, got {cut(text)!r}")
        return text

    def schema(self) -> Schema:
        """See `Parameter`."""
        pattern = {} if self.pattern is None else {"pattern": f"^{self.pattern}$"}
        return {"type": "string", **pattern, "examples": [self.example]}


def described(parameters: Iterable[Parameter], place: str = "query") -> list[dict[str, Any]]:
    """Parameters of a route, as OpenAPI describes them; `place`: "query", "path" or "header"."""
    return [_described(parameter, parameter.schema(), place) for parameter in parameters]


def _described(parameter: Parameter, schema: Schema, place: str) -> dict[str, Any]:
    told: dict[str, Any] = {
        "name": parameter.name,
        "in": place,
        "required": parameter.needed,
        "description": parameter.said,
        "schema": schema,
    }
    (example,) = schema.get("examples", [None])
    if parameter.needed:
        told["example"] = example  # /docs begins with it
    elif "default" not in schema:
        told["description"] += f" (such as `{example}`)"  # which /docs does not show by itself
    return told


def check_names(given: Parameters, allowed: Collection[Parameter]) -> None:
    """Refuse parameters of other names.

    Raises:
        BadParameter: there is one; the text names it.
    """
    names = {parameter.name for parameter in allowed}
    for name in given:
        if name not in names:
            listed = ", ".join(sorted(names)) or "none"
            why = " here, where all is of the map of now" if name == SAVED_AS else ""
            raise BadParameter(f"{cut(name)}: unknown parameter{why}; there are: {listed}")


def number(name: str, text: str | None) -> float:
    """The number that a parameter gives.

    Raises:
        BadParameter: it is missing, or none.
    """
    if text is None:
        raise BadParameter(f"{name}: missing")
    try:
        return parse_number(text)
    except ValueError as error:
        raise BadParameter(f"{name}: {error}") from None
