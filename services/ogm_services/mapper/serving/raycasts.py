"""Ray casting for who asks a mapper: what a scan from a pose would read in the map as it is now."""

from dataclasses import dataclass

import numpy as np

from ogm_core.cells.classes import trinary
from ogm_core.errors import BadParameter
from ogm_core.lattice import Region
from ogm_core.queries.ray_kernel import cast_rays
from ogm_core.queries.rays import (
    FOUND_NOTHING,
    FOUND_UNKNOWN,
    FOUND_WALL,
    directions_of,
    start_of,
    window_of,
)
from ogm_core.queries.replies import RayEnd
from ogm_core.snapshot import MapSnapshot
from ogm_core.wire.messages import MAX_RANGE
from ogm_services.mapper.serving.query_parameters import ChoiceParameter, NumberParameter, check_names
from ogm_services.replies.answer import Parameters

MAX_RAYS = 10_000
"""So many rays may be asked for at once."""
MAX_CROSSED = 200_000_000
"""So many cells they may cross together at most: a second's work, about."""
_MOST_TURNS = 1e6
WORDS: dict[int, RayEnd] = {FOUND_WALL: "hit", FOUND_UNKNOWN: "unknown", FOUND_NOTHING: "none"}
"""What `ends` says of a ray."""

X = NumberParameter("x", "where the rays begin, metres, map frame: a point of the map", example=0.0)
Y = NumberParameter("y", "where the rays begin, metres, map frame", example=0.0)
THETA = NumberParameter(
    "theta", "heading that bearings count from, radians", -_MOST_TURNS, _MOST_TURNS, default=0.0
)
ANGLE_MIN = NumberParameter(
    "angle_min", "bearing of the first ray, radians", -_MOST_TURNS, _MOST_TURNS, default=0.0
)
ANGLE_INCREMENT = NumberParameter(
    "angle_increment", "from each ray to the next, radians", -_MOST_TURNS, _MOST_TURNS, default=0.0
)
N = NumberParameter("n", "how many rays", 1, MAX_RAYS, default=1, whole=True)
RANGE_MAX = NumberParameter(
    "range_max", "how long rays are at most, metres", 0.0, MAX_RANGE, default=MAX_RANGE, above=True
)
UNKNOWN = ChoiceParameter(
    "unknown",
    "whether a ray stops at an unknown or undecided cell, or at the map's edge, or passes through",
    ("stop", "pass"),
)
RAYCAST = (X, Y, THETA, ANGLE_MIN, ANGLE_INCREMENT, N, RANGE_MAX, UNKNOWN)
"""Its parameters."""


@dataclass(frozen=True, slots=True)
class Fan:
    """Rays that are asked for: they begin at `point`, m, and each has a bearing of its own, rad."""

    point: tuple[float, float]
    bearings: list[float]
    range_max: float
    through_unknown: bool

    @classmethod
    def read(cls, given: Parameters) -> "Fan":
        """What a request asks for.

        Raises:
            BadParameter: a parameter is unknown, missing, ill-formed or out of range.
        """
        check_names(given, RAYCAST)
        first, step = ANGLE_MIN.read(given), ANGLE_INCREMENT.read(given)
        theta, n = THETA.read(given), int(N.read(given))
        return cls(
            (X.read(given), Y.read(given)),
            [theta + (first + k * step) for k in range(n)],
            RANGE_MAX.read(given),
            UNKNOWN.read(given) == "pass",
        )

    @property
    def region(self) -> Region:
        """What the rays may reach."""
        point = np.array(self.point)
        ends = np.vstack((point, point + self.range_max * directions_of(self.bearings)))
        # Never without a width, as where all of them go along an axis.
        low, high = np.nextafter(ends.min(axis=0), -np.inf), np.nextafter(ends.max(axis=0), np.inf)
        return Region(*low.tolist(), *high.tolist())

    def cast(self, part: "FanCells") -> tuple[list[float], list[RayEnd]]:
        """Ranges, m, and how the rays end: a word of WORDS each."""
        cells = part.snapshot
        found, distances = cast_rays(
            part.start,
            part.directions,
            part.longest,
            self.through_unknown,
            cells.offset,
            cells.encode(trinary),
        )
        metres = distances * cells.lattice.resolution
        ranges: list[float] = np.where(found == FOUND_NOTHING, self.range_max, metres).tolist()
        return ranges, [WORDS[code] for code in found.tolist()]


@dataclass(frozen=True, slots=True, eq=False)
class FanCells:
    """The part of a map that the rays of a fan may cross, and the rays in its cells."""

    snapshot: MapSnapshot
    start: tuple[float, float]
    directions: np.ndarray[tuple[int, ...], np.dtype[np.float64]]
    longest: float

    @classmethod
    def of(cls, fan: Fan, whole: MapSnapshot) -> "FanCells":
        """What a fan needs of a map.

        Raises:
            BadParameter: it begins outside the map, or its rays cross too many cells.
            MapEmpty: there is no cell.
        """
        _, start = start_of(whole.lattice, whole.rect, fan.point)
        directions, longest = directions_of(fan.bearings), fan.range_max / whole.lattice.resolution
        window = window_of(start, directions, longest, whole.rect)
        crossed = len(fan.bearings) * min(int(2.0 * longest) + 2, window.width + window.height)
        if crossed > MAX_CROSSED:
            raise BadParameter(
                f"n, range_max: these rays may cross {crossed} cells, at most {MAX_CROSSED} are looked at: "
                "ask for fewer rays, or shorter ones"
            )
        return cls(whole.part(window), start, directions, longest)
