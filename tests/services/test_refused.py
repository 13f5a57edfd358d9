"""Robots and sensors beyond the limits are refused, and counted; who is gone for an hour is forgotten."""

import gc

import numpy as np

from mapper_desk import MS, T0, Desk, Sink
from ogm_client import RobotPublisher
from ogm_core.logs.recordings import RecordedPose, RecordedScan, RecordingReader, write_jsonl
from ogm_core.placing import receipts as limits
from ogm_core.placing.hints import Hints
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.types import IDENTITY, Pose, PoseStamped, Scan
from ogm_core.wire.keys import MapKeys
from ogm_services.commands.log_feed import LogFeed
from ogm_services.mapper.intake.queue import ScanQueue
from ogm_services.mapper.intake.zenoh_subscriber import ZenohSubscriber
from ogm_services.settings.settings import Settings

HOUR = 3600.0
SWEEP = {"angle_min": -0.5, "angle_increment": 0.25, "range_min": 0.1, "range_max": 30.0}


def told_of(desk, source):
    return [text for whom, _, text in desk.complaints if whom == source]


def test_the_robots_that_come_after_a_thousand_are_refused_and_counted():
    desk = Desk()
    for k in range(1000):
        desk.pose(0, robot=f"r{k}", run="a")
    desk.pose(0, robot="late", run="a").scan(0, robot="late").scan(0, robot="later", pose=IDENTITY)
    desk.scan(0, robot="r7")
    status = desk.receipts.status()
    assert (status.poses.received, status.poses.refused) == (1001, 1)
    assert (status.scans.received, status.scans.integrated, status.scans.dropped["refused"]) == (3, 1, 2)
    assert (len(status.robots), "late" in status.robots, "later" in status.robots) == (1000, False, False)
    assert status.robots["r7"].sources["s"].integrated == 1


def test_the_sensors_that_come_after_sixteen_are_refused_and_counted():
    desk = Desk()
    desk.pose(0)
    for k in range(18):
        desk.scan(0, sensor=f"s{k}", run="a")
    desk.scan(0, sensor="s15", run="b").scan(0, robot="other", sensor="s17", pose=IDENTITY)
    status = desk.receipts.status()
    assert (status.scans.received, status.scans.integrated, status.scans.dropped["refused"]) == (20, 17, 2)
    assert list(status.robots["r"].sources) == [f"s{k}" for k in range(16)]
    assert list(status.robots["other"].sources) == ["s17"]


def test_a_placer_that_is_handed_more_refuses_them_itself():
    desk = Desk()
    scan = Scan(T0, 0.0, 0.1, 0.0, 8.0, np.ones(1, np.float32), pose=IDENTITY)
    for k in range(1001):
        desk.placer.add_pose(f"r{k}", PoseStamped(T0, IDENTITY, 0, "a"))
        desk.placer.robot_here(f"r{k}", "a")
    for k in (999, 1000, 1001):
        desk.placer.add_scan(f"r{k}", "s", scan)
    for k in range(17):
        desk.placer.add_scan("r0", f"s{k}", scan)
    assert (len(desk.placer._robots.items()), len(desk.placer._robots.get("r0").sources)) == (1000, 16)
    assert desk.dropped == {"refused": 3}
    assert desk.receipts.status().poses.refused == 1
    assert told_of(desk, "robots") == [
        f"messages of robot {name} are refused: 1000 others are alive, or were alive or heard within 3600 s; "
        "do robots change their names?"
        for name in ("r1000", "r1000", "r1000", "r1001")
    ]
    assert told_of(desk, "r0") == [
        "scans of sensor s16 are refused: its robot has 16 others; do sensors change their names?"
    ]


def test_who_is_gone_for_an_hour_is_forgotten_and_makes_room(monkeypatch):
    monkeypatch.setattr(limits, "MAX_ROBOTS", 3)
    desk = Desk()
    desk.pose(0, robot="gone").scan(0, robot="gone").scan(50, robot="gone")
    desk.placer.robot_here("alive", "a")
    desk.pose(0, robot="alive", run="a")
    desk.now = 10.0
    desk.pose(0, robot="heard")
    desk.placer.expire(HOUR)
    desk.now = HOUR
    assert (*desk.receipts.status().robots,) == ("gone", "alive", "heard")
    desk.scan(0, robot="new", pose=IDENTITY)
    desk.placer.expire(HOUR + 0.1)
    assert (*desk.receipts.status().robots,) == ("alive", "heard") == (*dict(desk.placer._robots.items()),)
    desk.now = HOUR + 0.2
    desk.scan(0, robot="new", pose=IDENTITY)
    status = desk.receipts.status()
    assert (*status.robots,) == ("alive", "heard", "new")
    assert (status.scans.received, status.scans.integrated, status.scans.pending) == (4, 2, 0)
    assert desk.dropped == {"no_pose": 1, "refused": 1}
    assert status.poses.received == 3
    desk.placer.robot_gone("alive", "a", desk.now)  # it is gone from here on
    desk.placer.expire(2 * HOUR)
    assert (*desk.receipts.status().robots,) == ("alive", "new")
    desk.placer.expire(2 * HOUR + 0.3)
    assert (*desk.receipts.status().robots,) == () == (*dict(desk.placer._robots.items()),)
    assert desk.receipts.status().scans == status.scans


