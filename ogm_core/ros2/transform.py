"""Rigid transforms in 3D, in plain floats: a scan needs about five of them, for which arrays cost more."""

import math
from typing import NamedTuple

from ogm_core.errors import BadMessage
from ogm_core.placing.pose_history import NEAR_M, NEAR_RAD
from ogm_core.types import Pose

UNIT_WITHIN = 0.01
"""The squared length of a rotation's quaternion may differ so much from 1, as tf2 takes it."""
FARTHEST_M = 1e9
"""No frame is farther away from another one."""
_ALMOST_PARALLEL = 1e-6
_ROUNDING = 1e-15


class Transform(NamedTuple):
    """A child frame's position (m) and rotation (unit quaternion) in its parent frame."""

    x: float
    y: float
    z: float
    qx: float
    qy: float
    qz: float
    qw: float

    def compose(self, child: "Transform") -> "Transform":
        """The transform of `child`, given in this frame, in the frame that this one is given in."""
        x, y, z, a, b, c, w = self
        px, py, pz, d, e, f, v = child
        # v + 2 w (q x v) + 2 q x (q x v)
        tx, ty, tz = 2.0 * (b * pz - c * py), 2.0 * (c * px - a * pz), 2.0 * (a * py - b * px)
        return Transform(
            x + px + w * tx + b * tz - c * ty,
            y + py + w * ty + c * tx - a * tz,
            z + pz + w * tz + a * ty - b * tx,
            w * d + a * v + b * f - c * e,
            w * e - a * f + b * v + c * d,
            w * f + a * e - b * d + c * v,
            w * v - a * d - b * e - c * f,
        )

    def inverse(self) -> "Transform":
        """The parent frame in the child's."""
        x, y, z, a, b, c, w = self
        turned = Transform(0.0, 0.0, 0.0, -a, -b, -c, w)
        px, py, pz = turned.compose(Transform(-x, -y, -z, 0.0, 0.0, 0.0, 1.0))[:3]
        return Transform(px, py, pz, -a, -b, -c, w)

    def between(self, other: "Transform", fraction: float) -> "Transform":
        """What lies `fraction` of the way to another one: linear in position, by the shorter arc in rotation.

        At 0 and 1 it is the one or the other, but for the sign of a quaternion.
        """
        x, y, z, a, b, c, w = self
        px, py, pz, d, e, f, v = other
        cosine = a * d + b * e + c * f + w * v
        if cosine < 0.0:
            cosine, d, e, f, v = -cosine, -d, -e, -f, -v
        angle = math.acos(min(cosine, 1.0))
        if angle < _ALMOST_PARALLEL:
            s, t = 1.0 - fraction, fraction
        else:
            s, t = (math.sin(part * angle) / math.sin(angle) for part in (1.0 - fraction, fraction))
        return Transform(
            x + fraction * (px - x),
            y + fraction * (py - y),
            z + fraction * (pz - z),
            s * a + t * d,
            s * b + t * e,
            s * c + t * f,
            s * w + t * v,
        )

    def near(self, other: "Transform") -> bool:
        """Whether another one is so close that what lies between them does not matter: 1 cm, 0.5 degrees."""
        if math.dist(self[:3], other[:3]) > NEAR_M:
            return False
        cosine = sum(one * two for one, two in zip(self[3:], other[3:], strict=True))
        return 2.0 * math.acos(min(abs(cosine), 1.0)) <= NEAR_RAD

    @property
    def upright(self) -> float:
        """Cosine of the angle between the two frames' z axes: 1 level, -1 upside down (R22)."""
        return 1.0 - 2.0 * (self.qx * self.qx + self.qy * self.qy)

    def planar(self) -> Pose:
        """Position without height, and the heading of the x axis seen from above: atan2(R10, R00)."""
        _, _, _, a, b, c, w = self
        heading = math.atan2(2.0 * (a * b + w * c), 1.0 - 2.0 * (b * b + c * c))
        return Pose(self.x, self.y, heading)


def level(pose: Pose) -> Transform:
    """The transform of a pose on the floor, upright."""
    half = pose.theta / 2.0
    return Transform(pose.x, pose.y, 0.0, 0.0, 0.0, math.sin(half), math.cos(half))


IDENTITY = Transform(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def unit(transform: Transform) -> Transform:
    """The same transform, checked, with a quaternion of length 1.

    Raises:
        BadMessage: a number is not finite or too large, or the quaternion is no rotation, as four zeros.
    """
    x, y, z, a, b, c, w = transform
    square = a * a + b * b + c * c + w * w
    # Neither NaN nor inf is within.
    if not (abs(x) <= FARTHEST_M and abs(y) <= FARTHEST_M and abs(z) <= FARTHEST_M and square < math.inf):
        raise BadMessage(f"transform: finite numbers are needed, up to {FARTHEST_M:g} m")
    if abs(square - 1.0) > UNIT_WITHIN:
        raise BadMessage(
            "rotation: a quaternion (x, y, z, w) of length 1 is needed, got "
            f"({a:g}, {b:g}, {c:g}, {w:g}); none is (0, 0, 0, 1)"
        )
    if abs(square - 1.0) <= _ROUNDING:
        return transform
    length = math.sqrt(square)
    return Transform(x, y, z, a / length, b / length, c / length, w / length)
