"""Poses from a topic: what a localisation says of one robot, without tf."""

from ogm_core.errors import BadMessage, NoTransform, NoTransformYet, ScanRefused
from ogm_core.ros2.cdr import POSES, LaserScan, PointCloud2, StampedPose
from ogm_core.ros2.robot_names import robot_name, sensor_name
from ogm_core.ros2.topics import Topic
from ogm_core.ros2.transform import Transform, level, unit
from ogm_services.ros2.mapped_robot import MappedRobot
from ogm_services.ros2.pose_source import Mounted, RobotGroup
from ogm_services.ros2.robots import RobotKey
from ogm_services.ros2.sensor_feed import SensorFeed


class TopicPoses:
    """The robot of one source and namespace, whose poses a topic tells."""

    def __init__(self, group: RobotGroup) -> None:
        self._group = group
        self._name = robot_name(group.namespace, "", group.otherwise)
        self._robot: MappedRobot | None = None
        self._fixed: str | None = None
        self._told_by: str | None = None

    def add(self, payload: bytes, topic: Topic) -> None:
        """Take in a pose.

        Raises:
            BadCdr: it is none.
        """
        pose = POSES[topic.type](payload)
        if self._told_by not in (None, topic.name):
            text = f"poses come from {self._told_by} already: give --pose-topic the name of one of the two"
            self._group.account.dropped(topic.name, "refused", text)
            return
        self._told_by = topic.name
        try:
            self._send(pose)
        except BadMessage as error:
            self._group.account.dropped(topic.name, "malformed", str(error))
        except ScanRefused as error:
            self._group.account.dropped(topic.name, error.slug, str(error), error.kind)

    def owner(self, feed: SensorFeed, message: LaserScan | PointCloud2, now: float) -> Mounted:
        """Whose sensor a message is of."""
        if self._fixed is None:
            topics = ", ".join(self._group.options.pose_topics)
            raise NoTransformYet(f"no pose that can be used has come yet on {topics}", "no pose")
        if self._robot is None:
            self._robot = self._take_on(self._fixed)
        return Mounted(self._robot, sensor_name(feed.topic.name, self._group.namespace, self._name))

    def mount(self, mounted: Mounted, message: LaserScan | PointCloud2, stamp: int) -> Transform:
        """Where the sensor is on its robot."""
        if self._group.options.mount is None:
            raise NoTransform(
                f"nothing says where the sensor is on the robot: --mount X,Y,THETA, or --sensor "
                f"'{mounted.robot.name}/{mounted.sensor}:mount=X,Y,THETA'",
                "no mount",
            )
        return level(self._group.options.mount)

    def missing(self, mounted: Mounted) -> str:
        """Why a robot has no poses later than those that were sent."""
        return f"no later one has come on {self._told_by}"

    def send_poses(self) -> None:
        """Nothing: they are sent as they come."""

    def _send(self, pose: StampedPose) -> None:
        if not pose.frame:
            raise BadMessage("its frame_id is empty: which frame is the pose in?")
        if pose.frame != self._fixed:
            self._fixed, self._robot = pose.frame, None
        if self._robot is None:
            self._robot = self._take_on(pose.frame)
        self._robot.send_pose(pose.stamp, unit(pose.transform).planar())

    def _take_on(self, fixed: str) -> MappedRobot:
        odometry = fixed.rpartition("/")[2] == self._group.options.odom_frame
        key = RobotKey(self._group.where, self._group.namespace, "")
        return self._group.robots.take_on(key, self._name, fixed, odometry=odometry)
