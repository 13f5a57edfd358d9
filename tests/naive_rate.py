"""The slow, obvious twin of the rate cell model: dictionaries, whole numbers and exact fractions."""

import math
from collections import Counter
from fractions import Fraction

import numpy as np

import naive

NO_RETURN, HIT, BEYOND = "no return", "hit", "beyond"


def range_weight(length):
    return math.floor(16 / (1 + (length / 16) ** 2) + 0.5)


def beams(scan, pose, settings):
    """(kind, start, end, range weight) of every beam that counts; points in sixteenths of a cell."""
    lattice = settings.lattice
    # A scan's own distances come first.
    reach = next((d for d in (scan.reach, settings.reach) if d is not None), math.inf)
    clear_range = next((d for d in (scan.clear_range, settings.clear_range) if d is not None), math.inf)
    limits = scan.range_min, scan.range_max, settings.alpha, clear_range, reach
    sixteenths = {"resolution": lattice.resolution / 16, "anchor": lattice.anchor, "alpha": settings.alpha}
    found = naive.observations(scan, pose, **sixteenths, clear_range=clear_range, reach=reach)
    for n in range(len(scan.ranges)):
        beam = naive.classify(float(scan.ranges[n]), *limits)
        if beam is None:
            continue
        hit, length = beam
        start, end, _, _ = next(found)
        heard = scan.ranges[n] < scan.range_max - settings.alpha / 2
        yield HIT if hit else BEYOND if heard else NO_RETURN, start, end, range_weight(length)


def on_line(start, end, axis, at, side):
    """Index across of the cell, `side` wide, that holds the line where it is `at` along; in 1/32 cell."""
    a, b = ([2 * value + 1 for value in point] for point in (start, end))
    across, dx = 1 - axis, b[axis] - a[axis]
    place = Fraction(a[across] * dx + (at - a[axis]) * (b[across] - a[across]), side * dx)
    return place.numerator // place.denominator


def major_axis(start, end):
    return 0 if abs(end[0] - start[0]) >= abs(end[1] - start[1]) else 1


