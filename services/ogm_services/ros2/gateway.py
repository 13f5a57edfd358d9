"""Gateway: robots' topics in, a mapper's messages out, by one worker that keeps their order."""

import functools
import logging
import math
import time
from collections.abc import Callable, Iterable
from typing import NamedTuple

from ogm_core.errors import BadCdr, BadMessage, NoTransformYet, ScanRefused
from ogm_core.placing.sensor_rules import SensorRules
from ogm_core.ros2 import cdr
from ogm_core.ros2.robot_names import longest_namespace
from ogm_core.ros2.topics import TF, TF_STATIC, Topic
from ogm_core.ros2.transform import level
from ogm_services.ros2.account import Account
from ogm_services.ros2.inbox import Inbox, Message
from ogm_services.ros2.options import Ros2Options, matches
from ogm_services.ros2.pose_source import PoseSource
from ogm_services.ros2.robots import Robots
from ogm_services.ros2.sensor_feed import MAX_WAITING, SensorFeed, Waiting
from ogm_services.ros2.tf_poses import TfPoses
from ogm_services.ros2.topic_poses import TopicPoses
from ogm_services.ros2.topic_reading import TopicReading
from ogm_services.ros2.topic_source import TopicSource

LOOK_EVERY = 0.5
"""How often topics are looked for, s."""
PATIENCE = 5.0
"""So long a scan waits for transforms that are missing, s."""
IDLE = 0.1
MAX_TOPICS = 4000
"""So many are read at most."""
NO_SCANS = 10.0
"""When it is said that there are no scans at all, s."""
_NO_SCANS = (
    "no LaserScan to read has been found yet (%s): `ogm ros2 --list` shows what there is; is the domain "
    "right, and does a driver run?"
)

log = logging.getLogger(__name__)


class NamedSource(NamedTuple):
    """A source, and the name of a robot in it that has neither namespace nor prefix."""

    source: TopicSource
    otherwise: str


