"""Robots of ROS 2 that cannot be mapped, or not yet: what is refused, waited for, counted and told."""

import logging
import math

import pytest

import naive_cdr
from gateway_desk import MS, RANGES, Driver, Listed, S, Silent, all_heard, known, planar
from ogm_core.placing.sensor_rules import SensorRules
from ogm_core.ros2.topics import Qos, Topic
from ogm_core.types import Pose
from ogm_services.ros2 import tf_poses
from ogm_services.ros2.account import Account
from ogm_services.ros2.gateway import Gateway, NamedSource
from ogm_services.ros2.inbox import Inbox, Message
from ogm_services.ros2.options import Ros2Options
from ogm_services.ros2.topic_reading import TopicReading
from ogm_services.runtime.limited_log import LimitedLog
from ogm_services.settings.robots import RobotSettings
from ros2_robots import BridgeRobot, RmwZenohRobot


def test_a_missing_frame_is_no_pose_and_says_which(gateway, network, monkeypatch, caplog):
    monkeypatch.setattr("ogm_services.ros2.conversion.PATIENCE", 0.05)
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


def test_what_is_wrong_with_transforms_is_told(gateway, network, caplog):
    """Else the robot's owner would hear of a missing frame, which is there for all to see."""
    driver = Driver(RmwZenohRobot(network()))
    found = gateway()
    found.until(all_heard(driver))
    driver.static(naive_cdr.tf_message([(0, "base_link", "rear", (0.0,) * 7)]))
    driver.tf(naive_cdr.tf_message([(0, "base_link", "", planar(0.0, 0.0, 0.0))]))
    found.until(lambda: found.counts.get("/tf_static") and found.counts.get("/tf"))
    driver.tf(naive_cdr.tf_message([(0, "base_footprint", "laser", planar(0.0, 0.0, 0.0))]))
    found.until(lambda: len(found.counts["/tf"]) == 2)
    assert found.counts == {"/tf_static": {"bad_transform": 1}, "/tf": {"no_name": 1, "reparented": 1}}
    assert "base_link -> rear: rotation: a quaternion (x, y, z, w) of length 1 is needed" in caplog.text
    assert "base_link -> '' (empty): names of frames have 1 to 256 characters" in caplog.text
    assert "base_footprint -> laser: its parent was base_link before" in caplog.text


def test_a_pose_in_no_frame_is_refused(gateway, network, caplog):
    robot = RmwZenohRobot(network(), namespace="/r1")
    poses, scans = robot.publisher("/r1/odom", "Odometry"), robot.publisher("/r1/scan", "LaserScan")
    found = gateway(options=Ros2Options(pose_topics=("/r1/odom",), mount=Pose(0.5, 0.0, 1.0)))
    found.until(lambda: poses.matching() and scans.matching())
    poses(naive_cdr.odometry(0, "", "base", planar(1.0, 1.0, 0.25)))
    found.until(lambda: found.counts == {"/r1/odom": {"malformed": 1}})
    assert "its frame_id is empty" in caplog.text
    scans(naive_cdr.laser_scan(S, "laser", (-0.5, 0.5, 0.5, 0, 0.1, 0.1, 10.0), RANGES))
    poses(naive_cdr.odometry(S, "map", "base", planar(1.0, 1.0, 0.25)))
    found.until(lambda: len(found.sent.scans.get("r1/scan", ())) == 1)
    assert [pose.stamp for pose in found.sent.poses["r1"]] == [S]


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
    found.until(lambda: found.work.conversion._poses[0, ""]._tree.edge("odom"))
    driver.drive(2)
    found.until(lambda: found.counts.get("/scan", {}).get("no_pose") == 1)
    assert "tf goes round in a loop: laser -> base_link -> odom -> laser" in caplog.text
    driver.map_frame = True  # which gives odom another parent
    driver.drive(3, scan=False)
    found.until(lambda: known(found, "map"))
    driver.drive(4)
    found.until(lambda: len(found.sent.scans["domain0/scan"]) == 2)


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
