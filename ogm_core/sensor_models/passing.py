"""Beams as lengths of passing, and hits: the kernels that count them, along true lines.

    cells   o . . . .        In every column strictly between the sensor's and the last but one, ONE cell gets
            . x x . .        the beam's weight: the one that holds the line at the column's middle.
            . . . x :        A beam that met nothing counts 1 there, in a plane of its own.
            . . . . :        Over the last two columns before a hit, columns half as wide count in the same
                             way, up to the end point's own, which gets the part that was entered.
    halves      x x          The hit itself is shared by the four halves around the end point.
                    x x

A cell that is passed along its whole column counts the length of that, which is longer the steeper the line
runs (Schaefer, Luft & Burgard 2017). Every number is a sum of whole numbers that depend on one beam alone; it
stops at the largest that its plane holds, so that the order of beams never matters.

`ends` and `weights` are those of `counted_beams`. Cells are addressed as in tiles.store. `window` is the
contents of a CellRect, of cells; the planes are those of cells.rate.
"""

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.lattice import CellRect
from ogm_core.sensor_models.beams import HIT, KIND, NO_RETURN, Plain
from ogm_core.sensor_models.counted_beams import last_passed, points_in
from ogm_core.sensor_models.passed_cells import (
    MOST_PASSED,
    add_carries,
    add_to_passed,
    between_strips,
    find_passed,
    stop_at_most,
    touch_at,
    touch_passed,
)
from ogm_core.sensor_models.passing_ends import (
    TILE_OF_HALF,
    all_in_one_tile,
    count_end,
    count_end_in_tile,
    fetch_end,
)
from ogm_core.sensor_models.passing_extent import extent, touch_tiles
from ogm_core.sensor_models.strip_work import work_of_beams
from ogm_core.sensor_models.true_line import (
    SUBCELL_BITS,
    Line,
    half_columns,
    line_of,
    row_at_start,
    steps_inside,
)
from ogm_core.tiles.store import TILE_BITS

__all__ = ["extent", "strip_work", "touch_tiles", "update_planes"]

CUT = 32
"""Parts for threads begin at every so many-th column: none writes into a cache line of another's."""
CELL_WORK = 0.4
"""How much work a cell is for threads: one along Bresenham's line is 1. To count takes longer, but near the
sensor, where threads meet, they wait for each other: up to 600,000 cells they lose more than they gain."""


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _weight_of_column(line: Line, range_weight: int) -> int:
    """What a beam counts in a column: the length that it passes there, in sixteenths, times its weight."""
    advance = float(line.advance)
    return int(range_weight * math.sqrt(advance * advance + float(line.rise * line.rise)) / advance + 0.5)


def strip_work(
    ends: NDArray[np.int64],
    weights: NDArray[np.int64],
    window: Plain,
    work: NDArray[np.float64],
) -> None:
    """Add to `work` about how many cells will be updated in each CUT columns of the window."""
    work_of_beams(ends, SUBCELL_BITS, window, CUT, work)


@njit(cache=True, nogil=True, error_model="numpy")
def update_planes(
    ends: NDArray[np.int64],
    weights: NDArray[np.int64],
    window: Plain,
    touched: NDArray[np.int64],
    revision: int,
    columns: tuple[NDArray[np.int64], NDArray[np.int64]],
    planes: tuple[Any, ...],
) -> tuple[int, int]:
    """Add a scan's beams to the planes of cells.rate, in its order, and write `revision` into their tiles.

    Returns the number of cell updates and of tiles that held 0 before. Only what lies in `window` changes;
    `columns`, which address cells and halves, begin in its corner, `touched` with the tile that holds it.
    """
    window = CellRect(*window)
    passing, carries, unanswered, near, hits = planes
    addresses, flat = np.empty(MOST_PASSED, np.int64), touched.reshape(-1)
    more, corner = between_strips(columns[0]), columns[0][0] >> (2 * TILE_BITS)
    updates = fresh = 0
    for b in range(ends.shape[1]):
        counts, u0, v0, u1, v1 = points_in(window, ends, b)
        if not counts:
            continue
        line, kind, range_weight = line_of(u0, v0, u1, v1), ends[KIND, b], weights[b]
        acc, weight = row_at_start(line), _weight_of_column(line, range_weight)
        first, last = steps_inside(line, last_passed(line, kind), acc, window.width, window.height)
        halves, point, at = half_columns(line), (u1, v1), -1
        if kind == HIT and all_in_one_tile(line, point, halves[1], window, columns[1]):
            at = columns[1][np.uint64(u1 >> 3)] + ((v1 >> 3) << (TILE_BITS + 1))
            fetch_end(line, at, near, hits)
        if first <= last:
            count, in_tile = find_passed(line, first, last, acc, columns[0], more, addresses)
            updates += count
            fresh += touch_passed(flat, corner, addresses, count, in_tile, revision)
            if kind == NO_RETURN:
                if add_to_passed(unanswered, 1, addresses, count):
                    stop_at_most(unanswered, addresses, count)
            elif add_to_passed(passing, weight, addresses, count):
                add_carries(passing, carries, weight, addresses, count)
        if at >= 0:
            updates += count_end_in_tile(line, point, (weight, range_weight), halves, at, near, hits)
            fresh += touch_at(flat, (at >> TILE_OF_HALF) - corner, revision)
        elif kind == HIT:
            found, tiles = count_end(
                line, point, (weight, range_weight), window, flat, revision, columns[1], near, hits
            )
            updates += found
            fresh += tiles
    return updates, fresh
