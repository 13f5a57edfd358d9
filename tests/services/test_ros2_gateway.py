"""Robots of ROS 2 on a map: whose poses, which mounts, and that none are mixed."""

import math
import struct

import pytest

import naive_cdr
from gateway_desk import MS, RANGES, Driver, S, all_heard, planar
from ogm_core.placing.sensor_rules import SensorRule
from ogm_core.ros2 import cdr
from ogm_core.ros2.point_cloud import Flattening
from ogm_core.ros2.topics import Topic
from ogm_core.types import Pose
from ogm_services.ros2.options import Ros2Options
from ogm_services.ros2.sensor_feed import SensorFeed
from ogm_services.ros2.tf_poses import TfPoses
from ros2_robots import BridgeRobot, RmwZenohRobot


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


def test_a_clock_that_goes_back_by_seconds_has_poses_at_its_new_stamps(gateway, network):
    """A simulator or a recording that begins again, before the old stamps are forgotten."""
    driver = Driver(RmwZenohRobot(network()))
    found = gateway()
    found.until(all_heard(driver))
    for n in range(60):
        driver.drive(n)
    found.until(lambda: len(found.sent.poses.get("domain0", ())) == 60)
    driver.speed, driver.start = 3.0, 7.0
    for n in range(10):
        driver.drive(n)
    found.until(lambda: len(found.sent.poses["domain0"]) == 70)
    again = found.sent.poses["domain0"][60:]
    assert [pose.stamp for pose in again] == [n * 100 * MS for n in range(10)]
    assert [pose.pose for pose in again] == [Pose(pytest.approx(n * 0.3), 7.0, 0.0) for n in range(10)]


def test_three_robots_with_namespaces_are_not_mixed(gateway, network):
    drivers = {
        f"r{n}": Driver(
            RmwZenohRobot(network(), namespace=f"/r{n}"), topics=f"/r{n}", speed=n, start=10.0 * n
        )
        for n in (1, 2, 3)
    }
    check_three(gateway(), drivers)


def test_what_a_robot_says_costs_no_look_at_all_others(gateway, network, monkeypatch):
    """With fifty robots these looks took most of the time."""
    drivers = [Driver(RmwZenohRobot(network(), namespace=f"/r{n}"), topics=f"/r{n}") for n in (1, 2, 3)]
    found = gateway()
    found.until(all_heard(*drivers))
    asked, send_poses = [], TfPoses.send_poses
    monkeypatch.setattr(TfPoses, "send_poses", lambda self: asked.append(self) or send_poses(self))
    monkeypatch.setattr(found.work, "_next_look", math.inf)
    drivers[1].drive(0, scan=False)
    its_own = found.work.conversion._poses[0, "/r2"]
    while not asked:
        found.work.step(30.0)
    assert asked == [its_own]


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


def test_a_cloud_and_a_scan_are_taken_at_their_stamps_and_the_delay():
    """Which is when the sensor's place on its robot is asked for."""
    cloud = cdr.decode_point_cloud2(
        naive_cdr.point_cloud2(50 * MS, "laser", (0, 0), [("x", 0, 7)], (4, 0), b"")
    )
    numbers = (-0.5, 0.5, 0.5, 0.001, 0.1, 0.1, 10.0)
    scan = cdr.decode_laser_scan(naive_cdr.laser_scan(50 * MS, "laser", numbers, RANGES))
    feed = SensorFeed(Topic("dds", "/points", cdr.POINT_CLOUD2), 0.025, Flattening(0.0, 1.0))
    assert [feed.taken_at(message, None) for message in (cloud, scan)] == [75 * MS, 75 * MS]
    assert feed.taken_at(scan, SensorRule("*", deskew="reversed")) == 77 * MS
