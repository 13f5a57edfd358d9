"""Counts of a map that was saved as NPZ: a cell model's planes, on the lattice that they were counted on.

What is served of such a map may have cells half as wide; the archive's `per_cell` says how many lie along a
side of one of those that were counted in, of which the first is cell `offset` // `per_cell`.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.model import Plane
from ogm_core.cells.thresholds import FREE_BELOW
from ogm_core.errors import BadInput, BadMapFile
from ogm_core.files.map_files import HALF_LIFE, check_place, read_free_below
from ogm_core.files.npz_arrays import UNREADABLE, NpzArrays

PER_CELL = "per_cell"


@dataclass(frozen=True, slots=True, eq=False)
class CountedMap:
    """Planes by name, [iy, ix], row 0 south; the first cell is `offset` of a lattice with this anchor, m."""

    planes: dict[str, NDArray[Any]]
    resolution: float
    anchor: tuple[float, float]
    offset: tuple[int, int]
    free_below: float = FREE_BELOW
    forgets: bool = False
    """Whether the map halved its counts as time went on: they are no longer sums over its scans."""


def load_counts(path: Path, kinds: Iterable[Plane], *, max_bytes: int) -> CountedMap | None:
    """The planes of these kinds in a file that `encode_npz` wrote; None if that was no map of counts.

    Raises:
        BadMapFile: it cannot be read, is something else, damaged or too large; the text says what is wrong.
    """
    try:
        with path.open("rb") as file, NpzArrays(file) as arrays:
            if PER_CELL not in arrays:
                return None
            place, side = check_place(arrays, str(path)), _per_cell(arrays, str(path))
            free_below = read_free_below(arrays, str(path))
            planes = _planes(arrays, list(kinds), str(path), max_bytes)
            forgets = HALF_LIFE in arrays
    except OSError as error:
        raise BadMapFile(f"{path}: cannot be read: {error.strerror or error}") from error
    except BadInput as error:
        raise BadMapFile(str(error)) from error
    except UNREADABLE as error:
        raise BadMapFile(
            f"{path}: not a map that was saved here and can be read ({str(error)[:400]})"
        ) from error
    ix, iy = (value // side for value in place.offset)
    return CountedMap(planes, place.resolution * side, place.anchor, (ix, iy), free_below, forgets)


def _per_cell(arrays: NpzArrays, name: str) -> int:
    packed = arrays[PER_CELL]
    if packed.shape != () or packed.dtype != np.int64:
        raise BadInput(f"{name}: {PER_CELL} is {packed}, one whole number is needed")
    side = int(packed.read())
    if side not in (1, 2):
        raise BadInput(f"{name}: {PER_CELL} is {side}, 1 or 2 is needed")
    return side


def _planes(arrays: NpzArrays, kinds: list[Plane], name: str, max_bytes: int) -> dict[str, NDArray[Any]]:
    packed = {kind.name: arrays[kind.name] for kind in kinds}
    height, width = packed[kinds[0].name].shape
    for kind in kinds:
        found, shape = packed[kind.name], (height * kind.side, width * kind.side)
        if found.shape != shape or found.dtype != kind.dtype:
            raise BadInput(f"{name}: {kind.name} is {found}, {kind.dtype} of shape {shape} is needed")
    size = sum(found.nbytes for found in packed.values())
    if size > max_bytes:
        raise BadInput(f"{name}: its planes take {size} bytes, at most {max_bytes} are allowed")
    return {plane: found.read() for plane, found in packed.items()}
