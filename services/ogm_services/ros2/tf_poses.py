"""Poses from tf: a tree of frames, of one source and namespace, and the robots that it holds."""

from dataclasses import dataclass

from ogm_core.errors import BadMessage, NoTransform, NoTransformYet
from ogm_core.ros2.base_poses import BasePoses, RobotFrames, robot_frames
from ogm_core.ros2.cdr import LaserScan, PointCloud2, decode_tf_message
from ogm_core.ros2.robot_names import prefix_of, robot_name, sensor_name
from ogm_core.ros2.tf_tree import TfTree
from ogm_core.ros2.topics import TF_STATIC, Topic
from ogm_core.ros2.transform import Transform
from ogm_services.ros2.mapped_robot import MappedRobot
from ogm_services.ros2.pose_source import Mounted, RobotGroup
from ogm_services.ros2.robots import RobotKey
from ogm_services.ros2.sensor_feed import SensorFeed

MAP_WAIT = 2.0
"""So long a map frame is waited for above a robot's odometry, s."""
BASES = ("base_link", "base_footprint")
"""What a robot's base is called whose sensor is not in tf."""


@dataclass(slots=True)
class _Followed:
    """A robot of the tree."""

    robot: MappedRobot
    frames: RobotFrames
    poses: BasePoses


class TfPoses:
    """What /tf and /tf_static of one source and namespace tell."""

    def __init__(self, group: RobotGroup, pose_gap: float, map_wait: float | None = None) -> None:
        """`map_wait`: how long a map frame is waited for, s; None: MAP_WAIT."""
        self._group, self._map_wait = group, map_wait
        self._tree = TfTree(pose_gap=pose_gap, tf_hold=group.options.tf_hold)
        self._followed: dict[str, _Followed] = {}
        self._mapless: dict[str, float] = {}
        """Since when a robot's tf has led to its odometry only, s; by prefix."""

    def add(self, payload: bytes, topic: Topic) -> None:
        """Take in a message of /tf, or of /tf_static.

        Raises:
            BadCdr: it is none.
        """
        for what, text in self._tree.add(decode_tf_message(payload), static=topic.last == TF_STATIC):
            self._group.account.dropped(topic.name, what, text)

    def owner(self, feed: SensorFeed, message: LaserScan | PointCloud2, now: float) -> Mounted:
        """Whose sensor a message is of; `now` in s."""
        frames = self._frames_of(message.frame)
        prefix = prefix_of(frames.base)
        followed = self._followed.get(prefix)
        if followed is None or followed.frames.fixed != frames.fixed:
            followed = self._follow(prefix, frames, now)
        name = robot_name(self._group.namespace, prefix, self._group.otherwise)
        return Mounted(followed.robot, sensor_name(feed.topic.name, self._group.namespace, name))

    def mount(self, mounted: Mounted, message: LaserScan | PointCloud2, stamp: int) -> Transform:
        """Where the sensor was on its robot at a stamp, ns."""
        base, tree = self._base_of(mounted.robot), self._tree
        if base in tree.path(message.frame) or tree.edge(message.frame) is None:
            return tree.lookup(base, message.frame, stamp)
        # The odometry's frame may have several children, as base_link and base_footprint, that move together.
        above = tree.path(base)[1]
        return tree.lookup(above, base, stamp).inverse().compose(tree.lookup(above, message.frame, stamp))

    def missing(self, mounted: Mounted) -> str:
        """Why a robot has no poses later than those that were sent."""
        found = (each.poses.missing for each in self._followed.values() if each.robot is mounted.robot)
        return next(found, "no tf leads to it any more")

    def send_poses(self) -> None:
        """Send what can be told by now."""
        for prefix, followed in list(self._followed.items()):
            if followed.frames.odometry and self._has_a_map(followed):
                del self._followed[prefix]  # its next scan tells anew where its poses are
                continue
            for stamp, pose in followed.poses.take():
                try:
                    followed.robot.send_pose(stamp, pose)
                except BadMessage as error:
                    self._group.account.dropped(f"{followed.robot.name}/pose", "malformed", str(error))

    def _has_a_map(self, followed: _Followed) -> bool:
        """Whether tf leads further up by now than to a robot's odometry."""
        names = {"map_frame": self._group.options.map_frame, "odom_frame": self._group.options.odom_frame}
        try:
            return not robot_frames(self._tree, followed.frames.base, **names).odometry
        except NoTransform:  # what was known of it is no more
            return False

    def _frames_of(self, sensor: str) -> RobotFrames:
        """The frames of the robot of a sensor; of a sensor that is not in tf, those of its base by name."""
        names = {"map_frame": self._group.options.map_frame, "odom_frame": self._group.options.odom_frame}
        try:
            return robot_frames(self._tree, sensor, **names)
        except NoTransformYet:
            prefix = prefix_of(sensor)
            for base in (f"{prefix}/{base}".lstrip("/") for base in BASES):
                if self._tree.edge(sensor) is None and self._tree.edge(base) is not None:
                    return robot_frames(self._tree, base, **names)
            raise

    def _follow(self, prefix: str, frames: RobotFrames, now: float) -> _Followed:
        wait = MAP_WAIT if self._map_wait is None else self._map_wait
        if frames.odometry and now - self._mapless.setdefault(prefix, now) < wait:
            text = f"tf leads up to {frames.fixed} only; {self._group.options.map_frame} is waited for"
            raise NoTransformYet(text, "no map")
        key = RobotKey(self._group.where, self._group.namespace, prefix)
        name = robot_name(self._group.namespace, prefix, self._group.otherwise)
        robot = self._group.robots.take_on(key, name, frames.fixed, odometry=frames.odometry)
        followed = self._followed[prefix] = _Followed(robot, frames, BasePoses(self._tree, frames))
        return followed

    def _base_of(self, robot: MappedRobot) -> str:
        for followed in self._followed.values():
            if followed.robot is robot:
                return followed.frames.base
        raise NoTransform(f"{robot.name} is no robot of this tf", "no robot")
