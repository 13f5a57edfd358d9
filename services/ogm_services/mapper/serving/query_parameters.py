"""Parameters of queries: what each may be stands once, and is read, refused and described by that."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ogm_core.errors import BadParameter, cut
from ogm_services.mapper.serving.map_formats import number
from ogm_services.replies.answer import Parameters


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
        if self.whole and not value.is_integer():
            raise BadParameter(f"{self.name}: a whole number is needed, got {cut(given[self.name])}")
        return value

    def schema(self) -> dict[str, Any]:
        """What it may be, as JSON schema."""
        described: dict[str, Any] = {"type": "integer" if self.whole else "number"}
        if math.isfinite(self.least):
            described["exclusiveMinimum" if self.above else "minimum"] = self.least
        if math.isfinite(self.most):
            described["maximum"] = self.most
        return described if self.default is None else described | {"default": self.default}

    @property
    def _range(self) -> str:
        if math.isinf(self.least) and math.isinf(self.most):
            return "a finite number"
        above = "more than " if self.above else ""
        return (
            f"{above}{self.least:g} and at most {self.most:g}"
            if above
            else f"{self.least:g} to {self.most:g}"
        )


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

    def schema(self) -> dict[str, Any]:
        """What it may be, as JSON schema."""
        return {"type": "string", "enum": list(self.words), "default": self.words[0]}


Parameter = NumberParameter | ChoiceParameter


def described(parameters: Sequence[Parameter]) -> list[dict[str, Any]]:
    """Parameters of a route's query, as OpenAPI describes them."""
    return [
        {
            "name": parameter.name,
            "in": "query",
            "required": parameter.needed,
            "description": parameter.said,
            "schema": parameter.schema(),
        }
        for parameter in parameters
    ]
