"""Foxglove's messages of robots: transforms, arrows with names, scans."""

import colorsys
import math
from collections.abc import Iterable
from zlib import crc32

import numpy as np
from foxglove.messages import (
    ArrowPrimitive,
    Color,
    FrameTransform,
    FrameTransforms,
    LaserScan,
    Quaternion,
    SceneEntity,
    SceneEntityDeletion,
    SceneUpdate,
    TextPrimitive,
    Timestamp,
    Vector3,
)
from foxglove.messages import Pose as FoxglovePose

from ogm_core.ros2.cdr import LAST_STAMP
from ogm_core.ros2.mcap_recording import MAP_FRAME, base_frame
from ogm_core.types import Pose, Scan

ARROW = (0.35, 0.12, 0.2, 0.28)
"""Length and diameter of an arrow's shaft and of its head, m."""
NAME_SIZE = 14.0
"""Height of a robot's name, pixels."""
NAME_ABOVE = 0.4
"""How high over the floor it stands, m."""
_SECOND = 1_000_000_000

Located = tuple[str, int, Pose]
"""A robot, the stamp of a pose of it, ns, and that pose in the map frame."""


def transforms(poses: Iterable[Located]) -> FrameTransforms:
    """Where robots' bases are in the map frame."""
    return FrameTransforms(
        transforms=[
            FrameTransform(
                timestamp=_time(stamp),
                parent_frame_id=MAP_FRAME,
                child_frame_id=base_frame(robot),
                translation=Vector3(x=pose.x, y=pose.y, z=0.0),
                rotation=_turned(pose.theta),
            )
            for robot, stamp, pose in poses
        ]
    )


def scene(poses: Iterable[Located], gone: Iterable[str] = ()) -> SceneUpdate:
    """An arrow and a name for each robot, in place of the ones before; those of robots that are gone end."""
    return SceneUpdate(
        deletions=[SceneEntityDeletion(id=robot) for robot in gone],
        entities=[_entity(robot, stamp, pose) for robot, stamp, pose in poses],
    )


def laser_scan(robot: str, scan: Scan) -> LaserScan:
    """A scan where its sensor sits: on its robot's base, or in the map if it says itself where that was.

    Beams that ended nowhere between its range_min and range_max are no points: NaN.
    """
    frame, pose = base_frame(robot), scan.mount
    if scan.pose is not None:
        frame, pose = MAP_FRAME, scan.pose.compose(scan.mount)
    ended = (scan.ranges >= scan.range_min) & (scan.ranges < scan.range_max)
    return LaserScan(
        timestamp=_time(scan.stamp),
        frame_id=frame,
        pose=_pose(pose),
        start_angle=scan.angle_min,
        end_angle=scan.angle_min + (scan.ranges.size - 1) * scan.angle_increment,
        ranges=np.where(ended, scan.ranges, np.nan).tolist(),
    )


def _entity(robot: str, stamp: int, pose: Pose) -> SceneEntity:
    shaft_length, shaft_diameter, head_length, head_diameter = ARROW
    color = _color(robot)
    return SceneEntity(
        timestamp=_time(stamp),
        frame_id=MAP_FRAME,
        id=robot,
        arrows=[
            ArrowPrimitive(
                pose=_pose(pose),
                shaft_length=shaft_length,
                shaft_diameter=shaft_diameter,
                head_length=head_length,
                head_diameter=head_diameter,
                color=color,
            )
        ],
        texts=[
            TextPrimitive(
                pose=_pose(pose, NAME_ABOVE),
                billboard=True,
                font_size=NAME_SIZE,
                scale_invariant=True,
                color=color,
                text=robot,
            )
        ],
    )


def _color(robot: str) -> Color:
    """A colour of a robot's own, the same wherever and whenever it is shown."""
    hue = crc32(robot.encode()) / 2**32
    r, g, b = colorsys.hls_to_rgb(hue, 0.5, 0.9)
    return Color(r=r, g=g, b=b, a=1.0)


def _pose(pose: Pose, z: float = 0.0) -> FoxglovePose:
    return FoxglovePose(position=Vector3(x=pose.x, y=pose.y, z=z), orientation=_turned(pose.theta))


def _turned(theta: float) -> Quaternion:
    return Quaternion(x=0.0, y=0.0, z=math.sin(theta / 2.0), w=math.cos(theta / 2.0))


def _time(stamp: int) -> Timestamp:
    return Timestamp(*divmod(min(stamp, LAST_STAMP), _SECOND))
