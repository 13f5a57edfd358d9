"""The slow, obvious twin of every kernel: plain Python, straight from the definitions."""

import math
from fractions import Fraction
from itertools import pairwise

import numpy as np

from ogm_core.cells.log_odds import PLANE


def classify(r, range_min, range_max, alpha, clear_range=math.inf, reach=math.inf):
    """None for a beam without evidence, else (is a hit, length)."""
    if math.isnan(r) or r == -math.inf or r <= 0 or r < range_min:
        return None
    if r != math.inf and r > range_max * (1 + 1e-6):
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
    """For every beam that counts: (start cell, end cell, is a hit, line); `pose` may be one for every beam.

    The line is (u, v) of the start and the end point, in cells.
    """
    for k, reading in enumerate(scan.ranges):
        beam = classify(float(reading), scan.range_min, scan.range_max, alpha, clear_range, reach)
        if beam is None:
            continue
        hit, length = beam
        x, y, theta = pose[k] if np.ndim(pose) == 2 else pose
        bearing = theta + (scan.angle_min + k * scan.angle_increment)
        ex, ey = x + length * math.cos(bearing), y + length * math.sin(bearing)
        line = [(value - anchor[n % 2]) / resolution for n, value in enumerate((x, y, ex, ey))]
        u0, v0, u1, v1 = map(math.floor, line)
        yield (u0, v0), (u1, v1), hit, line


def observed(scan, pose, settings):
    """The observations of a scan in a map with these settings."""
    lattice = settings.lattice
    return observations(
        scan,
        pose,
        resolution=lattice.resolution,
        anchor=lattice.anchor,
        alpha=settings.alpha,
        clear_range=math.inf if settings.clear_range is None else settings.clear_range,
        reach=math.inf if settings.reach is None else settings.reach,
    )


def evidence(start, end, hit, line, traversal="bresenham"):
    """(cell, occupied?) for every cell that the beam updates, in order."""
    path = bresenham(*start, *end) if traversal == "bresenham" else list(crossed(*line))
    path = [cell for cell in path if cell not in (start, end)]
    for cell in path:
        yield cell, False
    if end != start:
        yield end, hit


class Map:
    """A dictionary from cell to log odds: float64, or whole steps relative to the prior for int16."""

    def __init__(self, settings):
        self.settings, model = settings, settings.cell_model
        self.lattice, self.bounds = settings.lattice, settings.bounds_rect
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
        for start, end, hit, line in observed(scan, pose, settings):
            if settings.outside == "drop" and not (self.inside(start) and self.inside(end)):
                continue
            for cell, occupied in evidence(start, end, hit, line, settings.traversal):
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


