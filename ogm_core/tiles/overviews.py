"""Overviews: a tile's value bytes at half the size, a quarter and so on, down to one pixel for the tile.

A pixel stands for four of the level below. It is the likeliest of them if that is occupied, else the least
likely known one: occupied wins, then free. So joined, blocks of blocks are joined as `CellModel.pooled` joins
them at once, and a tile of 64 = 2^6 cells has levels 1 to 6 by itself alone.
"""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.cells.thresholds import OCCUPIED_ABOVE
from ogm_core.cells.value_bytes import FREE_LAST, LEVELS, OCCUPIED_FIRST, UNKNOWN_BYTE
from ogm_core.tiles.store import TILE, TILE_BITS

TOP: Final = TILE_BITS
"""The highest level: one pixel a tile."""
OVERVIEW_BYTES: Final = (TILE * TILE - 1) // 3
"""Of a tile: 32 x 32 + 16 x 16 + ... + 1, level after level, row after row."""
_FIRST: Final = tuple((TILE * TILE - 4 * (TILE >> level) ** 2) // 3 for level in range(TOP + 1))
"""Where each level begins; level 0 is not kept."""
_HALF: Final = TILE // 2


@njit(cache=True, nogil=True, error_model="numpy")
def look_up(table: NDArray[np.uint8], numbers: NDArray[np.uint16], found: NDArray[np.uint8]) -> None:
    """Write what stands in a table of 65536 bytes for each number into `found`."""
    for k in range(len(numbers)):
        found[k] = table[numbers[k]]


@njit(cache=True, nogil=True, error_model="numpy")
def make_overviews(cells: NDArray[np.uint8], found: NDArray[np.uint8]) -> None:
    """Write the overviews of tiles side by side, (64, 64 n), into `found`, (n, OVERVIEW_BYTES)."""
    for k in range(len(found)):
        overviews = found[k]
        for r in range(_HALF):
            below, above = cells[2 * r], cells[2 * r + 1]
            for c in range(_HALF):
                at = np.uint64(TILE * k + 2 * c)
                overviews[np.uint64(_HALF * r + c)] = _joined(
                    below[at], below[at + np.uint64(1)], above[at], above[at + np.uint64(1)]
                )
        first, side = 0, _HALF
        while side > 1:
            _halve(overviews, first, side)
            first += side * side
            side //= 2


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _halve(overviews: NDArray[np.uint8], first: int, side: int) -> None:
    """Make the next level of the one that begins at `first`, `side` pixels wide, behind it."""
    behind, half = first + side * side, side // 2
    for r in range(half):
        for c in range(half):
            at = np.uint64(first + 2 * side * r + 2 * c)
            above = at + np.uint64(side)
            overviews[np.uint64(behind + half * r + c)] = _joined(
                overviews[at],
                overviews[at + np.uint64(1)],
                overviews[above],
                overviews[above + np.uint64(1)],
            )


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _joined(a: np.uint8, b: np.uint8, c: np.uint8, d: np.uint8) -> np.uint8:
    """What stands for four value bytes."""
    highest = max(max(a, b), max(c, d))
    # What is unknown, 0, wraps around to 255, above whatever is known.
    one = np.uint8(1)
    lowest = np.uint8(
        min(min(np.uint8(a - one), np.uint8(b - one)), min(np.uint8(c - one), np.uint8(d - one))) + one
    )
    return highest if highest >= OCCUPIED_FIRST else lowest


@njit(cache=True, nogil=True, error_model="numpy")
def put_together(
    overviews: NDArray[np.uint8],
    which: NDArray[np.int32],
    column: int,
    row: int,
    level: int,
    pixels: NDArray[np.uint8],
) -> None:
    """Write a level of tiles into `pixels`, [iy, ix], from this column and row on.

    `which`, shape (tiles in x, tiles in y), says where in `overviews` each tile's are; -1: nowhere.
    """
    side, first = TILE >> level, _FIRST[level]
    for tx in range(which.shape[0]):
        for ty in range(which.shape[1]):
            if which[tx, ty] < 0:
                continue
            tile = overviews[which[tx, ty]]
            for r in range(side):
                for c in range(side):
                    pixels[row + side * ty + r, column + side * tx + c] = tile[first + side * r + c]


@njit(cache=True, nogil=True, error_model="numpy")
def write_value_bytes(
    p: NDArray[np.float64], known: NDArray[np.bool_], free_below: float, found: NDArray[np.uint8]
) -> None:
    """`value_bytes.value_byte` of many cells, several times as fast."""
    for k in range(found.size):
        byte = np.floor(LEVELS * p[k] + 1.5)
        if p[k] > OCCUPIED_ABOVE:
            byte = max(byte, float(OCCUPIED_FIRST))
        elif p[k] < free_below:
            byte = min(byte, float(FREE_LAST))
        else:
            byte = min(max(byte, FREE_LAST + 1.0), OCCUPIED_FIRST - 1.0)
        found[k] = np.uint8(byte) if known[k] else np.uint8(UNKNOWN_BYTE)
