"""Transforms by 4 x 4 matrices, and tf trees by lists: what `ogm_core.ros2.tf_tree` answers, slowly."""

import math
from itertools import pairwise

import numpy as np


def matrix(transform):
    x, y, z, a, b, c, w = transform
    found = np.eye(4)
    cross = np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]])
    found[:3, :3] += 2 * w * cross + 2 * cross @ cross
    found[:3, 3] = x, y, z
    return found


def about(axis, angle):
    """A rotation about an axis: Rodrigues' formula."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def between(one, other, fraction):
    """What lies between two matrices: along the line, and about the axis that turns the one to the other."""
    found = np.eye(4)
    found[:3, 3] = one[:3, 3] + fraction * (other[:3, 3] - one[:3, 3])
    turn = one[:3, :3].T @ other[:3, :3]
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    angle = math.atan2(np.linalg.norm(axis) / 2, (np.trace(turn) - 1) / 2)
    found[:3, :3] = one[:3, :3] @ (
        about(axis, fraction * angle) if np.linalg.norm(axis) > 1e-12 else np.eye(3)
    )
    return found


def planar(found):
    return found[0, 3], found[1, 3], math.atan2(found[1, 0], found[0, 0])


def lookup(samples, fixed, frame, stamp):
    """`samples`: by child, its parent and (stamp, transform) each, one for a static edge, in order."""
    found = np.eye(4)
    while frame != fixed:
        parent, edge = samples[frame]
        if len(edge) == 1:
            step = matrix(edge[0][1])
        else:
            (t0, one), (t1, other) = next(
                pair for pair in pairwise(edge) if pair[0][0] <= stamp <= pair[1][0]
            )
            step = between(matrix(one), matrix(other), (stamp - t0) / (t1 - t0))
        found, frame = step @ found, parent
    return found
