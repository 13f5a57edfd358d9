"""Points and footprints as users give them: arrays of NumPy, or lists."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ogm_core.errors import BadParameter

Footprint = list[tuple[float, float]]


def footprints_of(points: ArrayLike | None, footprints: Sequence[ArrayLike] | None) -> list[Footprint]:
    """The corners of each footprint, m; a point has one.

    Raises:
        BadParameter: not one of the two is given, or it is something else.
    """
    if (points is None) == (footprints is None):
        raise BadParameter("points or footprints: one of them is needed, to say where")
    if footprints is None:
        return [[point] for point in _corners("points", points)]
    read = [_corners("footprints", corners) for corners in footprints]
    for number, corners in enumerate(read):
        if len(corners) < 3:
            raise BadParameter(
                f"footprints: number {number}: 3 or more corners are needed, got {len(corners)}"
            )
    return read


def _corners(name: str, values: ArrayLike | None) -> Footprint:
    try:
        corners = np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise BadParameter(f"{name}: {error}") from error
    if corners.ndim != 2 or corners.shape[1] != 2:
        raise BadParameter(f"{name}: points (x, y) are needed, got an array of shape {corners.shape}")
    if not np.isfinite(corners).all():
        raise BadParameter(f"{name}: finite numbers are needed")
    return [(x, y) for x, y in corners.tolist()]
