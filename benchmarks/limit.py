"""What a scan as an area costs at least: every cell that it sees is written once, and its beams have edges.

The yardstick for the sensor model `sector`. It knows beforehand which cells are seen, as spans of rows, and
keeps them in one small dense array that stays in a core's own cache. It fills those spans with a saturating
subtraction, the cheapest update there is, in whole blocks of 64 cells: a map would have to spare some cells
of the first and the last block, and would still pay for them. And it computes where the area's edges begin
and end.
"""

import time
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.workloads import Workload, settings_of
from ogm_core.grid import OccupancyGrid
from ogm_core.types import PlacedScan

CACHE = 2**18
"""Bytes that the cells may fill: half of a usual L2 cache."""
BLOCK = 64
DECREMENT = 7


class Limit:
    """The least that scans of a workload cost, here every `every`-th; one of the contenders."""

    name, pid = "the least that sectors cost: fill, edge set-up", 0

    def __init__(self, work: Workload, every: int) -> None:
        """Find the spans of the scans, by mapping each one alone."""
        self._scans = work.scans[::every]
        self._settings = settings_of(work, sensor_model="sector")
        spans = [self.spans_of(placed) for placed in self._scans]
        width = max(int(end.max()) for _, _, end in spans)
        stride = width + 24 if width % BLOCK == 0 else width
        rows = CACHE // (2 * stride)
        self.blocks = []
        for row, first, end in spans:
            address = row % rows * stride
            blocks = (address + first) // BLOCK, (address + end - 1) // BLOCK + 1
            self.blocks.append(np.stack(blocks).astype(np.uint64))
        self._cells = np.zeros(rows * stride + BLOCK, np.uint16)
        first_scan = self._scans[0].scan
        borders = np.arange(first_scan.ranges.size + 1) - 0.5
        bearings = first_scan.angle_min + borders * first_scan.angle_increment
        self._directions = np.stack((np.cos(bearings), np.sin(bearings)))
        self._measure(0)

    def round(self) -> NDArray[np.float64]:
        """Do it all once; return the CPU time of every scan, us."""
        return 1e6 * np.array([self._measure(n) for n in range(len(self._scans))])

    def _measure(self, n: int) -> float:
        scan, pose, _ = self._scans[n]
        begin = time.thread_time()
        edge_ends(
            scan.ranges, self._directions, pose.theta, self._settings.resolution, self._settings.alpha / 2.0
        )
        fill(self._cells, self.blocks[n], np.uint16(DECREMENT))
        return time.thread_time() - begin

    def spans_of(self, placed: PlacedScan) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Row, first column and column after the last of every run of free, or of occupied, cells."""
        grid = OccupancyGrid(self._settings)
        grid.integrate(placed.scan, placed.pose)
        classes = np.pad(np.sign(grid.snapshot().cells), ((0, 0), (1, 1)))
        row, before = np.nonzero(np.diff(classes, axis=1))
        first, end = before[:-1], before[1:]
        seen = (row[:-1] == row[1:]) & (classes[row[:-1], first + 1] != 0)
        return row[:-1][seen], first[seen], end[seen]


@njit(cache=True, nogil=True, error_model="numpy")
def fill(cells: NDArray[np.uint16], spans: NDArray[np.uint64], decrement: np.uint16) -> None:
    """Subtract from the cells, not below 0; a span is its first block and the one after its last.

    Unsigned addresses and a whole number of cells a block let the compiler use vectors throughout.
    """
    for n in range(spans.shape[1]):
        for block in range(spans[0, n], spans[1, n]):
            for cell in range(np.uint64(BLOCK)):
                a = np.uint64(block * np.uint64(BLOCK) + cell)
                cells[a] = max(cells[a], decrement) - decrement


@njit(cache=True, nogil=True, error_model="numpy")
def edge_ends(
    ranges: NDArray[np.float32],
    directions: NDArray[np.float64],
    heading: float,
    resolution: float,
    half: float,
) -> NDArray[np.float64]:
    """Where the borders between beams meet the inner and the outer arcs of the beams on their either side.

    Returns x and y, in cells from the sensor: shape (8, N).
    """
    c, s = np.cos(heading), np.sin(heading)
    ends = np.empty((8, ranges.size))
    for k in range(ranges.size):
        inner, outer = (ranges[k] - half) / resolution, (ranges[k] + half) / resolution
        for border in range(2):
            x = c * directions[0, k + border] - s * directions[1, k + border]
            y = s * directions[0, k + border] + c * directions[1, k + border]
            ends[4 * border, k], ends[4 * border + 1, k] = inner * x, inner * y
            ends[4 * border + 2, k], ends[4 * border + 3, k] = outer * x, outer * y
    return ends