def test_tokens_that_came_and_went_without_a_message_keep_nobody_out(monkeypatch):
    monkeypatch.setattr(limits, "MAX_ROBOTS", 3)
    desk = Desk()
    for robot in ("t1", "t2", "t3"):
        desk.placer.robot_here(robot, "a", 1.0)
    desk.placer.expire(HOUR)
    assert (*dict(desk.placer._robots.items()),) == ("t1", "t2", "t3"), "they are alive"
    desk.now = HOUR
    desk.pose(0, robot="t3", run="a")
    for robot in ("t1", "t2", "t3"):
        desk.placer.robot_gone(robot, "a", HOUR)
    desk.placer.expire(HOUR + 0.1)
    assert (*desk.receipts.status().robots,) == ("t3",) == (*dict(desk.placer._robots.items()),)
    desk.pose(0, robot="new")
    assert (*desk.receipts.status().robots,) == ("t3", "new")


def test_who_comes_back_after_that_begins_anew():
    desk = Desk()
    scan = {"run": "a", "seq": 5, "pose": IDENTITY}
    desk.scan(0, **scan).scan(0, **scan)
    desk.placer.expire(HOUR + 1)
    desk.now = HOUR + 2
    desk.scan(0, **scan)
    assert (desk.order, desk.dropped) == ([5, 5], {"duplicate": 1})
    assert desk.receipts.status().robots["r"].sources["s"].received == 1


def test_a_robot_whose_scan_is_still_in_the_queue_is_not_forgotten():
    receipts = Receipts()
    placer = ScanPlacer(None, receipts, lambda *_: None)
    assert receipts.scan_received("r", "s", 0.0)
    placer.expire(HOUR + 1)
    assert receipts.status().robots["r"].sources["s"].pending == 1
    receipts.scan_dropped("r", "s", "malformed")
    placer.expire(HOUR + 1)
    status = receipts.status()
    assert (status.robots, status.scans.received, status.scans.dropped["malformed"]) == ({}, 1, 1)


def test_where_no_times_are_told_nobody_is_forgotten():
    receipts = Receipts()
    placer = ScanPlacer(None, receipts, lambda *_: None)
    receipts.pose_received("r")
    placer.add_pose("r", PoseStamped(T0, IDENTITY))
    placer.expire(1e9)
    assert list(receipts.status().robots) == ["r"]


def test_a_hundred_thousand_robots_one_after_the_other_leave_nothing_behind():
    class Sink:
        def integrate(self, *_):
            return 0

    receipts = Receipts()
    placer = ScanPlacer(Sink(), receipts, lambda *_: None, hints=Hints())
    scan = Scan(T0 + MS, 0.0, 0.1, 0.0, 8.0, np.ones(4, np.float32), run="a")
    pose = PoseStamped(T0, Pose(0.0, 0.0, 0.0), 0, "a")

    def come(first, last):
        for k in range(first, last):
            name, now = f"robot-{k}", 300.0 * k
            placer.expire(now)
            placer.robot_here(name, "a", now)
            assert receipts.pose_received(name, now)
            placer.add_pose(name, pose, now)
            assert receipts.scan_received(name, "s", now)
            placer.add_scan(name, "s", scan, now)
            placer.robot_gone(name, "a", now)
        return len(receipts.status().robots)

    assert come(0, 100) == 13
    gc.collect()
    before = len(gc.get_objects())
    assert come(100, 100_000) == 13
    gc.collect()
    assert len(gc.get_objects()) < before + 100  # objects that hold others: far from one a robot
    scans = receipts.status().scans
    assert (scans.received, scans.pending, scans.dropped["no_pose"]) == (100_000, 1, 99_999)


