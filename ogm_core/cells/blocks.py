"""Block updates of log odds: 64 int16 cells side by side in a few instructions, whatever part is meant.

A block is always updated whole: every cell is written, those outside the part as they were.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

BLOCK = 64
"""Cells of a block: the width of a tile."""
BLOCK_TYPES = (np.dtype(np.int16),)
"""Planes that are updated by blocks."""
Limits = tuple[np.int16, np.int16, np.int16, np.int16]
"""The highest number that a pass lowers to the clamp, its increment; the lowest of a hit, its increment."""


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def block_limits(constants: tuple[Any, ...]) -> Limits:
    """What the updates below need of the model's constants (see log_odds.CellConstants)."""
    free, occupied, lower, upper, _ = constants
    return np.int16(lower - free), np.int16(free), np.int16(upper - occupied), np.int16(occupied)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def passed_block(cells: NDArray[np.int16], block: np.uint64, limits: Limits) -> None:
    """`updates.passed` for all cells of the block at this address."""
    floor, less, _, _ = limits
    for q in range(np.uint64(BLOCK)):
        cells[block + q] = max(cells[block + q], floor) + less


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _is_meant(column: int, begin: int, until: int) -> np.bool_:
    """Whether a column lies in the part: those before it wrap, and are beyond it.

    In numbers as wide as cells, so that as many columns are compared at once as cells are updated.
    """
    return np.uint16(np.int64(column) - begin) <= np.uint16(until - begin)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def passed_part(
    cells: NDArray[np.int16],
    block: np.uint64,
    begin: int,
    until: int,
    limits: Limits,
) -> None:
    """`updates.passed` for the cells from column `begin` to `until` of a block."""
    floor, less, _, _ = limits
    for q in range(np.uint64(BLOCK)):
        cell = cells[block + q]
        cells[block + q] = max(cell, floor) + less if _is_meant(q, begin, until) else cell


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def ended_in_part(
    cells: NDArray[np.int16],
    block: np.uint64,
    begin: int,
    until: int,
    limits: Limits,
) -> None:
    """`updates.ended` for the cells from column `begin` to `until` of a block."""
    _, _, ceiling, more = limits
    for q in range(np.uint64(BLOCK)):
        cell = cells[block + q]
        cells[block + q] = (min(cell, ceiling) + more) | 1 if _is_meant(q, begin, until) else cell
