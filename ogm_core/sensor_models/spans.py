"""Row spans: cells of one class side by side in a row, and the kernels that update them.

Spans are int32, shape (n, 4): row, first column, column after the last, class; no cell is in two of them.
`window` is the contents of a CellRect, `constants` what cells.updates need.

Cells are addressed as in tiles.store: in a strip the 64 cells of a row are a block of memory, and planes that
cells.blocks knows are updated a block at a time.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.cells.blocks import (
    BLOCK_TYPES,
    block_limits,
    ended_in_part,
    passed_block,
    passed_part,
)
from ogm_core.cells.updates import ended, passed
from ogm_core.lattice import CellRect
from ogm_core.sensor_models.beams import Plain
from ogm_core.sensor_models.strip_work import work_of_spans
from ogm_core.tiles.marks import touch
from ogm_core.tiles.store import TILE, TILE_BITS

SPAN_FREE, SPAN_OCCUPIED = 1, 2
"""Classes of a span."""
CUT = TILE
"""Parts for threads begin at every so many-th column: blocks are updated whole."""
CELL_WORK = 0.25
"""How much work a cell is, most of them by blocks: one along Bresenham's line is 1."""


@njit(cache=True, error_model="numpy")
def extent(spans: NDArray[np.int32]) -> tuple[int, int, int, int]:
    """Smallest rectangle (ix, iy, width, height) that holds every span; width is 0 if there is none."""
    if spans.shape[0] == 0:
        return 0, 0, 0, 0
    numbers = spans.ravel()  # with unsigned places: half the time
    bottom, left, right = numbers[0], numbers[1], numbers[2]
    top = bottom
    for n in range(np.uint64(0), np.uint64(numbers.size), np.uint64(4)):
        bottom, top = min(bottom, numbers[n]), max(top, numbers[n])
        left = min(left, numbers[n + np.uint64(1)])
        right = max(right, numbers[n + np.uint64(2)])
    return left, bottom, right - left, top - bottom + 1


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _clipped(spans: NDArray[np.int32], n: int, window: CellRect) -> tuple[int, int, int]:
    """Row, first column and the one after the last of a span inside the window, counted from its corner.

    A span with nothing inside ends where it begins.
    """
    j = spans[n, 0] - window.iy
    first, end = max(spans[n, 1] - window.ix, 0), min(spans[n, 2] - window.ix, window.width)
    return (j, first, end) if first < end and 0 <= j < window.height else (0, 0, 0)


@njit(cache=True, error_model="numpy")
def touch_tiles(spans: NDArray[np.int32], window: Plain, touched: NDArray[np.int64], revision: int) -> int:
    """Write `revision` into every tile with a cell of a span, and return how many held 0 before.

    Only cells in `window` count; `touched`, shape (tiles in x, tiles in y), begins in its corner. Spans that
    follow each other mostly meet the same tiles.
    """
    window = CellRect(*window)
    fresh = 0
    marked, from_left, to_right = -1, 0, 0
    for n in range(spans.shape[0]):
        j, first, end = _clipped(spans, n, window)
        row, left, right = j >> TILE_BITS, first >> TILE_BITS, (end - 1) >> TILE_BITS
        if first == end or (row == marked and from_left <= left and right <= to_right):
            continue
        marked, from_left, to_right = row, left, right
        for tx in range(left, right + 1):
            fresh += touch(touched, tx << TILE_BITS, j, revision)
    return fresh


def strip_work(spans: NDArray[np.int32], window: Plain, work: NDArray[np.float64]) -> None:
    """Add to `work` about how many cells will be updated in each CUT columns of the window."""
    work_of_spans(spans, window, CUT, work)


def update_cells(
    spans: NDArray[np.int32],
    window: Plain,
    touched: NDArray[np.int64],
    revision: int,
    cells: NDArray[Any],
    column: NDArray[np.int64],
    constants: Plain,
) -> tuple[int, int]:
    """Add the evidence of the spans to their cells, and write `revision` into their tiles.

    Returns the number of cell updates and of tiles that held 0 before. Only cells in `window` are updated;
    the store of `cells` and `touched` begins in its corner.
    """
    kernel = update_blocks if cells.dtype in BLOCK_TYPES else update_one_by_one
    updates, fresh = kernel(spans, window, touched, revision, cells, column, constants)
    return updates, fresh


@njit(cache=True, nogil=True, error_model="numpy")
def update_one_by_one(
    spans: NDArray[np.int32],
    window: Plain,
    touched: NDArray[np.int64],
    revision: int,
    cells: NDArray[Any],
    column: NDArray[np.int64],
    constants: Plain,
) -> tuple[int, int]:
    """`update_cells` for any type of cells."""
    fresh = touch_tiles(spans, window, touched, revision)
    window = CellRect(*window)
    updates = 0
    for n in range(spans.shape[0]):
        j, first, end = _clipped(spans, n, window)
        updates += end - first
        for i in range(first, end):
            address = np.uint64(column[i] + (j << TILE_BITS))
            if spans[n, 3] == SPAN_FREE:
                cells[address] = passed(cells[address], 1.0, constants)
            else:
                cells[address] = ended(cells[address], 1.0, constants)
    return updates, fresh


@njit(cache=True, nogil=True, error_model="numpy")
def update_blocks(
    spans: NDArray[np.int32],
    window: Plain,
    touched: NDArray[np.int64],
    revision: int,
    cells: NDArray[np.int16],
    column: NDArray[np.int64],
    constants: Plain,
) -> tuple[int, int]:
    """`update_cells` for planes that cells.blocks knows: a row of a tile at once."""
    limits = block_limits(constants)
    window = CellRect(*window)
    updates = fresh = 0
    for n in range(spans.shape[0]):
        j, first, end = _clipped(spans, n, window)
        updates += end - first
        while first < end:
            last = min(end - 1, first | (TILE - 1))
            begin, until = first & (TILE - 1), last & (TILE - 1)
            tile = np.uint64(first >> TILE_BITS), np.uint64(j >> TILE_BITS)
            fresh += int(touched[tile] == 0)
            touched[tile] = revision
            block = np.uint64(column[np.uint64(first)] + (j << TILE_BITS) - begin)
            if spans[n, 3] != SPAN_FREE:
                ended_in_part(cells, block, begin, until, limits)
            elif until - begin == TILE - 1:
                passed_block(cells, block, limits)
            else:
                passed_part(cells, block, begin, until, limits)
            first = last + 1
    return updates, fresh
