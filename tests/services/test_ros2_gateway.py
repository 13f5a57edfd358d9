"""Robots of ROS 2 on a map: whose poses, which mounts, what is refused, and that none are mixed."""

import logging
import math
import struct
from types import SimpleNamespace

import pytest

import naive_cdr
from ogm_client.robot import RobotPublisher
from ogm_client.session import NetworkConfig, open_session
from ogm_core.placing.sensor_rules import SensorRule, SensorRules
from ogm_core.ros2.point_cloud import Flattening
from ogm_core.ros2.topics import Qos, Topic
from ogm_core.types import Pose
from ogm_core.wire.keys import MapKeys
from ogm_core.wire.messages import decode_pose, decode_scan
from ogm_services.ros2 import tf_poses
from ogm_services.ros2.account import Account
from ogm_services.ros2.bridge import BridgeSource
from ogm_services.ros2.gateway import Gateway, NamedSource
from ogm_services.ros2.inbox import Inbox, Message
from ogm_services.ros2.options import Ros2Options
from ogm_services.ros2.rmw_zenoh import RmwZenohSource
from ogm_services.ros2.robots import Robots
from ogm_services.ros2.topic_reading import TopicReading
from ogm_services.runtime.limited_log import LimitedLog
from ogm_services.settings.robots import RobotSettings
from ros2_robots import BridgeRobot, RmwZenohRobot

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


@pytest.fixture
def network(listener, endpoint):
    """Sessions on one network, closed at the end."""
    opened = []

    def join():
        opened.append(open_session(NetworkConfig(connect=(endpoint,))))
        return opened[-1]

    yield join
    for session in opened:
        session.close()


@pytest.fixture
def gateway(listener, network, eventually, monkeypatch):
    """`gateway(...)` makes one; `until(condition)` lets it work until then."""
    monkeypatch.setattr("ogm_services.ros2.gateway.LOOK_EVERY", 0.02)
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

        found = Robots(publisher, robots, "map")
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
    return frame in found.work._poses[0, ""]._tree.frames


def all_heard(*drivers):
    return lambda: all(driver.scan.matching() and driver.tf.matching() for driver in drivers)


def test_one_robot_scan_for_scan(gateway, network):
    driver = Driver(RmwZenohRobot(network()), start=7.0)
    found = gateway()
    found.until(all_heard(driver))
    for n in range(10):
        driver.drive(n)
    found.until(lambda: len(found.sent.scans.get("domain0/scan", ())) == 9)
    found.until(lambda: len(found.sent.poses["domain0"]) == 10)
    poses, scans = found.sent.poses["domain0"], found.sent.scans["domain0/scan"]
    assert [pose.stamp for pose in poses] == [n * 100 * MS for n in range(10)]
    assert [pose.pose for pose in poses] == [Pose(pytest.approx(n * 0.1), 7.0, 0.0) for n in range(10)]
    assert [pose.seq for pose in poses] == list(range(10))
    assert [scan.stamp for scan in scans] == [n * 100 * MS - 50 * MS for n in range(1, 10)]
    assert [scan.seq for scan in scans] == list(range(9))
    assert len({message.run for message in (*poses, *scans)}) == 1
    first = scans[0]
    assert first.run != ""
    assert first.pose is None
    assert first.mount == pytest.approx(Pose(0.2, 0.0, 0.5))
    assert first.ranges.tolist() == RANGES
    assert found.counts == {"domain0/scan": {"sent": 9}}


def test_a_lidar_that_is_late_does_not_have_its_scans_before_the_poses(gateway, network):
    """A mapper waits for no pose that is much older than a scan."""
    driver = Driver(RmwZenohRobot(network()))
    found = gateway()
    found.until(all_heard(driver))
    for n in range(50):
        driver.drive(n, scan=False)
    (tf,) = found.work._poses.values()
    found.until(lambda: getattr(tf._tree.edge("base_link"), "newest", None) == 49 * 100 * MS)
    driver.drive(50)
    found.until(lambda: len(found.sent.order) == 52)
    assert found.sent.order.index("scan") >= 50


def test_three_robots_with_namespaces_are_not_mixed(gateway, network):
    drivers = {
        f"r{n}": Driver(
            RmwZenohRobot(network(), namespace=f"/r{n}"), topics=f"/r{n}", speed=n, start=10.0 * n
        )
        for n in (1, 2, 3)
    }
    check_three(gateway(), drivers)


