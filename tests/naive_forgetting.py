"""The slow, obvious twins of maps that forget: dictionaries of cells, each of which decays at every tick."""

import math
from collections import Counter

import naive
import naive_rate
from ogm_core.lattice import CellRect

TICK_FACTOR = 2**-0.25
SECOND = 10**9


class Clock:
    """The time of a map, and how many ticks have passed."""

    def __init__(self, tick):
        self.tick = tick
        self.time = None
        self.ticks = 0

    def passed(self, stamp):
        """How many ticks a scan of this stamp lets pass."""
        if self.time is None:
            self.time = stamp
            return 0
        before, self.time = self.time, max(self.time, min(stamp, self.time + SECOND))
        passed = self.time // self.tick - before // self.tick
        self.ticks += passed
        return passed


class Counts(naive_rate.Counts):
    """Naive counts, all of which are halved once a half-life, rounded down."""

    def __init__(self, settings):
        super().__init__(settings)
        self.clock = Clock(round(settings.half_life * 1e9))

    def integrate(self, scan, pose):
        for _ in range(self.clock.passed(scan.stamp)):
            for name in "NFEH":
                halves = {cell: count // 2 for cell, count in getattr(self, name).items()}
                setattr(self, name, Counter(halves))
        super().integrate(scan, pose)

    def erase(self, rect):
        """Make the cells of a rectangle unknown; how many held something."""
        gone = {cell for cell in self.cells() if rect.contains(CellRect(*cell, 1, 1))}
        for plane, side in ((self.N, 1), (self.F, 1), (self.E, 2), (self.H, 2)):
            for i, j in [(i, j) for i, j in plane if (i // side, j // side) in gone]:
                del plane[i, j]
        return len(gone)


class Map(naive.Map):
    """A naive map whose half-life is the settings'."""

    def __init__(self, settings):
        super().__init__(settings)
        model = settings.cell_model
        self.least = max(model.l_max - self.l0, self.l0 - model.l_min) / 16383
        self.clock = Clock(round(settings.half_life * 1e9 / 4))

    def integrate(self, scan, pose):
        for _ in range(self.clock.passed(scan.stamp)):
            self.cells = {cell: self.decayed(value) for cell, value in self.cells.items()}
        return super().integrate(scan, pose)

    def decayed(self, value):
        if self.step is not None:
            return math.trunc(value * TICK_FACTOR)
        away = (value - self.l0) * TICK_FACTOR
        return self.l0 + (0.0 if abs(away) < self.least else away)

    def erase(self, rect):
        """Make the cells of a rectangle unknown; how many were not."""
        gone = [
            (ix, iy)
            for ix, iy in self.cells
            if rect.ix <= ix < rect.ix + rect.width and rect.iy <= iy < rect.iy + rect.height
        ]
        for cell in gone:
            del self.cells[cell]
        return len(gone)
