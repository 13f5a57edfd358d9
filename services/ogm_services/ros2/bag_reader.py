"""Reader of bags: what robots of ROS 2 or ROS 1 published, as the poses and scans that `ogm ros2` sends."""

import math
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Self

from ogm_core.errors import BadCdr, BadRecording, printable
from ogm_core.logs.recorded import Recorded, RecordedPose, RecordedScan, no_returns
from ogm_core.logs.renaming import Renaming, check_range_max
from ogm_core.placing.sensor_rules import SensorRules
from ogm_core.ros2 import cdr
from ogm_core.ros2.bag_files import BagFile, BagMessage, BagTopic
from ogm_core.ros2.bag_folder import listed
from ogm_core.types import PoseStamped, Scan
from ogm_services.ros2.account import SENT, Account
from ogm_services.ros2.bag_topics import chosen_scans, edges_in, has_frame, is_static, told
from ogm_services.ros2.conversion import Conversion, Network, Patience
from ogm_services.ros2.options import Ros2Options, matches
from ogm_services.ros2.robots import Robots
from ogm_services.runtime.complaints import Complaints
from ogm_services.settings.settings import Settings

ROBOT = "robot1"
"""The name of a bag's robot that has neither namespace nor prefix."""
MAX_COMPLAINTS = 3
MAX_WAITING = 4096
"""Scans of a sensor that may wait for transforms."""


@dataclass(frozen=True, slots=True)
class BagOptions:
    """How a bag is read; `scan_topics`, globs: () takes the one there is, or none if clouds are asked for.

    `fixed_frame`: the frame that poses are in; None: map if there is one, else odom.
    """

    ros2: Ros2Options = field(default_factory=Ros2Options)
    scan_topics: tuple[str, ...] = ()
    fixed_frame: str | None = None


