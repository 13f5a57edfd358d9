"""Conversion of robots' messages: transforms, poses and scans of their topics in, a mapper's messages out.

One way for what robots send now and for what a bag holds; where messages come from is no matter here.
"""

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from ogm_core.errors import BadMessage, NoTransformYet, ScanRefused
from ogm_core.placing.sensor_rules import SensorRules
from ogm_core.ros2 import cdr
from ogm_core.ros2.robot_names import longest_namespace
from ogm_core.ros2.topics import TF, TF_STATIC, Topic
from ogm_core.ros2.transform import level
from ogm_services.ros2.account import Account
from ogm_services.ros2.options import Ros2Options, matches
from ogm_services.ros2.pose_source import PoseSource, RobotGroup
from ogm_services.ros2.robots import Robots
from ogm_services.ros2.sensor_feed import MAX_WAITING, SensorFeed, Waiting
from ogm_services.ros2.tf_poses import TfPoses
from ogm_services.ros2.topic_poses import TopicPoses

PATIENCE = 5.0
"""So long a scan waits for transforms that are missing, s."""


class Network(NamedTuple):
    """Where topics are, in words, and the name of a robot there that has neither namespace nor prefix."""

    where: str
    otherwise: str


@dataclass(frozen=True, slots=True)
class Patience:
    """How long scans wait for what is missing.

    `now`: a clock, s; `scans`: how many of a sensor may wait; `map_wait`: how long a map frame is waited for
    in a namespace, s; None: as TfPoses does.
    """

    now: Callable[[], float] = time.monotonic
    scans: int = MAX_WAITING
    map_wait: Callable[[str], float | None] = lambda _: None