def test_three_robots_with_prefixed_frames_in_one_tf_are_not_mixed(gateway, network):
    """All say /tf; their frames tell them apart."""
    drivers = {}
    for n in (1, 2, 3):
        robot = RmwZenohRobot(network())
        drivers[f"r{n}"] = driver = Driver(robot, frames=f"r{n}/", speed=n, start=10.0 * n)
        driver.scan = robot.publisher(f"/r{n}/scan", "LaserScan")
    check_three(gateway(), drivers)


def test_three_robots_in_domains_and_behind_a_bridge_are_not_mixed(gateway, network):
    drivers = {
        "domain0": Driver(RmwZenohRobot(network(), domain=0), speed=1, start=10.0),
        "domain7": Driver(RmwZenohRobot(network(), domain=7, old=True), speed=2, start=20.0),
        "bridge": Driver(BridgeRobot(network()), speed=3, start=30.0),
    }
    check_three(gateway(domains=(0, 7), bridge=True), drivers)


def check_three(found, drivers):
    found.until(all_heard(*drivers.values()))
    for n in range(6):
        for driver in drivers.values():
            driver.drive(n)
    sent = found.sent
    found.until(lambda: sum(map(len, sent.scans.values())) == 15 and sum(map(len, sent.poses.values())) == 18)
    assert sent.scans.keys() == {f"{name}/scan" for name in drivers}
    for number, name in enumerate(drivers, 1):
        poses = sent.poses[name]
        assert [pose.pose.y for pose in poses] == [10.0 * number] * 6
        assert [pose.pose.x for pose in poses] == pytest.approx([0.1 * number * n for n in range(6)])
        assert [scan.seq for scan in sent.scans[f"{name}/scan"]] == list(range(5))
    assert found.counts == {f"{name}/scan": {"sent": 5} for name in drivers}


def test_a_scan_delay_moves_the_stamp(gateway, network):
    driver = Driver(RmwZenohRobot(network()))
    found = gateway(options=Ros2Options(scan_delay=-0.02))
    found.until(all_heard(driver))
    for n in range(3):
        driver.drive(n)
    found.until(lambda: len(found.sent.scans.get("domain0/scan", ())) == 2)
    assert [scan.stamp for scan in found.sent.scans["domain0/scan"]] == [30 * MS, 130 * MS]


def test_a_missing_frame_is_no_pose_and_says_which(gateway, network, monkeypatch, caplog):
    monkeypatch.setattr("ogm_services.ros2.gateway.PATIENCE", 0.05)
    driver = Driver(RmwZenohRobot(network()))
    found = gateway()
    found.until(all_heard(driver))
    driver.drive(0)
    driver.scan(naive_cdr.laser_scan(50 * MS, "camera", (-0.5, 0.5, 0.5, 0, 0.1, 0.1, 10.0), RANGES))
    found.until(lambda: found.counts.get("/scan", {}).get("no_pose"))
    text = caplog.text
    assert "no_pose: no transform from camera to base_link: no tf says where camera is" in text
    assert "there are base_link, laser, map, odom" in text
    assert not found.sent.scans


def test_a_mount_in_the_settings_replaces_the_lasers_edge(gateway, network):
    driver = Driver(RmwZenohRobot(network()))
    rules = [SensorRule("domain0/*", mount=Pose(1.0, 2.0, 3.0))]
    found = gateway(rules=rules)
    found.until(all_heard(driver))
    driver.drive(0)
    driver.scan(naive_cdr.laser_scan(50 * MS, "unheard_of", (-0.5, 0.5, 0.5, 0, 0.1, 0.1, 10.0), RANGES))
    driver.drive(1)
    found.until(lambda: len(found.sent.scans.get("domain0/scan", ())) == 2)
    assert [scan.mount for scan in found.sent.scans["domain0/scan"]] == [
        Pose(1.0, 2.0, pytest.approx(3.0))
    ] * 2


def test_an_upside_down_laser_runs_the_other_way_and_a_tilted_one_is_refused(gateway, network, caplog):
    down = (0.2, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0)  # turned about x
    tilted = (0.2, 0.0, 0.3, math.sin(0.15), 0.0, 0.0, math.cos(0.15))
    first = Driver(RmwZenohRobot(network(), namespace="/a"), topics="/a", mount=down)
    second = Driver(RmwZenohRobot(network(), namespace="/b"), topics="/b", mount=tilted)
    found = gateway()
    found.until(all_heard(first, second))
    for n in range(2):
        first.drive(n)
        second.drive(n)
    found.until(lambda: found.counts.get("/b/scan", {}).get("tilted") and found.sent.scans.get("a/scan"))
    (scan,) = found.sent.scans["a/scan"]
    assert (scan.angle_min, scan.angle_increment) == (0.5, -0.5)
    assert "tilted by 17 degrees" in caplog.text


