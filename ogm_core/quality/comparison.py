"""Comparison of two maps of one lattice, cell by cell: how many have which class, and where they differ."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import BadInput
from ogm_core.grid_settings import DEFAULT_MAX_CELLS
from ogm_core.lattice import SAME_RESOLUTION, CellRect
from ogm_core.pictures.png import write_png
from ogm_core.quality.agreement import BELIEF_FREE, BELIEF_OCCUPIED
from ogm_core.quality.class_maps import CLASSES, ClassMap
from ogm_core.quality.judged_map import UNKNOWN

_SAME_PLACE = 1e-3
"""Lattices that are so many cells apart are one: files round origins."""
_ALIKE_FREE, _ALIKE_OCCUPIED, _NEITHER = 0, 1, 2
_OCCUPIED_IN, _FREE_IN = (3, 4), (5, 6)
"""Values of a picture's pixels: occupied in the first or the second map alone; free, and not occupied."""
_COLOURS = (
    (254, 254, 254),
    (0, 0, 0),
    (205, 205, 205),
    (213, 94, 0),
    (0, 114, 178),
    (245, 210, 180),
    (176, 214, 238),
)
PICTURE = (
    "black and white: occupied, free in both; orange and blue: occupied in the first, the second alone; "
    "pale: free there alone"
)
"""What the colours of a picture mean."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Cells of two maps by their classes in the first and the second: `cells[first, second]`, int64, 4 x 4.

    Classes are numbered as CLASSES. A cell that one map does not have is unknown in it; of cells that are
    unknown in both, only those count that both have.
    """

    cells: NDArray[np.int64]

    @property
    def known_in_both(self) -> int:
        """How many cells are known in both maps."""
        return int(self.cells[1:, 1:].sum())

    @property
    def alike(self) -> float | None:
        """Share of these that have one class in both."""
        known = self.known_in_both
        return int(np.trace(self.cells[1:, 1:])) / known if known else None

    def iou(self, kind: int) -> float | None:
        """Intersection over union of the cells of a class; None if neither map has one."""
        both = int(self.cells[kind, kind])
        either = int(self.cells[kind].sum() + self.cells[:, kind].sum()) - both
        return both / either if either else None


def compare(first: ClassMap, second: ClassMap) -> Comparison:
    """Count the cells of two maps.

    Raises:
        BadInput: they are not of one lattice.
    """
    here, there = _rects(first, second)
    part = here.intersection(there)
    pairs = _cut(first, here, part).astype(np.int64) * len(CLASSES) + _cut(second, there, part)
    cells = np.bincount(pairs.ravel(), minlength=len(CLASSES) ** 2).reshape(len(CLASSES), -1)
    for one, axis in ((first, 1), (second, 0)):
        alone = np.bincount(one.classes.ravel(), minlength=len(CLASSES)) - cells.sum(axis=axis)
        alone[UNKNOWN] = 0
        cells[:, UNKNOWN] += alone if axis == 1 else 0
        cells[UNKNOWN] += alone if axis == 0 else 0
    return Comparison(cells)


def encode_difference(first: ClassMap, second: ClassMap) -> bytes:
    """PNG, north up, of all cells of two maps: where they are alike, and where not; colours as in PICTURE.

    Raises:
        BadInput: they are not of one lattice, or lie too far apart for one picture.
    """
    here, there = _rects(first, second)
    whole = here.union(there)
    if not 0 < whole.cells <= DEFAULT_MAX_CELLS:
        raise BadInput(
            f"{first.name} and {second.name} together are {whole.width} x {whole.height} cells: a picture "
            f"has 1 to {DEFAULT_MAX_CELLS}"
        )
    maps = [np.full((whole.height, whole.width), UNKNOWN, np.uint8) for _ in range(2)]
    for cells, one, rect in zip(maps, (first, second), (here, there), strict=True):
        row, column = rect.iy - whole.iy, rect.ix - whole.ix
        cells[row : row + rect.height, column : column + rect.width] = one.classes
    table = np.array([[_pixel(a, b) for b in range(len(CLASSES))] for a in range(len(CLASSES))], np.uint8)
    colours = np.zeros((256, 3), np.uint8)
    colours[: len(_COLOURS)] = _COLOURS
    return write_png(table[maps[0], maps[1]][::-1], colours)


def _pixel(a: int, b: int) -> int:
    if a == b:
        return {BELIEF_FREE: _ALIKE_FREE, BELIEF_OCCUPIED: _ALIKE_OCCUPIED}.get(a, _NEITHER)
    for kind, pixels in ((BELIEF_OCCUPIED, _OCCUPIED_IN), (BELIEF_FREE, _FREE_IN)):
        if kind in (a, b):
            return pixels[0] if a == kind else pixels[1]
    return _NEITHER


def _rects(first: ClassMap, second: ClassMap) -> tuple[CellRect, CellRect]:
    """The cells of both, counted on the lattice of the first."""
    (resolution, anchor, offset), other = first.place, second.place
    if not math.isclose(resolution, other.resolution, rel_tol=SAME_RESOLUTION):
        raise BadInput(
            f"{second.name}: its cells are {other.resolution:g} m, those of {first.name} {resolution:g} m: "
            "maps of one resolution are needed"
        )
    apart = [(there - here) / resolution for here, there in zip(anchor, other.anchor, strict=True)]
    beside = [cells - round(cells) for cells in apart]
    if max(map(abs, beside)) > _SAME_PLACE:
        raise BadInput(
            f"{second.name}: its cells lie {beside[0]:.3g} cells in x and {beside[1]:.3g} in y beside those "
            f"of {first.name}: maps of one lattice are needed"
        )
    height, width = first.classes.shape
    there_height, there_width = second.classes.shape
    ix, iy = (place + round(cells) for place, cells in zip(other.offset, apart, strict=True))
    return CellRect(*offset, width, height), CellRect(ix, iy, there_width, there_height)


def _cut(one: ClassMap, rect: CellRect, part: CellRect) -> NDArray[np.uint8]:
    row, column = part.iy - rect.iy, part.ix - rect.ix
    return one.classes[row : row + part.height, column : column + part.width]
