"""The slow, obvious twin of a map that forgets: a dictionary of cells, each of which decays at every tick."""

import math

import naive

TICK_FACTOR = 2**-0.25
SECOND = 10**9


class Map(naive.Map):
    """A naive map whose half-life is the settings'."""

    def __init__(self, settings):
        super().__init__(settings)
        model = settings.cell_model
        self.least = max(model.l_max - self.l0, self.l0 - model.l_min) / 16383
        self.tick = round(settings.half_life * 1e9 / 4)
        self.time = None
        self.ticks = 0

    def integrate(self, scan, pose):
        for _ in range(self.passed(scan.stamp)):
            self.ticks += 1
            self.cells = {cell: self.decayed(value) for cell, value in self.cells.items()}
        return super().integrate(scan, pose)

    def passed(self, stamp):
        """How many ticks a scan of this stamp lets pass."""
        if self.time is None:
            self.time = stamp
            return 0
        before, self.time = self.time, max(self.time, min(stamp, self.time + SECOND))
        return self.time // self.tick - before // self.tick

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