def scaled(*values):
    """Numbers as integers: exactly their multiples of one unit, 1 / scale; (scale, integers)."""
    ratios = [value.as_integer_ratio() for value in values]
    scale = math.lcm(*(denominator for _, denominator in ratios))
    return scale, [numerator * (scale // denominator) for numerator, denominator in ratios]


def crossed(u0, v0, u1, v1):
    """Cells that a segment crosses, with the length inside each, in exact arithmetic: {cell: length squared}.

    Coordinates are in cells: floats, or Fractions. The segment is cut at every grid line that it crosses; a
    piece lies in the cell that holds its midpoint. Every number is an integer: coordinates in units of
    1 / scale, and how far along the segment a cut is in units of 1 / end.
    """
    scale, (u0, v0, u1, v1) = scaled(u0, v0, u1, v1)
    du, dv = u1 - u0, v1 - v0
    end = (abs(du) or 1) * (abs(dv) or 1)
    twice_u, twice_v, one = 2 * end * u0, 2 * end * v0, 2 * end * scale
    squared, unit_squared = du * du + dv * dv, (end * scale) ** 2
    cuts = {0, end}
    for start, d in ((u0, du), (v0, dv)):
        if d:
            low, high = sorted((start, start + d))
            lines = range(-(-low // scale), high // scale + 1)
            cuts.update((line * scale - start) * (end // d) for line in lines)
    found = {}
    for t0, t1 in pairwise(sorted(cuts)):
        cell = (twice_u + (t0 + t1) * du) // one, (twice_v + (t0 + t1) * dv) // one
        # A segment along a grid line crosses one cell only, the one that holds it.
        found[cell] = Fraction((t1 - t0) ** 2 * squared, unit_squared)
    return found


def near(cell, u0, v0, u1, v1, slack):
    """Whether a segment comes within `slack` of a cell's closed square, in exact arithmetic.

    The segment is clipped to the square grown by the slack (Liang & Barsky 1984): at its corners that is up
    to 1.42 slack away. Every number is an integer, as in `crossed`.
    """
    scale, (u0, v0, u1, v1, slack) = scaled(u0, v0, u1, v1, slack)
    du, dv = u1 - u0, v1 - v0
    end = (abs(du) or 1) * (abs(dv) or 1)
    first, last = 0, end
    for start, d, low in ((u0, du, cell[0] * scale), (v0, dv, cell[1] * scale)):
        near_edge, far_edge = low - slack - start, low + scale + slack - start
        if d == 0:
            if not near_edge <= 0 <= far_edge:
                return False
            continue
        t0, t1 = sorted((near_edge * (end // d), far_edge * (end // d)))
        first, last = max(first, t0), min(last, t1)
    return first <= last


def footprint_distance_squared(corners, cell):
    """Squared distance of a closed polygon, or of a point, from a cell's closed square, in exact arithmetic.

    Corners are in cells. The polygon is even-odd: with no edge in the square, its centre says which side.
    """
    corners = [(Fraction(u), Fraction(v)) for u, v in corners]
    (i, j), edges = cell, list(zip(corners, corners[1:] + corners[:1], strict=True))
    square = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
    if any(near(cell, *a, *b, Fraction(0)) for a, b in edges):
        return 0
    cu, cv = i + Fraction(1, 2), j + Fraction(1, 2)
    crossings = [
        u0 + (cv - v0) * (u1 - u0) / (v1 - v0) for (u0, v0), (u1, v1) in edges if (v0 <= cv) != (v1 <= cv)
    ]
    if sum(u > cu for u in crossings) % 2:
        return 0
    return min(
        *(point_to_segment(corner, *edge) for edge in edges for corner in square),
        *(
            point_to_segment(corner, *side)
            for corner in corners
            for side in zip(square, square[1:] + square[:1], strict=True)
        ),
    )


def point_to_segment(point, a, b):
    """Squared distance, exact."""
    (u, v), (au, av), (bu, bv) = point, a, b
    du, dv = bu - au, bv - av
    squared = du * du + dv * dv
    t = 0 if squared == 0 else min(max(Fraction((u - au) * du + (v - av) * dv) / squared, 0), 1)
    return (au + t * du - u) ** 2 + (av + t * dv - v) ** 2


def sector_class(dx, dy, theta, bearings, half, kinds, lengths, alpha):
    """What a scan says about a point at (dx, dy) m from its sensor: 0 nothing, 1 free, 2 occupied.

    The nearest beam decides; of beams whose bearings differ by rounding only, the first one. `kinds` 0
    skipped, 1 no return, 2 hit.
    """
    rho = math.hypot(dx, dy)
    if rho == 0.0:
        return 0
    phi = math.atan2(dy, dx)
    best, nearest = 0, 100.0
    for k in range(len(bearings)):
        turn = (phi - (theta + bearings[k])) / (2 * math.pi)
        away = abs(turn - math.floor(turn + 0.5)) * 2 * math.pi
        if away < nearest - 1e-12:
            best, nearest = k, away
    if nearest > half or kinds[best] == 0:
        return 0
    if kinds[best] == 2 and abs(rho - lengths[best]) <= alpha / 2:
        return 2
    free = lengths[best] - alpha / 2 if kinds[best] == 2 else lengths[best]
    return 1 if rho <= free else 0


def value_byte(p, known):
    """The byte of one cell: its probability, kept within its class."""
    if not known:
        return 0
    byte = 1 + math.floor(254 * p + 0.5)
    if p < 0.196:
        return min(byte, 50)
    if p > 0.65:
        return max(byte, 167)
    return min(max(byte, 51), 166)


def joined(*value_bytes):
    """What stands for a block of cells: the highest if that is occupied, else the lowest that is known."""
    if max(value_bytes) >= 167:
        return max(value_bytes)
    return min((byte for byte in value_bytes if byte), default=0)


def halved(pixels):
    """Every four pixels as one, from an array of value bytes with even sides."""
    height, width = pixels.shape
    return np.array(
        [
            [joined(*pixels[y : y + 2, x : x + 2].ravel().tolist()) for x in range(0, width, 2)]
            for y in range(0, height, 2)
        ],
        np.uint8,
    )


def stored(store, rect):
    """The stored cells of a rectangle inside a TileStore, by each one's address; shape (height, width)."""
    i = rect.ix - store.rect.ix + np.arange(rect.width)
    j = rect.iy - store.rect.iy + np.arange(rect.height)
    plane = store.planes[PLANE]
    return plane.cells[plane.column[i] + 64 * j[:, None]]
