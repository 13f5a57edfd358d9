"""What robots of ROS 2 cost `ogm ros2`: CPU of a scan, of a cloud, of transforms, and of the map.

A robot of which every message is there already: from its CDR to the mapper's message, which is put on a
session that nobody has joined. What Zenoh or DDS takes to bring a message is not in it.
"""

import logging
import math
import time
from contextlib import closing
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.table import Result
from ogm_client import RobotPublisher
from ogm_client.session import NetworkConfig, open_session
from ogm_core.placing.sensor_rules import SensorRules
from ogm_core.ros2.cdr import (
    LASER_SCAN,
    POINT_CLOUD2,
    TF_MESSAGE,
    OccupancyGrid,
    encode_occupancy_grid,
)
from ogm_core.ros2.topics import Form, Qos, Topic
from ogm_services.ros2.account import Account
from ogm_services.ros2.gateway import Gateway, NamedSource
from ogm_services.ros2.options import Ros2Options
from ogm_services.ros2.robots import Robots
from ogm_services.ros2.topic_source import Take
from ogm_services.runtime.limited_log import LimitedLog

BEAMS, TRANSFORMS, SIDE, POINTS = 1081, 30, 4000, (64, 1024)
TF_RATE, PERIOD = 50.0, 20_000_000
"""Messages of /tf a second, and ns from one to the next."""
MESSAGES, QUICK_MESSAGES = 400, 100
ROUNDS, QUICK_ROUNDS = 7, 3
TOPICS = {"/tf_static": TF_MESSAGE, "/tf": TF_MESSAGE, "/scan": LASER_SCAN, "/points": POINT_CLOUD2}


def run(quick: bool) -> list[Result]:
    """Measure; the best of some rounds."""
    rounds, count = (QUICK_ROUNDS, QUICK_MESSAGES) if quick else (ROUNDS, MESSAGES)
    best: dict[str, float] = {}
    for number in range(rounds):
        for name, seconds in _round(count, np.random.default_rng(number)).items():
            best[name] = min(seconds, best.get(name, math.inf))
    group = "ogm ros2, CPU time"
    core = 100.0 * TF_RATE * best["tf"]
    return [
        Result(group, f"a LaserScan of {BEAMS} beams", 1e6 * best["scan"], "us", 100.0, at_least=False),
        Result(group, "a PointCloud2 of 64 x 1024 points", 1e3 * best["cloud"], "ms", 4.0, at_least=False),
        Result(group, f"{TRANSFORMS} transforms at 50 Hz, of a core", core, "%", 3.0, at_least=False),
        Result(group, "an encoded OccupancyGrid, 4000 x 4000", 1e3 * best["map"], "ms", 45.0, at_least=False),
    ]


class _Played:
    """A source whose messages are put in."""

    form: Form = "dds"
    domain: int | None = 0
    where = "here"

    def __init__(self) -> None:
        self.take: dict[str, Take] = {}

    def topics(self) -> list[Topic]:
        return [Topic("dds", name, kind, qos=Qos(reliable=True)) for name, kind in TOPICS.items()]

    def subscribe(self, topic: Topic, take: Take) -> Any:  # noqa: ANN401 - something that is closed
        self.take[topic.name] = take
        return SimpleNamespace(close=lambda: None)

    def publish_latched(self, name: str, message_type: str) -> Any:  # noqa: ANN401 - it is not asked
        raise NotImplementedError

    def close(self) -> None:
        pass