def test_without_a_map_frame_one_robot_is_mapped_by_odometry(gateway, network, monkeypatch, caplog):
    monkeypatch.setattr(tf_poses, "MAP_WAIT", 0.0)
    first = Driver(RmwZenohRobot(network(), namespace="/a"), topics="/a", map_frame=False)
    found = gateway()
    found.until(all_heard(first))
    for n in range(3):
        first.drive(n)
    found.until(lambda: len(found.sent.scans.get("a/scan", ())) == 2)
    assert caplog.text.count("its poses are odometry, in odom, and the map will smear") == 1
    second = Driver(RmwZenohRobot(network(), namespace="/b"), topics="/b", map_frame=False)
    found.until(all_heard(second))
    for n in range(3):
        second.drive(n)
    found.until(lambda: found.counts.get("/b/scan", {}).get("no_common_frame") == 2)
    assert "its poses are in odom, those of a in odom of a, and nothing joins the two" in caplog.text
    assert "--robot 'b:origin=X,Y,THETA'" in caplog.text
    assert found.sent.poses.keys() == {"a"}


def test_an_origin_says_where_an_odometry_lies_in_the_map(gateway, network, monkeypatch):
    monkeypatch.setattr(tf_poses, "MAP_WAIT", 0.0)
    drivers = [
        Driver(
            RmwZenohRobot(network(), namespace=f"/{name}"),
            topics=f"/{name}",
            map_frame=name == "a",
            start=3.0,
        )
        for name in "ab"
    ]
    found = gateway(robots=[RobotSettings(match="b", origin=Pose(5.0, 6.0, math.pi / 2), name="cart")])
    found.until(all_heard(*drivers))
    for n in range(3):
        for driver in drivers:
            driver.drive(n)
    found.until(lambda: len(found.sent.poses.get("cart", ())) == len(found.sent.poses.get("a", ())) == 3)
    assert found.sent.poses["cart"][2].pose == pytest.approx(Pose(5.0, 6.2, math.pi / 2))
    assert found.sent.poses["a"][2].pose == pytest.approx(Pose(0.2, 3.0, 0.0))
    assert found.sent.scans.keys() == {"a/scan", "cart/scan"}


def test_a_map_that_comes_late_begins_a_new_run(gateway, network, monkeypatch):
    monkeypatch.setattr(tf_poses, "MAP_WAIT", 0.0)
    driver = Driver(RmwZenohRobot(network()), map_frame=False, start=4.0)
    found = gateway()
    found.until(all_heard(driver))
    driver.drive(0)
    driver.drive(1)
    found.until(lambda: len(found.sent.scans.get("domain0/scan", ())) == 1)
    driver.map_frame = True
    driver.drive(2, scan=False)
    found.until(lambda: known(found, "map"))
    driver.drive(3)
    found.until(lambda: len(found.sent.scans["domain0/scan"]) == 2)
    found.until(lambda: found.sent.poses["domain0"][-1].stamp == 300 * MS)
    placed = {pose.stamp: pose.pose.y for pose in found.sent.poses["domain0"]}
    assert placed == {0: 0.0, 100 * MS: 0.0, 200 * MS: 4.0, 300 * MS: 4.0}
    assert len(found.sent.poses["domain0"]) == 4  # none in the frame of before
    assert len({scan.run for scan in found.sent.scans["domain0/scan"]}) == 2
    assert found.sent.scans["domain0/scan"][-1].run == found.sent.poses["domain0"][-1].run


def test_a_map_frame_is_waited_for(gateway, network, monkeypatch):
    monkeypatch.setattr(tf_poses, "MAP_WAIT", math.inf)
    driver = Driver(RmwZenohRobot(network()), map_frame=False)
    found = gateway()
    found.until(all_heard(driver))
    driver.drive(0)
    driver.drive(1)
    for _ in range(20):
        found.work.step(0.001)
    assert not found.sent.scans
    driver.map_frame = True
    driver.drive(0)
    driver.drive(1)
    found.until(lambda: len(found.sent.scans.get("domain0/scan", ())) == 2)


