"""Crossings: from cell to cell along a ray, in the order in which it meets them. Compiled.

J. Amanatides, A. Woo: A fast voxel traversal algorithm for ray tracing, Eurographics 1987. Each crossing is
computed from the start, not added up, so that a long ray is as exact as a short one.
"""

import math

from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def begin(u: float, v: float, du: float, dv: float) -> tuple[int, int, float, float]:
    """The cell (i, j) that (u, v) lies in, and how far along (du, dv) its next column and row begin.

    All in cells; infinite where the ray never leaves its column, or its row.
    """
    i, j = math.floor(u), math.floor(v)
    next_u = (i + (du > 0.0) - u) / du if du != 0.0 else math.inf
    next_v = (j + (dv > 0.0) - v) / dv if dv != 0.0 else math.inf
    return i, j, next_u, next_v


@njit(cache=True, nogil=True, error_model="numpy")
def step(
    u: float, v: float, du: float, dv: float, i: int, j: int, next_u: float, next_v: float
) -> tuple[float, int, int, float, float]:
    """How far along the ray leaves the cell (i, j), and the same of the one that it enters there.

    On a corner the next column comes first.
    """
    if next_u <= next_v:
        distance = next_u
        i += 1 if du > 0.0 else -1
        next_u = (i + (du > 0.0) - u) / du
    else:
        distance = next_v
        j += 1 if dv > 0.0 else -1
        next_v = (j + (dv > 0.0) - v) / dv
    return distance, i, j, next_u, next_v
