"""Formats of the map, and the parameters that each of them takes."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ogm_core.cells.model import CellModel
from ogm_core.errors import cut
from ogm_core.files.map_files import encode_json, encode_npz, encode_pgm, encode_pgw, encode_png, encode_yaml
from ogm_core.snapshot import MapSnapshot
from ogm_services.mapper.serving.map_parameters import (
    AT,
    COARSE_FIRST,
    FINE_FIRST,
    GREY_PALETTE,
    MAP_VALUES,
    MAX_SIZE,
    PALETTE,
    REGION,
    TRANSPARENT,
    served,
    transparent,
)
from ogm_services.mapper.serving.query_parameters import Parameter, check_names
from ogm_services.replies.answer import Parameters, UnknownName


@dataclass(frozen=True, slots=True)
class MapFormat:
    """A format of the map: its media type, the parameters that it takes, and what it costs."""

    media_type: str
    parameters: tuple[Parameter, ...]
    cost: float
    """Bytes that are held for each byte of the map's cells while it is made, with its body, at most."""
    encode: Callable[[MapSnapshot, str, Parameters], bytes]
    only_with: str | None = None
    """The parameter without which no cell is looked at."""

    def served(self, snapshot: MapSnapshot, given: Parameters) -> MapSnapshot:
        """The map in the cells that this format has by itself, or that are asked for.

        Raises:
            BadParameter: the resolution that is asked for is none.
        """
        return served(snapshot, COARSE_FIRST if COARSE_FIRST in self.parameters else FINE_FIRST, given)

    def cells_looked_at(self, cells: int, given: Parameters) -> int:
        """Of how many cells of so many it has to know more than where they are."""
        return cells if self.only_with is None or self.only_with in given else 0


MAP_FORMATS: dict[str, MapFormat] = {
    "png": MapFormat(
        "image/png",
        (REGION, AT, FINE_FIRST, PALETTE, TRANSPARENT, MAX_SIZE),
        4.0,  # cells of a block by their levels, while it is shrunk; else 2
        lambda snapshot, _, given: encode_png(snapshot, PALETTE.read(given), transparent=transparent(given)),
    ),
    "pgw": MapFormat(
        "text/plain",
        (REGION, AT, FINE_FIRST, MAX_SIZE),
        4.0,  # of a picture that is shrunk
        lambda snapshot, *_: encode_pgw(snapshot),
        only_with="max_size",
    ),
    "json": MapFormat(
        "application/json",
        (REGION, AT, FINE_FIRST, MAP_VALUES),
        4.0,  # text of 4 bytes a cell, twice
        lambda snapshot, name, given: encode_json(snapshot, name, MAP_VALUES.read(given)),
    ),
    "pgm": MapFormat(
        "image/x-portable-graymap",
        (REGION, AT, COARSE_FIRST, GREY_PALETTE),
        1.5,  # 3 bytes a cell
        lambda snapshot, _, given: encode_pgm(snapshot, GREY_PALETTE.read(given)),
    ),
    "yaml": MapFormat(
        "application/yaml",
        (REGION, AT, COARSE_FIRST),
        1.5,
        lambda snapshot, *_: encode_yaml(snapshot, "map.pgm"),
    ),
    "npz": MapFormat(
        "application/x-npz", (REGION, AT, FINE_FIRST), 6.0, lambda snapshot, *_: encode_npz(snapshot)
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