def test_the_bases_of_one_odometry_are_one_robots(gateway, network):
    robot = RmwZenohRobot(network())
    driver = Driver(robot)
    other = robot.publisher("/rear", "LaserScan")
    found = gateway()
    found.until(lambda: all_heard(driver)() and other.matching())
    footprint = ("odom", "base_footprint")
    laser = naive_cdr.tf_message([(0, "base_footprint", "rear", planar(-1.0, 0.0, 1.0))])
    robot.publisher("/tf_static", "TFMessage", latched=True)(laser)
    for n in range(3):
        driver.tf(naive_cdr.tf_message([(n * 100 * MS, *footprint, planar(0.1 * n, 0.0, 0.0, -0.1))]))
        driver.drive(n)
    other(naive_cdr.laser_scan(150 * MS, "rear", (-0.5, 0.5, 0.5, 0, 0.1, 0.1, 10.0), RANGES))
    found.until(lambda: found.sent.scans.keys() == {"domain0/scan", "domain0/rear"})
    assert found.sent.scans["domain0/rear"][0].mount == pytest.approx(Pose(-1.0, 0.0, 1.0))
    assert found.sent.poses.keys() == {"domain0"}


def test_poses_of_a_topic(gateway, network):
    robot = RmwZenohRobot(network(), namespace="/r1")
    poses, scans = robot.publisher("/r1/odom", "Odometry"), robot.publisher("/r1/scan", "LaserScan")
    options = Ros2Options(pose_topics=("/*/odom",), mount=Pose(0.5, 0.0, 1.0))
    found = gateway(options=options)
    found.until(lambda: poses.matching() and scans.matching())
    for n in range(3):
        poses(naive_cdr.odometry(n * S, "map", "base", planar(n, 1.0, 0.25)))
        scans(naive_cdr.laser_scan(n * S, "laser", (-0.5, 0.5, 0.5, 0, 0.1, 0.1, 10.0), RANGES))
    found.until(lambda: len(found.sent.scans.get("r1/scan", ())) == 3)
    assert [pose.pose for pose in found.sent.poses["r1"]] == [
        Pose(float(n), 1.0, pytest.approx(0.25)) for n in range(3)
    ]
    assert found.sent.scans["r1/scan"][0].mount == pytest.approx(Pose(0.5, 0.0, 1.0))


def test_what_is_not_what_its_topic_says_is_counted(gateway, network, caplog):
    driver = Driver(RmwZenohRobot(network()))
    found = gateway()
    found.until(all_heard(driver))
    good = naive_cdr.laser_scan(50 * MS, "laser", (-0.5, 0.5, 0.5, 0, 0.1, 0.1, 10.0), RANGES)
    for payload in (b"", good[:4], good[:-1], naive_cdr.tf_message([]) + b"xxxxxxxx"):
        driver.scan(payload)
    driver.tf(good)
    no_beam = naive_cdr.laser_scan(50 * MS, "laser", (-0.5, 0.5, 0.5, 0, 0.1, 0.1, 10.0), [])
    big = naive_cdr.laser_scan(50 * MS, "laser", (-0.5, 0.5, 0.5, 0, 0.1, 0.1, 10.0), RANGES, order=">")
    driver.drive(0)
    driver.drive(1)
    for payload in (no_beam, big, good + b"\0\0\0"):
        driver.scan(payload)
    found.until(lambda: len(found.sent.scans.get("domain0/scan", ())) == 3)
    assert found.counts["/scan"] == {"bad_cdr": 4, "malformed": 1}
    assert found.counts["/tf"] == {"bad_cdr": 1}
    assert "are not a sensor_msgs/msg/LaserScan" in caplog.text


def test_time_increment_is_told_once_and_not_used_unless_told(gateway, network, caplog):
    driver = Driver(RmwZenohRobot(network()))
    found = gateway()
    found.until(all_heard(driver))
    driver.drive(0)
    for stamp in (10, 20):
        numbers = (-0.5, 0.5, 0.5, 0.001, 0.1, 0.1, 10.0)
        driver.scan(naive_cdr.laser_scan(stamp * MS, "laser", numbers, RANGES))
    driver.drive(1)
    found.until(lambda: len(found.sent.scans.get("domain0/scan", ())) == 3)
    assert [scan.time_increment for scan in found.sent.scans["domain0/scan"]] == [0.0] * 3
    assert caplog.text.count("deskew=auto") == 1


