"""Block updates of log odds: 64 int16 cells side by side in a few instructions, whatever part is meant.

A block is always updated whole, and a mask keeps what lies outside the part:

    column     0 . . . . begin . . . . until . . . . 63
    begun      0 0 0 0 0 1 1 1 1 1 1 1 1  1 1 1 1 1 1        64 zeros, 64 ones, read from 64 - begin on
    not ended  1 1 1 1 1 1 1 1 1 1 1 1 1  0 0 0 0 0 0        64 ones, 64 zeros, read from 63 - until on
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
def part_masks() -> NDArray[np.int16]:
    """Rows "begun" and "not ended", shape (2, 128)."""
    masks = np.full((2, 2 * BLOCK), -1, np.int16)
    masks[0, :BLOCK] = 0
    masks[1, BLOCK:] = 0
    return masks


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def passed_block(cells: NDArray[np.int16], block: np.uint64, limits: Limits) -> None:
    """`updates.passed` for all cells of the block at this address."""
    floor, less, _, _ = limits
    for q in range(np.uint64(BLOCK)):
        cells[block + q] = max(cells[block + q], floor) + less


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def passed_part(
    cells: NDArray[np.int16],
    block: np.uint64,
    begin: int,
    until: int,
    masks: NDArray[np.int16],
    limits: Limits,
) -> None:
    """`updates.passed` for the cells from column `begin` to `until` of a block."""
    floor, less, _, _ = limits
    left, right = np.uint64(BLOCK - begin), np.uint64(BLOCK - 1 - until)
    for q in range(np.uint64(BLOCK)):
        cell, mask = cells[block + q], masks[0, left + q] & masks[1, right + q]
        cells[block + q] = cell + ((max(cell, floor) - cell + less) & mask)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def ended_in_part(
    cells: NDArray[np.int16],
    block: np.uint64,
    begin: int,
    until: int,
    masks: NDArray[np.int16],
    limits: Limits,
) -> None:
    """`updates.ended` for the cells from column `begin` to `until` of a block."""
    _, _, ceiling, more = limits
    left, right = np.uint64(BLOCK - begin), np.uint64(BLOCK - 1 - until)
    for q in range(np.uint64(BLOCK)):
        cell, mask = cells[block + q], masks[0, left + q] & masks[1, right + q]
        cells[block + q] = cell ^ ((((min(cell, ceiling) + more) | 1) ^ cell) & mask)