class Gateway:
    """Finds robots' topics on all sources, reads them, and sends poses and scans on.

    A scan's poses come from the longest namespace that both are in; those of different namespaces and
    sources are never joined. Transforms are read from the first look on, scans from the second, so that a
    robot's own tf is known before its first scan.
    """

    def __init__(
        self,
        sources: Iterable[NamedSource],
        robots: Robots,
        account: Account,
        options: Ros2Options,
        rules: SensorRules,
        pose_gap: float,
    ) -> None:
        self._sources = tuple(sources)
        self._robots, self._account, self._options, self._rules = robots, account, options, rules
        self._pose_gap = pose_gap
        self._inbox = Inbox()
        self._readings: dict[tuple[int, str, str], TopicReading] = {}
        self._seen: set[tuple[int, str, str]] = set()
        self._poses: dict[tuple[int, str], TfPoses | TopicPoses] = {}
        self._feeds: dict[tuple[int, str, str], SensorFeed] = {}
        self._next_look = 0.0
        self._no_scans_at = time.monotonic() + NO_SCANS

    def run(self, check: Callable[[], None] = lambda: None) -> None:
        """Work until an exception ends it, as KeyboardInterrupt, or one of `check`, which is called often."""
        while True:
            self.step(IDLE)
            check()

    def step(self, timeout: float) -> bool:
        """Look for topics if that is due, and handle the next message; False if none comes in time, s."""
        if time.monotonic() >= self._next_look:
            self.look()
            self._advance_all()
            self._next_look = time.monotonic() + LOOK_EVERY
        message = self._inbox.get(timeout)
        if message is None:
            self._advance_all()
            return False
        try:
            message.handle(message.payload)
        except BadCdr as error:
            self._account.dropped(message.topic, "bad_cdr", str(error))
        return True

    def look(self) -> None:
        """Subscribe to what has come; tell what was refused, or is missing."""
        now = time.monotonic()
        for number, (source, _) in enumerate(self._sources):
            publishers = [topic for topic in source.topics() if topic.publisher]
            for topic in sorted(publishers, key=lambda each: not each.qos.transient_local):
                self._found(number, topic, now)
        if not self._feeds and now >= self._no_scans_at:
            self._no_scans_at = math.inf
            log.warning(_NO_SCANS, ", ".join(source.where for source, _ in self._sources))
        for topic_name, count in self._inbox.refused().items():
            for _ in range(count):
                self._account.dropped(topic_name, "overload", "messages come faster than they can be handled")

    def close(self) -> None:
        """Read no more."""
        for reading in self._readings.values():
            reading.close()
        self._readings.clear()

    def _found(self, number: int, topic: Topic, now: float) -> None:
        key = number, topic.name, topic.type
        if key in self._readings:
            self._readings[key].look(now)
            return
        poses = topic.type in cdr.POSES and matches(topic.name, self._options.pose_topics)
        transforms = topic.type == cdr.TF_MESSAGE and topic.last in (TF, TF_STATIC)
        if poses or (transforms and not self._options.pose_topics):
            self._subscribe_poses(key, topic)
        elif self._is_scan(topic):
            if key in self._seen:
                self._subscribe_scans(key, topic)
            self._seen.add(key)

    def _is_scan(self, topic: Topic) -> bool:
        scans = topic.type == cdr.LASER_SCAN and matches(topic.name, self._options.scan_topics)
        clouds = topic.type == cdr.POINT_CLOUD2 and matches(topic.name, self._options.cloud_topics)
        return scans or clouds

    def _subscribe_poses(self, key: tuple[int, str, str], topic: Topic) -> None:
        poses = self._poses_in(key[0], topic.namespace)
        handle = functools.partial(self._transforms, key[0], poses, topic)
        self._subscribe(key, topic, handle, always=True)

    def _subscribe_scans(self, key: tuple[int, str, str], topic: Topic) -> None:
        cloud = topic.type == cdr.POINT_CLOUD2
        flattening = self._options.flattening if cloud else None
        feed = self._feeds[key] = SensorFeed(topic, self._options.scan_delay, flattening)
        self._subscribe(key, topic, functools.partial(self._scan, key[0], feed), always=False)

    def _subscribe(
        self, key: tuple[int, str, str], topic: Topic, handle: functools.partial[None], *, always: bool
    ) -> None:
        def take(payload: bytes) -> None:
            self._inbox.put(Message(payload, handle, topic.name), always=always)

        source = self._sources[key[0]].source
        if len(self._readings) >= MAX_TOPICS:
            text = f"{MAX_TOPICS} topics are read already; --scan-topic chooses among those with scans"
            self._account.dropped(source.where, "refused", text)
            return
        self._readings[key] = TopicReading(source, topic, take, time.monotonic())

    def _poses_in(self, number: int, namespace: str) -> TfPoses | TopicPoses:
        poses = self._poses.get((number, namespace))
        if poses is None:
            source, otherwise = self._sources[number]
            shared = source.where, namespace, otherwise, self._robots, self._account, self._options
            poses = TopicPoses(*shared) if self._options.pose_topics else TfPoses(*shared, self._pose_gap)
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
        feed.waiting.append(Waiting(message, time.monotonic()))
        self._advance(number, feed)

    def _advance_all(self) -> None:
        for (number, _, _), feed in self._feeds.items():
            if feed.waiting:
                self._advance(number, feed)
        for poses in self._poses.values():
            poses.send_poses()

    def _advance(self, number: int, feed: SensorFeed) -> None:
        """Send on what waits, in its order, up to the first that transforms are still missing for."""
        poses, now = self._poses_for(number, feed.topic), time.monotonic()
        while feed.waiting:
            message, since = feed.waiting[0]
            patient = now - since < PATIENCE and len(feed.waiting) <= MAX_WAITING
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
            log.warning("%s: %s", source, hint)