def test_what_is_refused_is_not_even_queued(listener, endpoint, eventually, monkeypatch, caplog):
    monkeypatch.setattr(limits, "MAX_ROBOTS", 2)
    monkeypatch.setattr(limits, "MAX_SENSORS", 1)
    queue, receipts = ScanQueue(100), Receipts()
    placer = ScanPlacer(None, receipts, lambda *_: None)
    subscriber = ZenohSubscriber(listener, MapKeys("hall"), queue, receipts, placer, max_beams=10)
    subscriber.declare()
    options = {"address": endpoint, "map_name": "hall", "reliable": True}
    with RobotPublisher("r1", **options) as first, RobotPublisher("r2", **options) as second:
        eventually(lambda: set(receipts.status().robots) == {"r1", "r2"})
        with RobotPublisher("r3", **options) as third:
            third.wait_for_mapper(30.0)
            for _ in range(50):
                third.publish_pose(0.0, 0.0, 0.0)
                third.publish_scan([1.0], **SWEEP)
            first.wait_for_mapper(30.0)
            first.publish_scan([1.0], **SWEEP, sensor="a")
            first.publish_scan([1.0], **SWEEP, sensor="b")
            second.wait_for_mapper(30.0)
            second.publish_scan([1.0], **SWEEP, sensor="b")
            eventually(lambda: receipts.status().scans.received == 53)
            eventually(lambda: receipts.status().poses.received == 50)
    subscriber.close()
    status = receipts.status()
    assert (status.scans.dropped["refused"], status.scans.pending, status.poses.refused) == (51, 2, 50)
    queued = [item for item in iter(lambda: queue.take(0.0), None) if item.command is None]
    assert sorted(item.source for item in queued) == [("r1", "a"), ("r2", "b")]
    assert set(status.robots) == {"r1", "r2"}
    told = [record.getMessage() for record in caplog.records]
    assert any("robots: messages of robot r3 are refused: 1000 others" in text for text in told)
    assert any("r1: scans of sensor b are refused: its robot has 16 others" in text for text in told)
    assert len(told) < 10


def test_a_key_longer_than_any_of_a_message_is_ignored_and_not_remembered(listener, eventually):
    receipts = Receipts()
    placer = ScanPlacer(None, receipts, lambda *_: None)
    subscriber = ZenohSubscriber(listener, MapKeys("hall"), ScanQueue(100), receipts, placer, max_beams=10)
    subscriber.declare()
    for k in range(50):
        listener.put(f"ogm/v1/hall/robots/{'r' * 1000}{k}/pose", b"")
    listener.put("ogm/v1/hall/robots/r/elsewhere", b"")
    eventually(lambda: receipts.status().other.ignored == 51)
    assert subscriber._source_of.cache_info().currsize == 1
    subscriber.close()


def test_the_run_of_a_source_that_was_unheard_longest_is_forgotten_and_none_is_refused(mapper):
    def send(run, seq=0):
        mapper.scan([1.0], robot="r", pose=[0.0, 0.0, 0.0], run=run, seq=seq)

    for k in range(64):
        send(f"run{k}")
    send("run0", 1)  # heard again: now run1 is the one unheard longest
    send("run64")
    send("run0")
    send("run64")
    send("run1")
    status = mapper.settle(received=69)
    source = status["robots"]["r"]["sources"]["s"]
    assert (source["integrated"], source["dropped"]) == (67, {"duplicate": 2})
    assert status["scans"]["dropped"]["refused"] == 0


def test_a_log_is_read_by_the_same_limits(tmp_path):
    scan = Scan(T0, 0.0, 0.1, 0.0, 8.0, np.ones(1, np.float32), pose=IDENTITY, seq=1, run="a")
    messages = [RecordedScan(f"r{k}", "s", scan) for k in range(1001)]
    messages += [RecordedScan("r5", f"s{k}", scan) for k in range(16)]
    messages += [RecordedPose("r1000", PoseStamped(T0, IDENTITY))]
    write_jsonl(tmp_path / "log.jsonl", messages)
    sink, feed = Sink(), LogFeed(Settings())
    sink.withheld = set()
    with RecordingReader(tmp_path / "log.jsonl") as reader:
        feed.run(reader, sink, "reading")
    status = feed.receipts.status()
    assert (status.scans.received, status.scans.integrated, len(sink.placed)) == (1017, 1015, 1015)
    assert (status.scans.dropped["refused"], status.poses.refused) == (2, 1)
    of_robots, of_sensors = feed.complaints.lines()
    assert of_robots.startswith("robots: messages of robot r1000 are refused: ")
    assert of_robots.endswith(" (2 of these)")
    assert of_sensors.startswith("r5: scans of sensor s15 are refused: ")
