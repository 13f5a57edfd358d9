"""Ray casting, compiled: the first cell that is not free on the way of a ray.

Its NumPy twin, which gives the same to the last bit, is `rays.RayCaster`.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.cells.classes import FREE, OCCUPIED
from ogm_core.queries.crossings import begin, step
from ogm_core.queries.rays import FOUND_NOTHING, FOUND_UNKNOWN, FOUND_WALL


@njit(cache=True, nogil=True, error_model="numpy")
def cast_ray(
    u: float,
    v: float,
    du: float,
    dv: float,
    longest: float,
    through_unknown: bool,
    west: int,
    south: int,
    cells: NDArray[Any],
    free: int,
    occupied: int,
) -> tuple[int, float]:
    """Follow a ray from (u, v) along (du, dv), a unit vector, until it is stopped; lengths in cells.

    `cells`, shape (h, w), [iy, ix], whose lower-left one is the cell (west, south), hold the values `free`,
    `occupied`, or another one of unknown and undecided cells. What lies outside is unknown; the point lies
    inside. The cell that the ray starts in is not asked. An unknown cell stops it, unless it goes
    `through_unknown`. Returns where it ends (FOUND_WALL, FOUND_UNKNOWN, FOUND_NOTHING within `longest`), and
    the distance at which it enters that cell.
    """
    height, width = cells.shape
    i, j, next_u, next_v = begin(u, v, du, dv)
    while True:
        distance, i, j, next_u, next_v = step(u, v, du, dv, i, j, next_u, next_v)
        if distance > longest:
            return FOUND_NOTHING, longest
        column, row = i - west, j - south
        if not (0 <= column < width and 0 <= row < height):
            # Who has left a rectangle never comes back.
            return (FOUND_NOTHING, longest) if through_unknown else (FOUND_UNKNOWN, distance)
        cell = cells[row, column]
        if cell == occupied:
            return FOUND_WALL, distance
        if cell != free and not through_unknown:
            return FOUND_UNKNOWN, distance


@njit(cache=True, nogil=True, error_model="numpy")
def cast_rays(
    start: tuple[float, float],
    directions: NDArray[np.float64],
    longest: float,
    through_unknown: bool,
    corner: tuple[int, int],
    states: NDArray[np.int8],
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Cast a ray along each of `directions`, shape (n, 2); see `cast_ray`.

    `states` are trinary (`cells.classes`), `corner` is their lower-left cell. Returns, of each, where it ends
    and the distance, in cells.
    """
    n = len(directions)
    found, distances = np.empty(n, np.uint8), np.empty(n)
    for k in range(n):
        end, distance = cast_ray(
            start[0],
            start[1],
            directions[k, 0],
            directions[k, 1],
            longest,
            through_unknown,
            corner[0],
            corner[1],
            states,
            FREE,
            OCCUPIED,
        )
        found[k], distances[k] = end, abs(distance)  # from a line westward it is -0.0
    return found, distances