def _round(count: int, rng: np.random.Generator) -> dict[str, float]:
    """CPU time of a message of each kind, s."""
    source, messages = _Played(), _Messages()
    with open_session(NetworkConfig(listen=("tcp/127.0.0.1:0",))) as session:

        def publisher(name: str) -> RobotPublisher:
            return RobotPublisher(name, session=session)

        account = Account(LimitedLog(logging.getLogger("benchmarks")))
        options = Ros2Options(cloud_topics=("/points",))
        with closing(Robots(publisher, (), "map", account)) as robots:
            named = [NamedSource(source, "robot1")]
            with closing(Gateway(named, robots, account, options, SensorRules(), 0.5)) as gateway:
                for _ in range(2):  # transforms are read from the first look on, scans from the second
                    gateway.look()

                def cpu(topic: str, payloads: list[bytes]) -> float:
                    for payload in payloads:
                        source.take[topic](payload)
                    begin = time.process_time()
                    while gateway.step(0.0):
                        pass
                    return (time.process_time() - begin) / len(payloads)

                cpu("/tf_static", [messages.transforms(0, [("base_link", "laser")])])
                joints = [("base_link", f"joint{k}") for k in range(TRANSFORMS - 2)]
                edges = [("map", "odom"), ("odom", "base_link"), *joints]
                seconds = {}
                seconds["tf"] = cpu("/tf", [messages.transforms(n * PERIOD, edges) for n in range(count)])
                ranges = rng.uniform(1.0, 20.0, (count, BEAMS)).astype(np.float32)
                stamps = range(PERIOD, count * PERIOD, PERIOD)
                scans = [messages.scan(stamp, ranges[n]) for n, stamp in enumerate(stamps)]
                seconds["scan"] = cpu("/scan", scans)
                clouds = [messages.cloud(stamp, rng) for stamp in list(stamps)[:10]]
                seconds["cloud"] = cpu("/points", clouds)
        sent = account.counts
        assert {name: found["sent"] for name, found in sent.items()} == {
            "robot1/scan": len(scans),
            "robot1/points": len(clouds),
        }, sent
    cells = rng.choice(np.array([-1, 0, 100], np.int8), (SIDE, SIDE))
    begin = time.process_time()
    encode_occupancy_grid(OccupancyGrid(0, "map", 0.05, (0.0, 0.0), cells))
    seconds["map"] = time.process_time() - begin
    return seconds


class _Messages:
    """Messages of a robot, as rosbags writes them."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._store: Any = get_typestore(Stores.ROS2_HUMBLE)
        self._types: Any = self._store.types

    def transforms(self, stamp: int, edges: list[tuple[str, str]]) -> bytes:
        """Each edge a metre long."""
        make = self._type
        vector, turn = make("geometry_msgs/msg/Vector3")(0.6, 0.8, 0.0), (0.0, 0.0, 0.0, 1.0)
        transform = make("geometry_msgs/msg/Transform")(vector, make("geometry_msgs/msg/Quaternion")(*turn))
        stamped = make("geometry_msgs/msg/TransformStamped")
        found = [stamped(self._header(stamp, parent), child, transform) for parent, child in edges]
        return self._cdr(make(TF_MESSAGE)(found), TF_MESSAGE)

    def scan(self, stamp: int, ranges: "np.ndarray[Any, np.dtype[np.float32]]") -> bytes:
        """Over 270 degrees."""
        step = math.radians(270.0) / (BEAMS - 1)
        numbers = (math.radians(-135.0), math.radians(135.0), step, 0.0, 0.02, 0.1, 30.0)
        header, none = self._header(stamp, "laser"), np.zeros(0, np.float32)
        return self._cdr(self._type(LASER_SCAN)(header, *numbers, ranges, none), LASER_SCAN)

    def cloud(self, stamp: int, rng: np.random.Generator) -> bytes:
        """Of x, y, z and intensity, as a lidar of 64 rings has it."""
        rings, columns = POINTS
        points = rng.uniform(-20.0, 20.0, (rings * columns, 4)).astype(np.float32)
        points[:, 2] = rng.uniform(-1.0, 3.0, len(points))
        field = self._type("sensor_msgs/msg/PointField")
        fields = [field(name, 4 * k, 7, 1) for k, name in enumerate(("x", "y", "z", "intensity"))]
        data = points.view(np.uint8).reshape(-1)
        shape = (rings, columns, fields, False, 16, 16 * columns)
        made = self._type(POINT_CLOUD2)(self._header(stamp, "laser"), *shape, data, True)
        return self._cdr(made, POINT_CLOUD2)

    def _header(self, stamp: int, frame: str) -> Any:  # noqa: ANN401 - a class that rosbags makes
        at = self._type("builtin_interfaces/msg/Time")(*divmod(stamp, 10**9))
        return self._type("std_msgs/msg/Header")(at, frame)

    def _type(self, name: str) -> Any:  # noqa: ANN401 - a class that rosbags makes
        return self._types[name]

    def _cdr(self, message: object, name: str) -> bytes:
        return bytes(self._store.serialize_cdr(message, name))
