"""Rays as users see them: how far a beam from a point in a map reaches, and what it has found there."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import BadParameter
from ogm_core.queries.rays import FOUND_NOTHING, FOUND_UNKNOWN, FOUND_WALL

Found = Literal["occupied", "unknown", "nothing"]
WORDS: dict[int, Found] = {FOUND_WALL: "occupied", FOUND_UNKNOWN: "unknown", FOUND_NOTHING: "nothing"}
Unknown = Literal["stop", "pass"]
"""What becomes of a ray that comes to an unknown or undecided cell."""


@dataclass(frozen=True, slots=True)
class Ray:
    """Where a ray through a map ends: at `range` m, and what it has `found` there.

    - "occupied": the first cell on its way that stops it is occupied, and is entered at `range`;
    - "unknown": that cell is unknown or undecided, or it lies outside the grid;
    - "nothing": no cell within the `max_range` of the cast stops it; `range` is `max_range`.
    """

    range: float
    found: Found


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """The same of many rays, arrays of one shape: `range` in m, float64, and `found`, the words of `Ray`."""

    range: NDArray[np.float64]
    found: NDArray[np.str_]

    @classmethod
    def of(cls, rays: Iterable[Ray], shape: tuple[int, ...]) -> "Rays":
        """Rays as arrays of a shape."""
        each = list(rays)
        return cls(
            np.array([ray.range for ray in each], np.float64).reshape(shape),
            np.array([ray.found for ray in each], np.str_).reshape(shape),
        )


def goes_through(unknown: Unknown) -> bool:
    """Whether rays go through what is unknown.

    Raises:
        BadParameter: it is none of the words.
    """
    if unknown not in ("stop", "pass"):
        raise BadParameter(f"unknown: 'stop' or 'pass' is needed, got {unknown!r}")
    return unknown == "pass"
