"""Distances between cells: from the centre of each to that of the nearest occupied one.

The transform is SciPy's, exact (C. Maurer, R. Qi, V. Raghavan: A linear time algorithm for computing exact
Euclidean distance transforms of binary images in arbitrary dimensions, IEEE TPAMI 25(2), 2003). SciPy is
loaded when somebody asks: who does not needs it not.
"""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.classes import OCCUPIED
from ogm_core.cells.model import row_bands
from ogm_core.errors import BadParameter, MissingExtra
from ogm_core.lattice import CellRect

MAX_RADIUS = 100.0
"""The largest radius of an inflation, m."""
MIN_DISTANCE, MAX_DISTANCE = 0.001, 1000.0
"""Distances up to which one may ask to look, m."""
WITHIN = 1e-6
"""So many cells more count as within a radius: sums of decimals seldom meet one exactly."""
BYTES_A_CELL = 12
"""What `distances` and `inflated` hold for each of the cells that they look at, besides what they return."""


def distances(
    states: NDArray[np.int8], part: CellRect, resolution: float, max_distance: float = math.inf
) -> NDArray[np.float32]:
    """Metres from the centre of each cell of `part` to that of the nearest occupied one, float32.

    `states` are trinary, [iy, ix]; `part` is counted from their lower-left one. What is farther than
    `max_distance`, m, has just that; where nothing is occupied, and without it, distances are infinite.

    Raises:
        BadParameter: `max_distance` is below MIN_DISTANCE.
        MissingExtra: SciPy is not installed.
    """
    if not max_distance >= MIN_DISTANCE:
        raise BadParameter(f"max_distance: {MIN_DISTANCE:g} m or more is needed, got {max_distance:g}")
    metres = np.full((part.height, part.width), max_distance, np.float32)
    for rows, squared in _squared_distances(states, part):
        np.minimum(metres[rows], np.sqrt(squared) * resolution, out=metres[rows], casting="same_kind")
    return metres


def inflated(states: NDArray[np.int8], part: CellRect, resolution: float, radius: float) -> NDArray[np.int8]:
    """The states of the cells of `part`, OCCUPIED where an occupied one is within `radius`, m, of the centre.

    Raises:
        BadParameter: the radius is out of its range.
        MissingExtra: SciPy is not installed.
    """
    check_radius(radius)
    within = (radius / resolution + WITHIN) ** 2
    grown = states[part.iy : part.iy + part.height, part.ix : part.ix + part.width].copy()
    for rows, squared in _squared_distances(states, part):
        grown[rows][squared <= within] = OCCUPIED
    return grown


def check_radius(radius: float) -> None:
    """Refuse a radius, m, that no inflation has.

    Raises:
        BadParameter: it is out of its range.
    """
    if not 0.0 <= radius <= MAX_RADIUS:
        raise BadParameter(f"radius: 0 to {MAX_RADIUS:g} m is needed, got {radius:g}")


def around(part: CellRect, reach: float, whole: CellRect) -> CellRect:
    """The cells of `whole` that tell all within `reach`, cells, of `part`, which lies in it."""
    if reach >= whole.width + whole.height:
        return whole
    more = math.ceil(reach) + 1
    grown = CellRect(part.ix - more, part.iy - more, part.width + 2 * more, part.height + 2 * more)
    return grown.intersection(whole)


def _squared_distances(
    states: NDArray[np.int8], part: CellRect
) -> Iterator[tuple[slice, NDArray[np.float64]]]:
    """Rows of `part`, and squared distances of their cells in cells, exact; none if nothing is occupied."""
    if not part.cells or not np.any(states == OCCUPIED):
        return
    nearest = _nearest_occupied(states)
    columns = np.arange(part.ix, part.ix + part.width)
    for band in row_bands((part.height, part.width)):
        rows = np.arange(part.iy, part.iy + part.height)[band]
        near = nearest[:, rows[0] : rows[-1] + 1, part.ix : part.ix + part.width].astype(np.float64)
        up, along = near[0] - rows[:, None], near[1] - columns
        yield band, up * up + along * along


def _nearest_occupied(states: NDArray[np.int8]) -> NDArray[np.int32]:
    """Row and column of an occupied cell that is nearest to each: shape (2, h, w)."""
    try:
        from scipy.ndimage import distance_transform_edt
    except ImportError as error:
        raise MissingExtra(
            "distances and inflation are computed by SciPy, which is not installed: pip install scipy"
        ) from error
    nearest: NDArray[np.int32] = distance_transform_edt(
        states != OCCUPIED, return_distances=False, return_indices=True
    )
    return nearest
