"""Robots of ROS 2 that drive, a gateway that a test lets work, and what a mapper would have received."""

import logging
import math
from contextlib import contextmanager
from types import SimpleNamespace

import naive_cdr
from ogm_client.robot import RobotPublisher
from ogm_client.session import NetworkConfig, open_session
from ogm_core.placing.sensor_rules import SensorRules
from ogm_core.wire.keys import MapKeys
from ogm_core.wire.messages import decode_pose, decode_scan
from ogm_services.ros2.account import Account
from ogm_services.ros2.bridge import BridgeSource
from ogm_services.ros2.gateway import Gateway, NamedSource
from ogm_services.ros2.options import Ros2Options
from ogm_services.ros2.rmw_zenoh import RmwZenohSource
from ogm_services.ros2.robots import Robots
from ogm_services.runtime.limited_log import LimitedLog

MS = 10**6
S = 10**9
KEYS = MapKeys("hall")
RANGES = [1.0, 2.0, math.inf]


def planar(x, y, yaw, z=0.0):
    return (x, y, z, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


class Sent:
    """What a mapper would have received, by robot."""

    def __init__(self, session):
        self.poses, self.scans, self.order = {}, {}, []
        session.declare_subscriber(KEYS.robots, self._take)

    def _take(self, sample):
        source = KEYS.source_of(str(sample.key_expr))
        payload = sample.payload.to_bytes()
        self.order.append(source.sensor or "pose")
        if source.sensor is None:
            self.poses.setdefault(source.robot, []).append(decode_pose(payload))
        else:
            self.scans.setdefault(f"{source.robot}/{source.sensor}", []).append(decode_scan(payload))


@contextmanager
def sessions(endpoint):
    """`join()` opens a session on a network; all are closed at the end."""
    opened = []

    def join():
        opened.append(open_session(NetworkConfig(connect=(endpoint,))))
        return opened[-1]

    yield join
    for session in opened:
        session.close()


@contextmanager
def gateways(listener, network, eventually):
    """`gateway(...)` makes one; `until(condition)` lets it work until then."""
    made = []

    def gateway(*, domains=(0,), bridge=False, options=None, rules=(), robots=()):
        session, robots_session = network(), network()
        account = Account(LimitedLog(logging.getLogger("test")))
        sources = [
            NamedSource(RmwZenohSource(robots_session, domain, "here"), f"domain{domain}")
            for domain in domains
        ]
        if bridge:
            sources.append(NamedSource(BridgeSource(robots_session, "here"), "bridge"))

        def publisher(name):
            return RobotPublisher(name, session=session, map_name="hall", reliable=True)

        found = Robots(publisher, robots, "map", account)
        work = Gateway(sources, found, account, options or Ros2Options(), SensorRules(rules), 0.5)

        def until(condition):
            def worked():
                while work.step(0.001):
                    pass
                return condition()

            return eventually(worked)

        sent = Sent(listener)
        made.append((work, found, sources))
        return SimpleNamespace(
            work=work, until=until, sent=sent, counts=account.counts, account=account, found=found
        )

    yield gateway
    for work, found, sources in made:
        work.close()
        found.close()
        for source, _ in sources:
            source.close()


class Driver:
    """A robot that drives along x at a speed of its own, and scans every 0.1 s."""

    def __init__(self, robot, *, topics="", frames="", speed=1.0, start=0.0, map_frame=True, mount=None):
        self.frames, self.speed, self.start = frames, speed, start
        self.static = robot.publisher(f"{topics}/tf_static", "TFMessage", latched=True)
        self.tf = robot.publisher(f"{topics}/tf", "TFMessage")
        self.scan = robot.publisher(f"{topics}/scan", "LaserScan")
        mount = planar(0.2, 0.0, 0.5, 0.3) if mount is None else mount
        self.static(naive_cdr.tf_message([(0, self.frame("base_link"), self.frame("laser"), mount)]))
        self.map_frame = map_frame

    def frame(self, name):
        return f"{self.frames}{name}"

    def drive(self, n, *, scan=True):
        """The n-th step: transforms, and the scan of 50 ms before them; none at the first."""
        stamp = n * 100 * MS
        edges = [(stamp, self.frame("odom"), self.frame("base_link"), planar(self.x(stamp), 0.0, 0.0))]
        if self.map_frame:
            edges.insert(0, (stamp, "map", self.frame("odom"), planar(0.0, self.start, 0.0)))
        self.tf(naive_cdr.tf_message(edges))
        if n and scan:
            numbers = (-0.5, 0.5, 0.5, 0.0, 0.1, 0.1, 10.0)
            self.scan(naive_cdr.laser_scan(stamp - 50 * MS, self.frame("laser"), numbers, RANGES))

    def x(self, stamp):
        return self.speed * stamp / S


def known(found, frame):
    """Whether a frame is known at the root: transforms and scans may overtake each other."""
    return frame in found.work.conversion._poses[0, ""]._tree.frames


def all_heard(*drivers):
    return lambda: all(driver.scan.matching() and driver.tf.matching() for driver in drivers)


class Silent:
    """A source whose subscriptions are noted."""

    form, domain, where = "rmw_zenoh", 0, "here"

    def __init__(self):
        self.taking, self.closed = [], 0

    def subscribe(self, topic, take):
        self.taking.append(take)
        return SimpleNamespace(close=lambda: setattr(self, "closed", self.closed + 1))


class Listed(Silent):
    """A source with these topics."""

    def __init__(self, *topics):
        super().__init__()
        self.listed, self.names = topics, []

    def topics(self):
        return self.listed

    def subscribe(self, topic, take):
        self.names.append(topic.name)
        return super().subscribe(topic, take)