def test_a_name_that_two_robots_have_is_the_firsts(gateway, network, caplog):
    drivers = [
        Driver(RmwZenohRobot(network(), namespace="/r"), topics="/r"),
        Driver(BridgeRobot(network(), namespace="/r")),
    ]
    found = gateway(bridge=True)
    found.until(all_heard(*drivers))
    for n in range(2):
        for driver in drivers:
            driver.drive(n)
    found.until(lambda: found.counts.get("/r/scan", {}).get("refused"))
    found.until(lambda: len(found.sent.scans.get("r/scan", ())) == 1)
    assert "its name is that of the robot of" in caplog.text


def test_clouds_become_scans(gateway, network):
    robot = RmwZenohRobot(network())
    driver = Driver(robot)
    cloud = robot.publisher("/points", "PointCloud2")
    options = Ros2Options(
        scan_delay=0.025,
        cloud_topics=("/points",),
        flattening=Flattening(0.25, 1.0, 4),
        scan_topics=("/none",),
    )
    found = gateway(options=options)
    found.until(lambda: driver.tf.matching() and cloud.matching())
    assert not driver.scan.matching()
    driver.drive(0)
    # The laser is 0.3 m high, turned by 0.5 rad: ahead of it, and below the band.
    points = struct.pack("<ffffff", 2.0 * math.cos(0.5), -2.0 * math.sin(0.5), 0.0, 1.0, 0.0, -0.2)
    named = [(name, 4 * k, 7) for k, name in enumerate("xyz")]
    cloud(naive_cdr.point_cloud2(50 * MS, "laser", (1, 2), named, (12, 24), points))
    driver.drive(1)
    found.until(lambda: found.sent.scans.get("domain0/points"))
    (scan,) = found.sent.scans["domain0/points"]
    assert scan.ranges.tolist() == pytest.approx([math.nan, math.nan, 2.0, math.nan], nan_ok=True)
    assert scan.mount == pytest.approx(Pose(0.2, 0.0, 0.0))
    assert scan.stamp == 75 * MS


class Silent:
    """A source whose subscriptions are noted."""

    form, domain, where = "rmw_zenoh", 0, "here"

    def __init__(self):
        self.taking, self.closed = [], 0

    def subscribe(self, topic, take):
        self.taking.append(take)
        return SimpleNamespace(close=lambda: setattr(self, "closed", self.closed + 1))


def test_a_topic_of_which_nothing_comes_is_subscribed_to_anew(caplog):
    source, got = Silent(), []
    reading = TopicReading(source, Topic("rmw_zenoh", "/tf", "tf2_msgs/msg/TFMessage"), got.append, 100.0)
    for now, declared in ((109.9, 1), (110.0, 2), (129.9, 2), (130.0, 3)):
        reading.look(now)
        assert (len(source.taking), source.closed) == (declared, declared - 1)
    assert "/tf of here: it is published, and nothing has come for 20 s; subscribing anew" in caplog.text
    source.taking[-1](b"x")
    reading.look(1e6)
    assert (len(source.taking), got) == (3, [b"x"])


def test_without_any_scan_it_is_said_once(gateway, network, monkeypatch, caplog):
    monkeypatch.setattr("ogm_services.ros2.gateway.NO_SCANS", 0.01)
    found = gateway()
    found.until(lambda: "no LaserScan to read has been found yet (rmw_zenoh here, domain 0)" in caplog.text)
    for _ in range(3):
        found.work.look()
    assert caplog.text.count("no LaserScan") == 1


def test_a_loop_of_frames_is_told_and_what_comes_after_it_is_mapped(gateway, network, monkeypatch, caplog):
    monkeypatch.setattr(tf_poses, "MAP_WAIT", 0.0)
    driver = Driver(RmwZenohRobot(network()), map_frame=False)
    found = gateway()
    found.until(all_heard(driver))
    driver.drive(0)
    driver.drive(1)
    found.until(lambda: len(found.sent.scans.get("domain0/scan", ())) == 1)
    driver.tf(naive_cdr.tf_message([(150 * MS, "laser", "odom", planar(0.0, 0.0, 0.0))]))
    found.until(lambda: found.work._poses[0, ""]._tree.edge("odom"))
    driver.drive(2)
    found.until(lambda: found.counts.get("/scan", {}).get("no_pose") == 1)
    assert "tf goes round in a loop: laser -> base_link -> odom -> laser" in caplog.text
    driver.map_frame = True  # which gives odom another parent
    driver.drive(3, scan=False)
    found.until(lambda: known(found, "map"))
    driver.drive(4)
    found.until(lambda: len(found.sent.scans["domain0/scan"]) == 2)


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


