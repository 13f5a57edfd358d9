"""Layers over the map: distances to what is occupied, and cells that are inflated by a radius, as files."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import cut
from ogm_core.files.layer_files import (
    DISTANCE,
    OCCUPANCY,
    encode_distance_png,
    encode_layer_npz,
    encode_states_png,
)
from ogm_core.lattice import CellRect
from ogm_core.queries.distances import (
    BYTES_A_CELL,
    MAX_DISTANCE,
    MAX_RADIUS,
    MIN_DISTANCE,
    distances,
    inflated,
)
from ogm_core.snapshot import MapSnapshot
from ogm_core.wire.keys import Query
from ogm_services.mapper.serving.map_parameters import AT, REGION
from ogm_services.mapper.serving.query_parameters import NumberParameter, Parameter, check_names
from ogm_services.replies.answer import Parameters, UnknownName

LAYER_FORMATS: Mapping[str, str] = {"png": "image/png", "npz": "application/x-npz"}
"""Their media types."""
PICTURE_DISTANCE = 2.55
"""How far the picture of distances tells them apart unless told otherwise, m: a level of grey is 1 cm."""
_BYTES_A_RESULT = 12
"""What is held for each cell of a result while it is encoded, with its body."""

DISTANCE_OF_PICTURE = NumberParameter(
    "max_distance",
    "metres at and beyond which the picture is white, 255",
    MIN_DISTANCE,
    MAX_DISTANCE,
    default=PICTURE_DISTANCE,
)
DISTANCE_OF_ARRAY = NumberParameter(
    "max_distance",
    "metres up to which occupied cells are looked for: what is farther has just that",
    MIN_DISTANCE,
    MAX_DISTANCE,
    optional=True,
    example=5.0,
)
RADIUS = NumberParameter(
    "radius", "metres within which a cell's centre is of an occupied one's", 0.0, MAX_RADIUS, example=0.3
)


def layer_parameters(name: Query, form: str) -> tuple[Parameter, ...]:
    """What a layer takes in a format."""
    if name == "inflate":
        return REGION, AT, RADIUS
    return REGION, AT, DISTANCE_OF_PICTURE if form == "png" else DISTANCE_OF_ARRAY


class Layer(Protocol):
    """A layer that is asked for."""

    @property
    def reach(self) -> float:
        """How far beyond a cell one must look to compute it, m."""

    def encoded(self, states: NDArray[np.int8], part: CellRect, shown: MapSnapshot) -> bytes:
        """The file of `shown`: its cells are `part` of `states`, counted from their lower-left one."""


@dataclass(frozen=True, slots=True)
class DistanceLayer:
    """Metres to the nearest occupied cell, in a format."""

    form: str
    reach: float

    @classmethod
    def read(cls, form: str, given: Parameters) -> "DistanceLayer":
        """What a request asks for.

        Raises:
            BadParameter: a parameter is unknown, ill-formed or out of range.
        """
        check_names(given, layer_parameters("distance", form))
        if form == "png":
            return cls(form, DISTANCE_OF_PICTURE.read(given))
        return cls(form, DISTANCE_OF_ARRAY.read(given) if "max_distance" in given else math.inf)

    def encoded(self, states: NDArray[np.int8], part: CellRect, shown: MapSnapshot) -> bytes:
        """See `Layer`."""
        metres = distances(states, part, shown.lattice.resolution, self.reach)
        if self.form == "png":
            return encode_distance_png(metres, self.reach)
        return encode_layer_npz(DISTANCE, metres, shown)


@dataclass(frozen=True, slots=True)
class InflatedLayer:
    """Trinary states, occupied within a radius of what is, in a format."""

    form: str
    reach: float

    @classmethod
    def read(cls, form: str, given: Parameters) -> "InflatedLayer":
        """What a request asks for.

        Raises:
            BadParameter: a parameter is unknown, missing, ill-formed or out of range.
        """
        check_names(given, layer_parameters("inflate", form))
        return cls(form, RADIUS.read(given))

    def encoded(self, states: NDArray[np.int8], part: CellRect, shown: MapSnapshot) -> bytes:
        """See `Layer`."""
        grown = inflated(states, part, shown.lattice.resolution, self.reach)
        return encode_states_png(grown) if self.form == "png" else encode_layer_npz(OCCUPANCY, grown, shown)


def layer_of(name: Query, form: str, given: Parameters) -> Layer:
    """The layer of that name that is asked for.

    Raises:
        UnknownName: there is no such format.
        BadParameter: a parameter is unknown, missing, ill-formed or out of range.
    """
    if form not in LAYER_FORMATS:
        raise UnknownName(f"format: one of {', '.join(LAYER_FORMATS)} is needed, got {cut(form)!r}")
    return DistanceLayer.read(form, given) if name == "distance" else InflatedLayer.read(form, given)


def layer_bytes(looked_at: int, shown: int) -> int:
    """What is held while a layer is made, at most: cells that are looked at, and those that are shown."""
    return BYTES_A_CELL * looked_at + _BYTES_A_RESULT * shown
