"""The slow, obvious twin of every kernel: plain Python, straight from the definitions."""

import math
from itertools import pairwise

import numpy as np


def classify(r, range_min, range_max, alpha, clear_range=math.inf, reach=math.inf):
    """None for a beam without evidence, else (is a hit, length)."""
    if math.isnan(r) or r == -math.inf or r <= 0 or r < range_min:
        return None
    if r >= range_max:
        return False, min(range_max, clear_range, reach)
    if r >= range_max - alpha / 2:
        return False, min(r, clear_range, reach)
    if r > reach:
        return False, reach
    return True, r


def bresenham(i0, j0, i1, j1):
    """Cells from (i0, j0) to (i1, j1), both included, by the integer error form."""
    di, dj = abs(i1 - i0), abs(j1 - j0)
    si, sj = (1 if i0 < i1 else -1), (1 if j0 < j1 else -1)
    i, j, err = i0, j0, di - dj
    cells = [(i, j)]
    while (i, j) != (i1, j1):
        e2 = 2 * err
        if e2 > -dj:
            err -= dj
            i += si
        if e2 < di:
            err += di
            j += sj
        cells.append((i, j))
    return cells


def observations(scan, pose, *, resolution, anchor=(0.0, 0.0), alpha, clear_range=math.inf, reach=math.inf):
    """For every beam that counts: (start cell, end cell, is a hit)."""
    x, y, theta = pose
    start = math.floor((x - anchor[0]) / resolution), math.floor((y - anchor[1]) / resolution)
    for k, reading in enumerate(scan.ranges):
        beam = classify(float(reading), scan.range_min, scan.range_max, alpha, clear_range, reach)
        if beam is None:
            continue
        hit, length = beam
        bearing = theta + (scan.angle_min + k * scan.angle_increment)
        ex, ey = x + length * math.cos(bearing), y + length * math.sin(bearing)
        end = math.floor((ex - anchor[0]) / resolution), math.floor((ey - anchor[1]) / resolution)
        yield start, end, hit


def observed(scan, pose, settings):
    """The observations of a scan in a map with these settings."""
    lattice, _ = settings.lattice()
    return observations(
        scan,
        pose,
        resolution=lattice.resolution,
        anchor=lattice.anchor,
        alpha=settings.alpha,
        clear_range=math.inf if settings.clear_range is None else settings.clear_range,
        reach=math.inf if settings.reach is None else settings.reach,
    )


def evidence(start, end, hit):
    """(cell, occupied?) for every cell that the beam updates, in order."""
    path = bresenham(*start, *end)[1:]
    for cell in path[:-1]:
        yield cell, False
    if path:
        yield path[-1], hit


class Map:
    """A dictionary from cell to log odds: float64, or whole steps relative to the prior for int16."""

    def __init__(self, settings):
        self.settings, model = settings, settings.model
        self.lattice, self.bounds = settings.lattice()
        self.l0 = logit(model.p_prior)
        self.cells = {}
        d_free, d_occ = logit(model.p_free) - self.l0, logit(model.p_occ) - self.l0
        if model.cells == "float64":
            self.start, self.step = self.l0, None
            self.d_free, self.d_occ, self.lower, self.upper = d_free, d_occ, model.l_min, model.l_max
        else:
            self.start, self.step = 0, max(model.l_max - self.l0, self.l0 - model.l_min) / 16383
            self.d_free, self.d_occ = round(d_free / self.step), round(d_occ / self.step)
            self.lower = round((model.l_min - self.l0) / self.step)
            self.upper = round((model.l_max - self.l0) / self.step)

    def inside(self, cell):
        if self.bounds is None:
            return True
        return 0 <= cell[0] < self.bounds.width and 0 <= cell[1] < self.bounds.height

    def integrate(self, scan, pose):
        settings = self.settings
        updates = 0
        for start, end, hit in observed(scan, pose, settings):
            if settings.outside == "drop" and not (self.inside(start) and self.inside(end)):
                continue
            for cell, occupied in evidence(start, end, hit):
                if self.inside(cell):
                    d = self.d_occ if occupied else self.d_free
                    total = self.cells.get(cell, self.start) + d
                    self.cells[cell] = min(max(total, self.lower), self.upper)
                    updates += 1
        return updates

    def log_odds(self, offset, width, height):
        """Float64 array [iy, ix] of the rectangle of cells, NaN where never updated."""
        dense = np.full((height, width), np.nan)
        for (ix, iy), value in self.cells.items():
            l_cell = value if self.step is None else self.l0 + value * self.step
            dense[iy - offset[1], ix - offset[0]] = l_cell
        return dense


def cast(u, v, bearing, longest, belief):
    """Where a ray from (u, v) first leaves what is free: ("wall" | "unknown" | "nothing", length), in cells.

    `belief(cell)` is "wall", "free" or "unknown". Every crossing with a grid line is listed and sorted; the
    cell between two crossings is the one that holds their midpoint.
    """
    du, dv = math.cos(bearing), math.sin(bearing)
    lines = range(-math.ceil(longest) - 2, math.ceil(longest) + 3)
    crossings = sorted(
        t
        for start, d in ((u, du), (v, dv))
        if d != 0.0
        for line in lines
        if (t := (math.floor(start) + line - start) / d) > 0.0
    )
    for entered, left in pairwise(crossings):
        if entered > longest:
            break
        middle = (entered + left) / 2
        found = belief((math.floor(u + middle * du), math.floor(v + middle * dv)))
        if found != "free":
            return found, entered
    return "nothing", longest


def logit(p):
    p = min(max(p, 1e-9), 1 - 1e-9)
    return math.log(p / (1 - p))
