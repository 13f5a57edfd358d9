"""Parameters of requests: checked, and as the texts that a mapper reads."""

import math
import numbers
from collections.abc import Mapping
from typing import Any, Literal, get_args

from numpy.typing import ArrayLike

from ogm_core.errors import BadParameter

Value = str | ArrayLike | None
"""A request's parameter: a text, a number, numbers that belong together (a region), None for "not given"."""

Resolution = Literal["fine", "coarse"]
"""Cells of a map that counts: halves of those that it counts in, or these themselves."""


def is_coarse(resolution: Resolution) -> bool:
    """Whether the wider cells are meant.

    Raises:
        BadParameter: it is something else.
    """
    if resolution not in get_args(Resolution):
        raise BadParameter(
            f"resolution: one of {', '.join(get_args(Resolution))} is needed, got {resolution!r}"
        )
    return resolution == "coarse"


def texts(parameters: Mapping[str, Value]) -> dict[str, str]:
    """The parameters that are given, as text; floats in the shortest form that reads back the same."""
    return {name: _text(name, value) for name, value in parameters.items() if value is not None}


def _text(name: str, value: Any) -> str:  # noqa: ANN401 - a Value, or a mistake
    if isinstance(value, str):
        if ";" in value:
            raise BadParameter(f"{name}: {value!r} contains a ';', which separates parameters")
        return value
    parts: Any = [value] if isinstance(value, numbers.Real) else value
    try:
        return ",".join(_number(part) for part in parts)
    except (TypeError, ValueError) as error:
        raise BadParameter(f"{name}: a text, a number or several are needed, got {value!r}") from error


def _number(value: float) -> str:
    return str(value) if type(value) is int else repr(float(value))


def check_watch(interval: float, patience: float) -> None:
    """Refuse what `watch` cannot look by.

    Raises:
        BadParameter: the interval is not a positive number, or the patience is negative or none.
    """
    check_interval(interval)
    if not patience >= 0.0:
        raise BadParameter(f"patience: a number of seconds, 0 or more, is needed, got {patience}")


def check_interval(interval: float) -> None:
    """Refuse what is no time between two looks, s.

    Raises:
        BadParameter: it is not a positive number.
    """
    if not 0.0 < interval < math.inf:
        raise BadParameter(f"interval: a positive number of seconds is needed, got {interval}")
