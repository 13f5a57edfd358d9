"""The slow, obvious judge: a map and held-out beams, by the definitions, in plain Python.

A map is a dictionary (ix, iy) -> (log odds, probability) of its known cells; a ray is (x, y, bearing, range).
"""

import math
from collections import Counter
from itertools import pairwise

import numpy as np

R, OCCUPIED, FREE = 20.0, 0.65, 0.196


def crossed(u, v, bearing, longest):
    """Cells of a ray in order, with the lengths at which it enters and leaves each, all in cells."""
    du, dv = math.cos(bearing), math.sin(bearing)
    cuts = {0.0, longest}
    for start, along in ((u, du), (v, dv)):
        for line in range(math.floor(start - longest) - 1, math.ceil(start + longest) + 2):
            at = (line - start) / along if along else -1.0
            if 0.0 < at < longest:
                cuts.add(at)
    cuts = sorted(cuts)
    for enter, leave in pairwise(cuts):
        middle = (enter + leave) / 2
        yield (math.floor(u + middle * du), math.floor(v + middle * dv)), enter, leave


class NaiveJudge:
    """A map of `resolution`, its lattice anchored at (0, 0)."""

    def __init__(self, cells, resolution, edges):
        self.cells, self.resolution, self.edges = cells, resolution, edges

    def bin_of(self, cell):
        if cell not in self.cells:
            return "unknown"
        return sum(edge <= min(max(self.cells[cell][0], -30.0), 30.0) for edge in self.edges)

    def beam(self, ray, rates):
        """Of every cell on the way, to 20 m: its bin, length, m_i N_i; and f, and what is left."""
        x, y, bearing, r = ray
        left, parts, f = 1.0, [], 0.0
        for cell, enter, leave in crossed(
            x / self.resolution, y / self.resolution, bearing, R / self.resolution
        ):
            length, middle = (leave - enter) * self.resolution, (leave + enter) / 2 * self.resolution
            rate = rates[self.bin_of(cell)]
            mass = left * (1.0 - math.exp(-rate * length))
            left *= math.exp(-rate * length)
            sigma = math.sqrt(0.05**2 + length**2 / 12)
            density = 0.0
            if r < R and abs(r - middle) < 6 * sigma + self.resolution:
                density = math.exp(-((r - middle) ** 2) / (2 * sigma**2)) / math.sqrt(2 * math.pi * sigma**2)
            parts.append((self.bin_of(cell), length, mass * density))
            f += mass * density
        return parts, f, left

    def probability(self, ray, rates):
        _, f, left = self.beam(ray, rates)
        return 0.95 * f + 0.05 / 40 if ray[3] < R else 0.95 * left + 0.025

    def fit(self, rays, readings):
        bins = len(self.edges) + 1
        rates = dict(enumerate(np.geomspace(0.02, 20.0, bins).tolist())) | {"unknown": 0.3}
        for _ in range(5):
            ends, metres = Counter(), Counter()
            for ray in rays:
                parts, f, left = self.beam(ray, rates)
                p = self.probability(ray, rates)
                inlier = 0.95 * (f if ray[3] < R else left) / p
                before = 0.0
                for b, length, part in parts:
                    q = part / f if ray[3] < R else 0.0
                    ends[b] += inlier * q
                    metres[b] += inlier * (1.0 - before - q / 2) * length
                    before += q
            scale = 1e4 / readings
            blocks = []
            for b in range(bins):
                blocks.append([ends[b] * scale + 1e-3, metres[b] * scale + 1e-2, 1])
                while len(blocks) > 1 and blocks[-2][0] / blocks[-2][1] >= blocks[-1][0] / blocks[-1][1]:
                    n, x, count = blocks.pop()
                    blocks[-1] = [blocks[-1][0] + n, blocks[-1][1] + x, blocks[-1][2] + count]
            values = [n / x for n, x, count in blocks for _ in range(count)]
            rates = dict(enumerate(values))
            rates["unknown"] = (ends["unknown"] * scale + 0.01) / (metres["unknown"] * scale + 0.1)
        return rates

    def bits(self, scans, readings):
        """Bits a beam; `scans` is a list of lists of rays, `readings` how many beams each scan had."""
        nats = []
        for half in (0, 1):
            fit = [n for n in range(len(scans)) if n // 2 % 2 == half]
            rates = self.fit([ray for n in fit for ray in scans[n]], sum(readings[n] for n in fit))
            score = [ray for n, scan in enumerate(scans) if n not in fit for ray in scan]
            nats += [-math.log(self.probability(ray, rates)) for ray in score]
        ranges = [ray[3] for scan in scans for ray in scan]
        h = sum(r < R for r in ranges) / sum(min(r, R) for r in ranges)
        empty = [
            -math.log(0.95 * h * math.exp(-h * r) + 0.05 / 40 if r < R else 0.95 * math.exp(-h * R) + 0.025)
            for r in ranges
        ]
        return (sum(empty) - sum(nats)) / len(ranges) / math.log(2)

    def first_walls(self, rays):
        """Shares (hit, unknown, short, long, false_free)."""
        counts, judged = Counter(), [ray for ray in rays if ray[3] < 15.0]
        for ray in judged:
            x, y, bearing, r = ray
            counts[self.outcome(ray)] += 1
            end = (x + r * math.cos(bearing)) / self.resolution, (y + r * math.sin(bearing)) / self.resolution
            cell = tuple(map(math.floor, end))
            near = [
                other
                for other, (_, p) in self.cells.items()
                if p > OCCUPIED
                and math.hypot(*(max(a - e, e - a - 1, 0.0) for a, e in zip(other, end, strict=True)))
                <= 0.1 / self.resolution
            ]
            counts["false_free"] += cell in self.cells and self.cells[cell][1] < FREE and not near
        return [counts[name] / len(judged) for name in ("hit", "unknown", "short", "long", "false_free")]

    def outcome(self, ray):
        x, y, bearing, r = ray
        way = list(crossed(x / self.resolution, y / self.resolution, bearing, R / self.resolution))
        for cell, enter, _ in way[1:]:
            if cell not in self.cells:
                return "unknown"
            if self.cells[cell][1] > OCCUPIED:
                d = enter * self.resolution - r
                return "hit" if abs(d) < 0.1 else "short" if d < -0.2 else "long" if d > 0.2 else "near"
        return "long"
