"""A cell model of two planes, tiny and all its own, one of them twice as fine; and scans for it.

It counts how many beams passed a cell and, on the finer plane, how many ended in each quarter of it, by the
side that they came from. Sums do not depend on order, and its probability looks one cell around.
"""

import math

import numpy as np

import naive
from ogm_core.cells.model import CellModel, Plane
from ogm_core.cells.published import pooled_probabilities
from ogm_core.sensor_models.beams import HIT, IX, IX0, IY, IY0, KIND, SKIPPED
from ogm_core.types import Pose, Scan

PASSED, ENDED = "passed", "ended"


def quarter(start, end):
    """Which quarter of its end cell a beam came through: (x, y), each 0 or 1."""
    return int(start[0] > end[0]), int(start[1] > end[1])


class Counts(CellModel):
    """Passes a cell, and ends a quarter of it."""

    sensor_models = frozenset({"beam"})
    margin = 1
    planes = (Plane(PASSED, np.dtype(np.uint16)), Plane(ENDED, np.dtype(np.uint32), 2))
    l0 = 0.0

    def update(self, evidence, store, window, revision):
        evidence.touch(store, window, revision)
        (ends,) = evidence.arrays
        passed, ended = store.planes[PASSED], store.planes[ENDED]
        updates = 0
        for beam in ends.T.tolist():
            if beam[KIND] == SKIPPED:
                continue
            start, end = ((beam[x] - window.ix, beam[y] - window.iy) for x, y in ((IX0, IY0), (IX, IY)))
            for i, j in naive.bresenham(*start, *end)[1:]:
                if not (0 <= i < window.width and 0 <= j < window.height):
                    continue
                updates += 1
                if (i, j) == end and beam[KIND] == HIT:
                    x, y = quarter(start, end)
                    ended.cells[ended.column[2 * i + x] + 128 * (2 * j + y)] += 1
                else:
                    passed.cells[passed.column[i] + 64 * j] += 1
        return updates

    def published(self, planes):
        height, width = planes[PASSED].shape
        ended = planes[ENDED].reshape(height, 2, width, 2).sum(axis=(1, 3))
        passed = planes[PASSED].astype(np.int64)
        known = (passed + ended > 0)[1:-1, 1:-1]
        around = sum(ended[y : y + height - 2, x : x + width - 2] for x in range(3) for y in range(3))
        hits = ended[1:-1, 1:-1]
        p = (hits + 0.1 * around + 0.1) / (hits + passed[1:-1, 1:-1] + 0.1 * around + 0.2)
        return np.where(known, p, 0.5), known

    pooled = pooled_probabilities


SCANS = 12


def scans(count=SCANS):
    """A robot that drives 30 m to the north-east, past the edges of many tiles."""
    rng = np.random.default_rng(4)
    for k in range(count):
        ranges = rng.uniform(0.5, 9.0, 60).astype(np.float32)
        scan = Scan(k, -math.pi, math.tau / 60, 0.1, 8.0, ranges)
        yield scan, Pose(2.1 * k - 3.0, 1.9 * k - 2.0, 0.3 * k)