def test_transforms_are_read_from_the_first_look_and_scans_from_the_second():
    topics = (
        Topic("rmw_zenoh", "/r/scan", "sensor_msgs/msg/LaserScan"),
        Topic("rmw_zenoh", "/r/scan", "sensor_msgs/msg/LaserScan", publisher=False),
        Topic("rmw_zenoh", "/r/tf", "tf2_msgs/msg/TFMessage"),
        Topic("rmw_zenoh", "/r/tf_static", "tf2_msgs/msg/TFMessage", qos=Qos(transient_local=True)),
        Topic("rmw_zenoh", "/r/odom", "nav_msgs/msg/Odometry"),
        Topic("rmw_zenoh", "/r/other", "tf2_msgs/msg/TFMessage"),
        Topic("rmw_zenoh", "/r/not_scans", "std_msgs/msg/String"),
    )
    source, account = Listed(*topics), Account(LimitedLog(logging.getLogger("test")))
    work = Gateway([NamedSource(source, "domain0")], None, account, Ros2Options(), SensorRules(), 0.5)
    work.look()
    assert source.names == ["/r/tf_static", "/r/tf"]
    work.look()
    work.look()
    assert source.names == ["/r/tf_static", "/r/tf", "/r/scan"]
    work.close()
    assert source.closed == 3


def test_a_full_inbox_refuses_scans_and_no_transforms(monkeypatch):
    monkeypatch.setattr("ogm_services.ros2.inbox.MAX_WAITING", 2)
    inbox = Inbox()
    for number in range(4):
        inbox.put(Message(bytes([number]), print, "/scan"), always=False)
    inbox.put(Message(b"tf", print, "/tf"), always=True)
    assert inbox.refused() == {"/scan": 2}
    assert inbox.refused() == {}
    assert [inbox.get(0.0).payload for _ in range(3)] == [b"\0", b"\1", b"tf"]
    assert inbox.get(0.0) is None
    monkeypatch.setattr("ogm_services.ros2.inbox.MAX_WAITING_BYTES", 3)
    for _ in range(3):
        inbox.put(Message(b"xy", print, "/scan"), always=False)
    assert inbox.refused() == {"/scan": 1}


def test_poses_of_a_topic_are_one_topics_and_need_a_mount(gateway, network, caplog):
    robot = RmwZenohRobot(network(), namespace="/r1")
    first, second = (robot.publisher(f"/r1/{name}", "Odometry") for name in ("odom", "ekf"))
    scans = robot.publisher("/r1/scan", "LaserScan")
    found = gateway(options=Ros2Options(pose_topics=("/r1/*",)))
    found.until(lambda: first.matching() and second.matching() and scans.matching())
    scans(naive_cdr.laser_scan(0, "laser", (-0.5, 0.5, 0.5, 0, 0.1, 0.1, 10.0), RANGES))
    first(naive_cdr.odometry(0, "odom", "base", planar(1.0, 1.0, 0.25)))
    found.until(lambda: found.sent.poses.get("r1"))
    second(naive_cdr.odometry(S, "odom", "base", planar(2.0, 1.0, 0.25)))
    first(naive_cdr.odometry(S, "odom", "base", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    found.until(lambda: found.counts.get("/r1/ekf", {}).get("refused"))
    found.until(lambda: found.counts.get("/r1/odom", {}).get("malformed"))
    found.until(lambda: found.counts.get("/r1/scan", {}).get("no_pose"))
    assert "poses come from /r1/odom already" in caplog.text
    assert "a quaternion (x, y, z, w) of length 1 is needed" in caplog.text
    assert "--mount X,Y,THETA, or --sensor 'r1/scan:mount=X,Y,THETA'" in caplog.text
    assert "r1: there is no map frame: its poses are odometry, in odom" in caplog.text
    assert [pose.stamp for pose in found.sent.poses["r1"]] == [0]


def test_more_topics_than_can_be_read_are_refused(monkeypatch):
    monkeypatch.setattr("ogm_services.ros2.gateway.MAX_TOPICS", 1)
    topics = [Topic("rmw_zenoh", f"/r{n}/tf", "tf2_msgs/msg/TFMessage") for n in range(3)]
    account = Account(LimitedLog(logging.getLogger("test")))
    source = Listed(*topics)
    work = Gateway([NamedSource(source, "domain0")], None, account, Ros2Options(), SensorRules(), 0.5)
    work.look()
    assert (source.names, account.counts) == (["/r0/tf"], {"here": {"refused": 2}})
