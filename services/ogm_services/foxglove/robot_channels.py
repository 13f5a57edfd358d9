"""Robot channels: where robots are, as transforms and as arrows, and a channel for each sensor's scans."""

import logging
import math
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from foxglove import Context
from foxglove.channels import FrameTransformsChannel, LaserScanChannel, SceneUpdateChannel

from ogm_core.errors import BadMessage
from ogm_core.placing.rules import MAX_ROBOTS, MAX_SENSORS
from ogm_core.status import GONE_AFTER, RobotStatus
from ogm_core.types import Pose, Scan
from ogm_core.wire.messages import decode_pose, decode_scan
from ogm_services.foxglove.heard_robots import Heard
from ogm_services.foxglove.messages import Located, laser_scan, scene, transforms
from ogm_services.runtime.limited_log import LimitedLog

TF, ROBOTS = "/tf", "/robots"

log = logging.getLogger(__name__)


def scan_topic(robot: str, sensor: str) -> str:
    """The topic of a sensor's scans."""
    return f"{ROBOTS}/{robot}/scan/{sensor}"


@dataclass(slots=True)
class _Sensor:
    channel: LaserScanChannel
    scan: Scan
    """The newest one."""


@dataclass(slots=True)
class _Robot:
    located: Located | None = None
    """Where it was last."""
    heard: float = -math.inf
    """When it was heard last, s."""
    sensors: dict[str, _Sensor] = field(default_factory=dict)


class RobotChannels:
    """Tells viewers of robots: by what they publish, and by what their mapper says of them.

    To a viewer that comes later everything is sent again. One thread calls `step`.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._transforms = FrameTransformsChannel(TF, context=context)
        self._scene = SceneUpdateChannel(ROBOTS, context=context)
        self._robots: dict[str, _Robot] = {}
        self._complaints = LimitedLog(log)
        self._lock = threading.Lock()
        self._subscribed: set[str] = set()

    def subscribed(self, topic: str) -> None:
        """Note that a viewer has subscribed to a topic; any thread."""
        with self._lock:
            self._subscribed.add(topic)

    def step(self, heard: Heard, said: Mapping[str, RobotStatus] | None, now: float) -> None:
        """Send what has come of robots, and forget those that are gone; `now` in s.

        `said`: what the mapper says of them, if it has since; it places those that were not heard.
        """
        moved: list[Located] = []
        for name, payloads in heard.poses.items():
            robot = self._known(name, now)
            if robot is not None:
                moved += self._take_poses(name, robot, payloads)
        for (name, sensor), payload in heard.scans.items():
            robot = self._known(name, now)
            if robot is not None and sensor is not None:
                moved += self._take_scan(name, robot, sensor, payload)
        gone: list[str] = []
        if said is not None:
            moved += self._take_status(said)
            gone = self._forget(said, now)
        self._tell(moved, gone)

    def _take_poses(self, name: str, robot: _Robot, payloads: Iterable[bytes]) -> list[Located]:
        moved: list[Located] = []
        for payload in payloads:
            try:
                message = decode_pose(payload)
            except BadMessage as error:
                self._complaints.of_kind(f"{name}/pose", error.slug, str(error))
                continue
            moved.append((name, message.stamp, message.pose))
        if moved:
            robot.located = moved[-1]
        return moved

    def _take_scan(self, name: str, robot: _Robot, sensor: str, payload: bytes) -> list[Located]:
        """Send a scan; where its robot was, if it says so."""
        source = f"{name}/{sensor}"
        try:
            scan = decode_scan(payload)
        except BadMessage as error:
            self._complaints.of_kind(source, error.slug, str(error))
            return []
        known = robot.sensors.get(sensor)
        if known is None:
            if len(robot.sensors) >= MAX_SENSORS:
                self._complaints.warning(source, f"not shown: a robot has {MAX_SENSORS} sensors at most")
                return []
            channel = LaserScanChannel(scan_topic(name, sensor), context=self._context)
            known = robot.sensors[sensor] = _Sensor(channel, scan)
        known.scan = scan
        if known.channel.has_sinks():
            known.channel.log(laser_scan(name, scan))
        if scan.pose is None:
            return []
        robot.located = (name, scan.stamp, scan.pose)
        return [robot.located]

    def _take_status(self, said: Mapping[str, RobotStatus]) -> list[Located]:
        """Where those are that were not heard, or not for long."""
        moved: list[Located] = []
        for name, status in said.items():
            if status.pose is None or status.stamp is None or status.gone:
                continue
            robot = self._robots.get(name)
            if robot is None and len(self._robots) < MAX_ROBOTS:
                robot = self._robots[name] = _Robot()
            if robot is None or robot.heard > -math.inf:
                continue
            located = (name, status.stamp, Pose(*status.pose))
            if located != robot.located:
                robot.located = located
                moved.append(located)
        return moved

    def _known(self, name: str, now: float) -> _Robot | None:
        """What is known of a robot that is heard; None if it is one too many."""
        robot = self._robots.get(name)
        if robot is None:
            if len(self._robots) >= MAX_ROBOTS:
                self._complaints.warning(ROBOTS, f"{name} is not shown: {MAX_ROBOTS} robots are, at most")
                return None
            robot = self._robots[name] = _Robot()
        robot.heard = now
        return robot

    def _forget(self, said: Mapping[str, RobotStatus], now: float) -> list[str]:
        """Forget the robots that the mapper does not show, and that are silent; their names."""
        gone = [
            name
            for name, robot in self._robots.items()
            if now - robot.heard > GONE_AFTER and (name not in said or said[name].gone)
        ]
        for name in gone:
            for sensor in self._robots.pop(name).sensors.values():
                sensor.channel.close()
        return gone

    def _tell(self, moved: list[Located], gone: list[str]) -> None:
        """Send where robots have been, and all that is known on the topics that somebody has come to."""
        with self._lock:
            topics, self._subscribed = self._subscribed, set()
        newest = {located[0]: located for located in moved}
        still = [
            robot.located
            for name, robot in self._robots.items()
            if robot.located is not None and name not in newest
        ]
        located = [*(still if TF in topics else ()), *moved]
        if located and self._transforms.has_sinks():
            self._transforms.log(transforms(located))
        shown = [*(still if ROBOTS in topics else ()), *newest.values()]
        if (shown or gone) and self._scene.has_sinks():
            self._scene.log(scene(shown, gone))
        for name, robot in self._robots.items():
            for sensor in robot.sensors.values():
                if sensor.channel.topic() in topics and sensor.channel.has_sinks():
                    sensor.channel.log(laser_scan(name, sensor.scan))
