"""Formats of the map, and the parameters of a question for it, as they are given: texts."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ogm_core.cells.model import CellModel
from ogm_core.errors import BadParameter, cut
from ogm_core.files.map_files import (
    DEFAULT_PALETTE,
    encode_json,
    encode_npz,
    encode_pgm,
    encode_pgw,
    encode_png,
    encode_yaml,
)
from ogm_core.lattice import Lattice, Region
from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.polygon import MAX_POINTS, Polygon
from ogm_services.replies.answer import Parameters, UnknownName
from ogm_services.settings.values import parse_number


@dataclass(frozen=True, slots=True)
class MapFormat:
    """A format of the map: its media type, the parameters that it takes, and what it costs."""

    media_type: str
    parameters: frozenset[str]
    cost: float
    """Bytes that are held for each byte of the map's cells while it is made, with its body, at most."""
    encode: Callable[[MapSnapshot, str, Parameters], bytes]
    only_with: str | None = None
    """The parameter without which no cell is looked at."""

    def cells_looked_at(self, cells: int, given: Parameters) -> int:
        """Of how many cells of so many it has to know more than where they are."""
        return cells if self.only_with is None or self.only_with in given else 0


MAP_FORMATS: dict[str, MapFormat] = {
    "png": MapFormat(
        "image/png",
        frozenset({"region", "at", "palette", "transparent", "max_size"}),
        4.0,  # cells of a block by their levels, while it is shrunk; else 2
        lambda snapshot, _, given: encode_png(
            snapshot, given.get("palette", DEFAULT_PALETTE), transparent=transparent(given)
        ),
    ),
    "pgw": MapFormat(
        "text/plain",
        frozenset({"region", "at", "max_size"}),
        4.0,  # of a picture that is shrunk
        lambda snapshot, *_: encode_pgw(snapshot),
        only_with="max_size",
    ),
    "json": MapFormat(
        "application/json",
        frozenset({"region", "at", "values"}),
        4.0,  # text of 4 bytes a cell, twice
        lambda snapshot, name, given: encode_json(snapshot, name, given.get("values", "percent")),
    ),
    "pgm": MapFormat(
        "image/x-portable-graymap",
        frozenset({"region", "at", "palette"}),
        1.5,  # 3 bytes a cell
        lambda snapshot, _, given: encode_pgm(snapshot, given.get("palette", DEFAULT_PALETTE)),
    ),
    "yaml": MapFormat(
        "application/yaml",
        frozenset({"region", "at"}),
        1.5,
        lambda snapshot, *_: encode_yaml(snapshot, "map.pgm"),
    ),
    "npz": MapFormat(
        "application/x-npz", frozenset({"region", "at"}), 6.0, lambda snapshot, *_: encode_npz(snapshot)
    ),
}

UPDATES_FORMAT = "tiles"
"""Format of what has changed of the map (serving.map_updates): it takes other parameters."""


def map_format(form: str, given: Parameters) -> MapFormat:
    """The format of a name, which takes these parameters.

    Raises:
        UnknownName: there is no such format.
        BadParameter: it takes no such parameter.
    """
    if form not in MAP_FORMATS:
        raise UnknownName(
            f"format: one of {', '.join((*MAP_FORMATS, UPDATES_FORMAT))} is needed, got {cut(form)!r}"
        )
    check_names(given, MAP_FORMATS[form].parameters)
    return MAP_FORMATS[form]


def bytes_to_make(wanted: MapFormat, model: CellModel, cells: int) -> int:
    """What is held while so many cells are encoded, at most."""
    cell = sum(np.dtype(plane.dtype).itemsize * plane.side**2 for plane in model.planes)
    return int(wanted.cost * cell * cells)


def check_names(given: Parameters, allowed: frozenset[str] | set[str] | tuple[()]) -> None:
    """Refuse parameters of other names.

    Raises:
        BadParameter: there is one; the text names it.
    """
    for name in given:
        if name not in allowed:
            listed = ", ".join(sorted(allowed)) or "none"
            raise BadParameter(f"{cut(name)}: unknown parameter; there are: {listed}")


def region_of(given: Parameters) -> Region | None:
    """The region that is asked for, None if none is.

    Raises:
        BadParameter: it is ill-formed.
    """
    if "region" not in given:
        return None
    parts = given["region"].split(",")
    if len(parts) != 4:
        raise BadParameter(f"region: xmin,ymin,xmax,ymax is needed, got {cut(given['region'])!r}")
    return Region(*(number("region", part) for part in parts))


def area_of(given: Parameters, lattice: Lattice) -> Polygon:
    """The area that is named, by a region or by the corners of a polygon.

    Raises:
        BadParameter: it is ill-formed, or there is none, or more than one.
    """
    if len(given.keys() & {"region", "polygon"}) != 1:
        raise BadParameter("region or polygon: one of them is needed, to say where")
    region = region_of(given)
    if region is not None:
        return Polygon.of_region(region, lattice)
    parts = given["polygon"].split(",")
    if len(parts) % 2 or not 3 <= len(parts) // 2 <= MAX_POINTS:
        raise BadParameter(
            f"polygon: x1,y1,x2,y2,... of 3 to {MAX_POINTS} points is needed, got {len(parts)} numbers"
        )
    numbers = [number("polygon", part) for part in parts]
    return Polygon(list(zip(numbers[::2], numbers[1::2], strict=True)), lattice)


def shrunk(snapshot: MapSnapshot, given: Parameters) -> MapSnapshot:
    """The map as small as is asked for.

    Raises:
        BadParameter: `max_size` is no number of pixels.
    """
    if "max_size" not in given:
        return snapshot
    text = given["max_size"]
    if not (text.isascii() and text.isdigit() and len(text) <= 9 and int(text) > 0):
        raise BadParameter(f"max_size: a number of pixels, 1 or more, is needed, got {cut(text)!r}")
    return snapshot.shrink(int(text))


def transparent(given: Parameters) -> bool:
    """Whether what is unknown is not to be drawn.

    Raises:
        BadParameter: `transparent` is neither 0 nor 1.
    """
    value = given.get("transparent", "0")
    if value not in ("0", "1"):
        raise BadParameter(f"transparent: 0 or 1 is needed, got {cut(value)!r}")
    return value == "1"


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
