"""The cells that a beam passes, by their addresses: all of a beam's at once, then what is counted in each.

To compute addresses takes no look at memory, so the compiler does it for many cells at once; to count then
takes a load, an addition and a store a cell. Cells are addressed as in tiles.store.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.sensor_models.bresenham import FRACTION_BITS
from ogm_core.sensor_models.true_line import MAX_COLUMNS, Line
from ogm_core.tiles.store import TILE, TILE_BITS

MOST_PASSED = MAX_COLUMNS + 1
"""So many cells a beam passes at most."""
_MOST = 2**16 - 1
"""The largest number that a cell holds."""


@njit(cache=True, nogil=True, error_model="numpy")
def between_strips(column: NDArray[np.int64]) -> int:
    """How much farther than its neighbour's the address of a strip's first column is than within a strip.

    `column` may begin inside a strip: its first number tells where.
    """
    last = column.size - 1
    crossed = (last + (column[0] & (TILE - 1))) >> TILE_BITS
    return int((column[last] - column[0] - last) // crossed) if crossed else 0


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def find_passed(
    line: Line,
    k: int,
    last: int,
    acc: int,
    column: NDArray[np.int64],
    more: int,
    addresses: NDArray[np.int64],
) -> tuple[int, int]:
    """Write the addresses of the cells of steps `k` ... `last` of a line, all of them in the window.

    Their places along the major axis rise. Returns how many there are, and how many of them lie in the same
    tile as the first one, or more: at that place along the axis a tile ends. `acc` as of `row_at_start`,
    `more` as of `between_strips`.
    """
    west = column[0] & (TILE - 1)
    count, first = last - k + 1, k if line.sign > 0 else last
    along, aside = line.start + line.sign * first, line.aside
    at, step = acc + first * line.step, line.sign * line.step
    if line.along_i:
        foot, row = column[along : along + count], aside << TILE_BITS
        for n in range(count):
            addresses[n] = foot[n] + row + ((at >> FRACTION_BITS) << TILE_BITS)
            at += step
    else:
        # A strip holds its columns side by side: column[i] = column[0] + i + ((i + west) >> 6) * more.
        row = column[0] + aside + (along << TILE_BITS)
        for n in range(count):
            away = at >> FRACTION_BITS
            addresses[n] = row + away + ((aside + west + away) >> TILE_BITS) * more
            at += step
            row += TILE
    return count, TILE - ((along + (west if line.along_i else 0)) & (TILE - 1))


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def touch_at(touched: NDArray[np.int64], tile: int, revision: int) -> int:
    """Write `revision` into a tile, by its number in flat `touched`; return 1 if it held 0, else 0.

    Tile n of a store begins at address 4096 n of its cells. To ask whether it is there already would take a
    third of all the time that beams are counted in.
    """
    fresh = int(touched[np.uint64(tile)] == 0)
    touched[np.uint64(tile)] = revision
    return fresh


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def touch_passed(
    touched: NDArray[np.int64],
    corner: int,
    addresses: NDArray[np.int64],
    count: int,
    in_tile: int,
    revision: int,
) -> int:
    """Write `revision` into the tiles of `count` cells, as `find_passed` has found them; return fresh ones.

    `corner` is the number of the first tile in `touched`, which is flat. Between two tile edges of its major
    axis a line meets at most two tiles: those of the piece's ends.
    """
    fresh, first, end = 0, 0, min(in_tile, count)
    while first < count:
        fresh += touch_at(touched, (addresses[first] >> (2 * TILE_BITS)) - corner, revision)
        fresh += touch_at(touched, (addresses[end - 1] >> (2 * TILE_BITS)) - corner, revision)
        first, end = end, min(end + TILE, count)
    return fresh


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def add_to_passed(cells: NDArray[np.uint16], more: int, addresses: NDArray[np.int64], count: int) -> bool:
    """Add to every cell; returns whether some have wrapped: they now hold less than was added."""
    over = 0
    for n in range(count):
        address = np.uint64(addresses[n])
        value = np.int64(cells[address]) + more
        cells[address] = value & _MOST
        over |= int(value)
    return over > _MOST


@njit(cache=True, nogil=True, error_model="numpy")
def stop_at_most(cells: NDArray[np.uint16], addresses: NDArray[np.int64], count: int) -> None:
    """Let cells that 1 was added to, and that have wrapped, stay at the largest number that they hold."""
    for n in range(count):
        address = np.uint64(addresses[n])
        if cells[address] == 0:
            cells[address] = _MOST


@njit(cache=True, nogil=True, error_model="numpy")
def add_carries(
    cells: NDArray[np.uint16], carries: NDArray[Any], more: int, addresses: NDArray[np.int64], count: int
) -> None:
    """Carry 1 where a cell has wrapped: it now holds less than was added.

    One that has no carry left stays at the largest number that both planes hold together.
    """
    for n in range(count):
        address = np.uint64(addresses[n])
        wrapped, carry = np.int64(cells[address]) < more, np.int64(carries[address])
        if wrapped and carry == _MOST:
            cells[address] = _MOST
        else:
            carries[address] = carry + wrapped
