"""The slow, obvious twin of quality.truth: every cell against every obstacle, from the definitions."""

import math
from fractions import Fraction


def is_occupied(world, lattice, cell, slack=1e-9, number=Fraction):
    """Whether an outline meets the closed square of a cell, widened by `slack` cells."""

    def in_cells(values):
        return [
            (number(value) - number(lattice.anchor[n % 2])) / number(lattice.resolution)
            for n, value in enumerate(values)
        ]

    box = [(number(index) - number(slack), number(index) + 1 + number(slack)) for index in cell]
    for circle in world.circles.tolist():
        centre, r = in_cells(circle[:2]), number(circle[2]) / number(lattice.resolution)
        nearest = sum(max(low - c, 0, c - high) ** 2 for c, (low, high) in zip(centre, box, strict=True))
        farthest = sum(max(c - low, high - c) ** 2 for c, (low, high) in zip(centre, box, strict=True))
        if nearest <= r * r <= farthest:
            return True
    return any(_meets(in_cells(segment), box) for segment in world.segments.tolist())


def _meets(segment, box):
    """Whether no line separates a segment and a box: none along an axis, nor along the segment."""
    x1, y1, x2, y2 = segment
    (left, right), (bottom, top) = box
    if max(x1, x2) < left or min(x1, x2) > right or max(y1, y2) < bottom or min(y1, y2) > top:
        return False
    sides = [(x2 - x1) * (y - y1) - (y2 - y1) * (x - x1) for x in (left, right) for y in (bottom, top)]
    return min(sides) <= 0 <= max(sides)


def truth_figures(probabilities, is_true):
    """The figures of a map {cell: p} of known cells; `is_true(cell)` says what is truly occupied."""

    def around(cell):
        return [(cell[0] + dx, cell[1] + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]

    truth = {cell for known in probabilities for cell in around(known) if is_true(cell)}
    occupied = {cell for cell, p in probabilities.items() if p > 0.65}
    right = [(p > 0.5) == (cell in truth) for cell, p in probabilities.items()]
    losses = []
    for cell, p in probabilities.items():
        p = min(max(p, 1e-9), 1 - 1e-9)
        losses.append(-math.log(p if cell in truth else 1 - p))
    found = [any(near in truth for near in around(cell)) for cell in occupied]
    seen = [any(near in occupied for near in around(cell)) for cell in truth]
    judged = len(found) + seen.count(False)
    return {
        "accuracy": sum(right) / len(right) if right else None,
        "precision": sum(found) / len(found) if found else None,
        "recall": sum(seen) / len(seen) if seen else None,
        "iou": sum(found) / judged if judged else None,
        "log_loss": sum(losses) / len(losses) if losses else None,
    }