class Counts:
    """The planes, of one robot or of many: {(i, j): whole number}."""

    def __init__(self, settings=None):
        self.settings = settings
        self.bounds = None if settings is None else settings.bounds_rect
        self.N, self.F, self.E, self.H = Counter(), Counter(), Counter(), Counter()

    def integrate(self, scan, pose):
        for kind, start, end, weight in beams(scan, pose, self.settings):
            ends = [(x // 16, y // 16) for x, y in (start, end)]
            if self.settings.outside == "drop" and not all(map(self.inside, ends)):
                continue
            self.beam(kind, start, end, weight)
        self.cut()

    def inside(self, cell, per_side=1):
        if self.bounds is None:
            return True
        return 0 <= cell[0] < per_side * self.bounds.width and 0 <= cell[1] < per_side * self.bounds.height

    def cut(self):
        """Forget what lies outside the bounds."""
        for plane, side in ((self.N, 1), (self.F, 1), (self.E, 2), (self.H, 2)):
            for cell in [cell for cell in plane if not self.inside(cell, side)]:
                del plane[cell]

    def beam(self, kind, start, end, weight):
        if [x // 16 for x in start] == [x // 16 for x in end]:
            return
        axis = major_axis(start, end)
        dx, dy = 2 * (end[axis] - start[axis]), 2 * (end[1 - axis] - start[1 - axis])
        sign = 1 if dx > 0 else -1
        length = math.floor(weight * math.sqrt(float(dx * dx + dy * dy)) / abs(dx) + 0.5)
        first, last = start[axis] // 16, end[axis] // 16
        columns = list(range(first + sign, last + sign, sign))
        if kind == HIT:
            columns = [column for column in columns if abs(last - column) >= 2]
        for column in columns:
            cell = self.placed(axis, column, on_line(start, end, axis, 32 * column + 16, 32))
            if kind == NO_RETURN:
                self.F[cell] = min(self.F[cell] + 1, 65535)
            else:
                self.N[cell] += length
        if kind == HIT:
            self.hit(axis, sign, start, end, weight, length)

    def hit(self, axis, sign, start, end, weight, length):
        first, last = start[axis] // 16, end[axis] // 16
        here, there = start[axis] // 8, end[axis] // 8
        for column in range(here, there, sign):
            if column // 2 in (last - sign, last) and column // 2 != first:
                self.E[self.placed(axis, column, on_line(start, end, axis, 16 * column + 8, 16))] += length
        b = 2 * end[axis] + 1
        part = b - 16 * there if sign > 0 else 16 * (there + 1) - b
        part = min(part, 2 * abs(end[axis] - start[axis]))
        self.E[end[0] // 8, end[1] // 8] += (length * part + 8) >> 4
        for i in (0, 1):
            for j in (0, 1):
                # The centre of half i lies at 8 i + 4; shares fall off evenly with the distance to it.
                cell = (end[0] - 4) // 8 + i, (end[1] - 4) // 8 + j
                share = math.prod(8 - abs(end[n] - 8 * cell[n] - 4) for n in (0, 1))
                if share:
                    self.H[cell] += share * weight

    @staticmethod
    def placed(axis, along, across):
        return (along, across) if axis == 0 else (across, along)

    def cells(self):
        """Every cell in which something was counted."""
        halves = {(i // 2, j // 2) for plane in (self.E, self.H) for (i, j), count in plane.items() if count}
        return halves | {cell for plane in (self.N, self.F) for cell, count in plane.items() if count}

    def probability(self, i, j):
        """p of a half, None where unknown."""
        passing = {cell: self.N[cell[0] // 2, cell[1] // 2] + 2 * self.E[cell] for cell in square(i, j, 2)}
        kernel = {-1: 1, 0: 4, 1: 1}
        hits = {
            (x, y): sum(kernel[u] * kernel[v] * self.H[x + u, y + v] for u in kernel for v in kernel)
            for x, y in square(i, j, 2)
        }
        raw = {cell: self.H[cell] for cell in square(i, j, 1)}
        for radius in (1, 2):
            n, h = (sum(values[cell] for cell in square(i, j, radius)) for values in (passing, hits))
            if n or h:
                mean = (h / 36864 + 0.005) / (n / 32 + 0.05)
                rate = (hits[i, j] / 36864 + mean) / (passing[i, j] / 32 + 1)
                return cautious(1 - math.exp(-4 * rate), (i, j), passing, raw)
        return 0.02 if self.F[i // 2, j // 2] >= 2 else None

    def probability_of_cell(self, i, j):
        """p of a cell, of all that was counted in it; None where unknown."""

        def together(plane, cell):
            return sum(plane[2 * cell[0] + x, 2 * cell[1] + y] for x in (0, 1) for y in (0, 1))

        passing = {cell: 2 * self.N[cell] + together(self.E, cell) for cell in square(i, j, 1)}
        hits = {cell: together(self.H, cell) for cell in square(i, j, 1)}
        n, h = sum(passing.values()), sum(hits.values())
        if n or h:
            mean = (h / 1024 + 0.005) / (n / 32 + 0.05)
            rate = (hits[i, j] / 1024 + 0.25 * mean) / (passing[i, j] / 32 + 0.25)
            return cautious(1 - math.exp(-2 * rate), (i, j), passing, hits)
        return 0.02 if self.F[i, j] >= 2 else None


def square(i, j, radius):
    around = range(-radius, radius + 1)
    return [(i + x, j + y) for x in around for y in around]


def cautious(p, cell, passing, hits):
    """Rule 5: what only its neighbours speak for is at most 0.65, unless three of them do."""
    counted = [near for near in square(*cell, 1) if passing[near] or hits[near]]
    return 0.65 if p > 0.65 and cell not in counted and len(counted) < 3 else p


def dense(plane, rect, side=1):
    """Counts of a plane as an array over a rectangle of cells, which holds all that are not 0."""
    found = np.zeros((rect.height * side, rect.width * side), np.int64)
    for (i, j), count in plane.items():
        x, y = i - rect.ix * side, j - rect.iy * side
        if count:
            assert min(x, y) >= 0
            found[y, x] = count
    return found


def assert_planes(grid, twin):
    """Every number of a grid is that of its twin."""
    planes = grid.snapshot().stored.planes()
    assert np.array_equal(planes["N"] + (planes["C"].astype(np.int64) << 16), dense(twin.N, grid.rect))
    assert np.array_equal(planes["F"], dense(twin.F, grid.rect))
    assert np.array_equal(planes["E"], dense(twin.E, grid.rect, 2))
    assert np.array_equal(planes["H"], dense(twin.H, grid.rect, 2))