class BagReader:
    """Reads a bag once, in the order in which its messages were written; stamps are those of their headers.

    Like a RecordingReader, whose names mean the same here. Static transforms hold from the begin on, the
    last one of each frame; scans wait for transforms as long as the bag has some to come.

    Raises:
        BadSetting: `range_max` or `robot` cannot be used.
        BadRecording: on entering, the bag cannot be read, or lacks what a map needs, or must be told which
            scans to take; while iterating, it is damaged, or holds a second robot although `robot` is given;
            at the end, none of its scans could be placed.
    """

    def __init__(
        self,
        path: Path,
        options: BagOptions,
        settings: Settings,
        *,
        range_max: float | None = None,
        robot: str | None = None,
    ) -> None:
        check_range_max(range_max)
        self.path, self.unit = path, "messages"
        self.malformed = self.scans = self.poses = self.size = self.position = 0
        self.complaints: list[str] = []
        self._options, self._settings = options, settings
        self._range_max = range_max
        self._renaming = Renaming(path, robot)
        self._bag = BagFile(path)
        self._told = _Told()
        self._account = Account(self._told)
        self._read: deque[Recorded] = deque()
        self._opening = ExitStack()

    @property
    def not_read(self) -> str:
        """What was passed over, as "12 of /scan: no_transform"; "" if nothing was."""
        return ", ".join(
            f"{count} of {source}: {reason}"
            for source, counts in sorted(self._account.counts.items())
            for reason, count in sorted(counts.items())
            if reason != SENT
        )

    @property
    def doubt(self) -> str:
        """What should be known of how it was read; "" if nothing."""
        return "; ".join(self.doubts)

    @property
    def doubts(self) -> list[str]:
        """The same, one by one."""
        return [*self._bag.notes, *self._told.complaints.lines()]

    def __enter__(self) -> Self:
        with ExitStack() as opening:
            opening.enter_context(self._bag)
            self._begin()
            self._opening = opening.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opening.close()

    def __iter__(self) -> Iterator[Recorded]:
        handlers = {topic: handle for topic, handle in self._handlers.items() if not is_static(topic)}
        total = sum(topic.messages for topic in handlers)
        for done, message in enumerate(self._bag.messages(handlers), 1):
            self.position = round(self.size * done / total)
            self.scans += message.topic in self._scan_topics
            self._handle(handlers[message.topic], message)
            yield from self._taken()
        self._conversion.finish()
        yield from self._taken()
        if not self._sent_scans:
            raise BadRecording(f"{self.path}: none of its {self.scans} scans can be placed{self._why()}")

    def _begin(self) -> None:
        bag = self._bag
        self.size = bag.size
        chosen = chosen_scans(bag, self._options.scan_topics, self._options.ros2.cloud_topics)
        self._scan_topics = (*chosen.scans, *chosen.clouds)
        # Those that are chosen are handed in, and no others; their names may be no globs.
        options = replace(
            self._options.ros2,
            scan_topics=("*",),
            cloud_topics=("*",),
            max_beams=self._settings.mapper.max_beams,
        )
        if self._options.fixed_frame is not None:
            options = replace(options, map_frame=self._options.fixed_frame)
        frames = {} if options.pose_topics else self._frames()
        self._check(options, frames)

        def map_wait(namespace: str) -> float:
            names = frames.get(namespace, frozenset())
            has_map = options.map_frame != options.odom_frame and has_frame(names, options.map_frame)
            return math.inf if has_map else 0.0

        robots = Robots(self._publisher, self._settings.robots, options.map_frame, self._account)
        self._conversion = Conversion(
            (Network(str(self.path), ROBOT),),
            robots,
            self._account,
            options,
            SensorRules(self._settings.sensor_rules()),
            self._settings.mapper.pose_gap,
            Patience(lambda: 0.0, MAX_WAITING, map_wait),
        )
        self._handlers = self._handlers_of(bag)
        self._sent_scans = 0
        for message in bag.messages([topic for topic in self._handlers if is_static(topic)]):
            self._handle(self._handlers[message.topic], message)

    def _handlers_of(self, bag: BagFile) -> dict[BagTopic, Callable[[bytes], None]]:
        """What takes in the messages of each topic that is used."""
        # Poses first: a scan's robot is found by the namespaces that have poses.
        poses = [
            topic for topic in bag.topics if topic.messages and self._conversion.tells_poses(told(topic))
        ]
        found = {topic: self._conversion.handler(0, told(topic)) for topic in [*poses, *self._scan_topics]}
        return {topic: handle for topic, handle in found.items() if handle is not None}

    def _handle(self, handle: Callable[[bytes], None], message: BagMessage) -> None:
        try:
            handle(self._bag.cdr(message))
        except BadCdr as error:
            self.malformed += 1
            if self.malformed <= MAX_COMPLAINTS:
                self.complaints.append(f"{printable(message.topic.name)}: {error}")

    def _frames(self) -> dict[str, frozenset[str]]:
        """The frames that transforms name, by namespace."""
        return {
            namespace: frozenset(edges) | {edge.parent for edge in edges.values()}
            for namespace, edges in edges_in(self._bag).items()
        }

    def _check(self, options: Ros2Options, frames: dict[str, frozenset[str]]) -> None:
        """Refuse what cannot become a map."""
        if options.pose_topics:
            self._check_pose_topics(options)
            return
        if not frames:
            poses = [topic.name for topic in self._bag.topics if topic.type in cdr.POSES and topic.messages]
            instead = f"; --pose-topic takes poses from {listed(poses)}" if poses else ""
            raise BadRecording(
                f"{self.path}: holds no tf, so nothing says where its scans were taken{instead}"
            )
        every = frozenset[str]().union(*frames.values())
        fixed = self._options.fixed_frame
        if fixed is not None and not has_frame(every, fixed):
            raise BadRecording(
                f"{self.path}: --fixed-frame {fixed}: no transform names it; there are {listed(every)}"
            )

    def _check_pose_topics(self, options: Ros2Options) -> None:
        poses = [topic for topic in self._bag.topics if topic.type in cdr.POSES and topic.messages]
        if not any(matches(topic.name, options.pose_topics) for topic in poses):
            there = f"there are {listed(topic.name for topic in poses)}" if poses else "there are none"
            raise BadRecording(
                f"{self.path}: --pose-topic {', '.join(options.pose_topics)}: no poses come from it; {there}"
            )

    def _publisher(self, robot: str) -> "_LogOfRobot":
        return _LogOfRobot(robot, self._range_max, self._read)

    def _taken(self) -> Iterator[Recorded]:
        while self._read:
            recorded = self._renaming.of(self._read.popleft())
            if isinstance(recorded, RecordedScan):
                self._sent_scans += 1
            else:
                self.poses += 1
            yield recorded

    def _why(self) -> str:
        """Why scans were dropped, in the words of the first of each reason."""
        reasons = self._told.of({topic.name for topic in self._scan_topics})
        if "no edge" in reasons:
            reasons["mount"] = "--mount X,Y,THETA says where the sensor is on the robot, in place of tf"
        others = {topic.name for topic in self._handlers} - {topic.name for topic in self._scan_topics}
        why = [*reasons.values(), *self._told.of(others).values(), *self.complaints]
        return f": {'; '.join(why)}" if why else ""


class _LogOfRobot:
    """Takes what is made of a robot's messages, instead of a network."""

    run = "bag"

    def __init__(self, robot: str, range_max: float | None, read: deque[Recorded]) -> None:
        self.robot = robot
        self._range_max = range_max
        self._read = read

    def put_pose(self, message: PoseStamped) -> None:
        self._read.append(RecordedPose(self.robot, message))

    def put_scan(self, sensor: str, message: Scan) -> None:
        if self._range_max is not None:
            ranges = no_returns(message.ranges, self._range_max)
            message = replace(message, range_max=self._range_max, ranges=ranges)
        self._read.append(RecordedScan(self.robot, sensor, message))

    def wait_for_mapper(self, timeout: float) -> None:
        """Whoever iterates takes them."""

    def close(self) -> None:
        """Nothing is open."""


class _Told:
    """Complaints about messages, told when all are read."""

    def __init__(self) -> None:
        self.complaints = Complaints()
        self._first: dict[tuple[str, str], str] = {}

    def of_kind(self, source: str, kind: str, text: str) -> None:
        self.complaints.add(source, kind, text)
        self._first.setdefault((source, kind), text)

    def of(self, topics: set[str]) -> dict[str, str]:
        """The first complaint of each kind about some topics."""
        return {kind: text for (source, kind), text in self._first.items() if source in topics}