class Conversion:
    """Keeps what topics say of robots, and sends on their poses and scans.

    A scan's poses come from the longest namespace that both are in; those of different namespaces and
    networks, which are numbered, are never joined.
    """

    def __init__(
        self,
        networks: tuple[Network, ...],
        robots: Robots,
        account: Account,
        options: Ros2Options,
        rules: SensorRules,
        pose_gap: float,
        patience: Patience = Patience(),
    ) -> None:
        self._networks = networks
        self._robots, self._account, self._options, self._rules = robots, account, options, rules
        self._pose_gap, self._patience = pose_gap, patience
        self._poses: dict[tuple[int, str], TfPoses | TopicPoses] = {}
        self._feeds: dict[tuple[int, str, str], SensorFeed] = {}

    @property
    def has_scans(self) -> bool:
        """Whether there is a topic of scans."""
        return bool(self._feeds)

    def handler(self, number: int, topic: Topic) -> Callable[[bytes], None] | None:
        """What takes the messages of a topic of a network, as CDR; None if they are of no use.

        It raises BadCdr if one is damaged.
        """
        if self.tells_poses(topic):
            poses = self._poses_in(number, topic.namespace)
            return functools.partial(self._transforms, number, poses, topic)
        if not self.is_scan(topic):
            return None
        flattening = self._options.flattening if topic.type == cdr.POINT_CLOUD2 else None
        feed = SensorFeed(topic, self._options.scan_delay, flattening, self._options.max_beams)
        self._feeds[number, topic.name, topic.type] = feed
        return functools.partial(self._scan, number, feed)

    def tells_poses(self, topic: Topic) -> bool:
        """Whether transforms or poses are read from a topic."""
        poses = topic.type in cdr.POSES and matches(topic.name, self._options.pose_topics)
        transforms = topic.type == cdr.TF_MESSAGE and topic.last in (TF, TF_STATIC)
        return poses or (transforms and not self._options.pose_topics)

    def is_scan(self, topic: Topic) -> bool:
        """Whether scans are read from a topic."""
        scans = topic.type == cdr.LASER_SCAN and matches(topic.name, self._options.scan_topics)
        clouds = topic.type == cdr.POINT_CLOUD2 and matches(topic.name, self._options.cloud_topics)
        return scans or clouds

    def advance(self) -> None:
        """Send on what can be by now."""
        for (number, _, _), feed in self._feeds.items():
            if feed.waiting:
                self._advance(number, feed)
        for poses in self._poses.values():
            poses.send_poses()

    def finish(self) -> None:
        """Send on or drop what still waits: nothing more comes."""
        for (number, _, _), feed in self._feeds.items():
            self._advance(number, feed, last=True)
        for poses in self._poses.values():
            poses.send_poses()

    def _poses_in(self, number: int, namespace: str) -> TfPoses | TopicPoses:
        poses = self._poses.get((number, namespace))
        if poses is None:
            where, otherwise = self._networks[number]
            group = RobotGroup(where, namespace, otherwise, self._robots, self._account, self._options)
            if self._options.pose_topics:
                poses = TopicPoses(group)
            else:
                poses = TfPoses(group, self._pose_gap, self._patience.map_wait(namespace))
            self._poses[number, namespace] = poses
        return poses

    def _poses_for(self, number: int, topic: Topic) -> PoseSource:
        namespaces = [namespace for other, namespace in self._poses if other == number]
        return self._poses_in(number, longest_namespace(topic.name, namespaces) or "")

    def _transforms(self, number: int, poses: TfPoses | TopicPoses, topic: Topic, payload: bytes) -> None:
        poses.add(payload, topic)
        within = f"{topic.namespace}/"  # with all of 50 robots' the cost would grow with their square
        for (other, name, _), feed in self._feeds.items():
            if feed.waiting and other == number and name.startswith(within):
                self._advance(number, feed)
        poses.send_poses()

    def _scan(self, number: int, feed: SensorFeed, payload: bytes) -> None:
        message: cdr.LaserScan | cdr.PointCloud2
        if feed.flattening is None:
            message = cdr.decode_laser_scan(payload)
        else:
            message = cdr.decode_point_cloud2(payload)
        feed.waiting.append(Waiting(message, self._patience.now()))
        self._advance(number, feed)

    def _advance(self, number: int, feed: SensorFeed, *, last: bool = False) -> None:
        """Send on what waits, in its order, up to the first that transforms are still missing for.

        `last`: nothing more comes, and none is missing any longer.
        """
        poses, now = self._poses_for(number, feed.topic), self._patience.now()
        while feed.waiting:
            message, since = feed.waiting[0]
            patient = not last and now - since < PATIENCE and len(feed.waiting) <= self._patience.scans
            try:
                self._send(poses, feed, message, now, patient=patient)
            except NoTransformYet as error:
                if patient:
                    return
                self._account.dropped(feed.topic.name, error.slug, str(error), error.kind)
            except ScanRefused as error:
                self._account.dropped(feed.topic.name, error.slug, str(error), error.kind)
            except BadMessage as error:
                self._account.dropped(feed.topic.name, "malformed", str(error))
            feed.waiting.popleft()

    def _send(
        self,
        poses: PoseSource,
        feed: SensorFeed,
        message: cdr.LaserScan | cdr.PointCloud2,
        now: float,
        *,
        patient: bool,
    ) -> None:
        mounted = poses.owner(feed, message, now)
        poses.send_poses()  # a robot's first scan tells whose they are: a mapper wants the older ones first
        robot, sensor = mounted
        source = f"{robot.name}/{sensor}"
        rule = self._rules.rule_of(source)
        stamp = feed.taken_at(message, rule)
        if rule is not None and rule.mount is not None:
            mount = level(rule.mount)
        elif self._options.mount is not None:
            mount = level(self._options.mount)
        else:
            mount = poses.mount(mounted, message, stamp)
        if robot.is_ahead(stamp):
            if patient:
                raise NoTransformYet(f"the poses of {robot.name} have not come so far yet", "no pose")
            text = (
                f"its scans go on without the robot's poses, for which they waited: {poses.missing(mounted)}"
            )
            self._account.warned(source, "no_pose", text)
        robot.send_scan(sensor, functools.partial(feed.scan, message, mount, rule))
        self._account.sent(source)
        hint = feed.hint(source, message, rule)
        if hint is not None:
            self._account.note(source, hint)
