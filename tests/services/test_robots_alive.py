"""Who is there: robots' liveliness tokens reach the mapper, after the messages that came before."""

import logging
import threading
from dataclasses import replace

import pytest

from ogm_client import RobotPublisher
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.types import Pose, PoseStamped
from ogm_core.wire.keys import MapKeys
from ogm_core.wire.values import scan_of
from ogm_services.mapper.intake.queue import ScanQueue
from ogm_services.mapper.intake.zenoh_subscriber import ZenohSubscriber
from ogm_services.runtime.limited_log import LimitedLog

SWEEP = {"angle_min": -0.5, "angle_increment": 0.25, "range_min": 0.1, "range_max": 30.0}
T0 = 1_700_000_000_000_000_000


@pytest.fixture
def mapper(start_mapper):
    with start_mapper() as mapper:
        yield mapper


def publisher(mapper, robot, **options):
    return RobotPublisher(robot, address=mapper.endpoint, map_name="hall", reliable=True, **options)


def robot_of(mapper, name):
    return mapper.status()["robots"].get(name, {"alive": None, "age_s": None})


def test_robots_are_alive_until_they_leave(mapper, eventually):
    with publisher(mapper, "r1") as robot:
        eventually(lambda: robot_of(mapper, "r1")["alive"])
        assert robot_of(mapper, "r1")["age_s"] is None  # it has not said anything
        robot.publish_pose(0.0, 0.0, 0.0)
        eventually(lambda: robot_of(mapper, "r1")["age_s"] is not None)
        age = robot_of(mapper, "r1")["age_s"]
        eventually(lambda: robot_of(mapper, "r1")["age_s"] > age)
        robot.publish_pose(0.0, 0.0, 0.0)
        with publisher(mapper, "r1", run="second"):
            eventually(lambda: mapper.status()["poses"]["received"] == 2)
        assert robot_of(mapper, "r1")["alive"]  # the other run of the robot is
    eventually(lambda: robot_of(mapper, "r1")["alive"] is False)


def test_a_robot_that_was_there_before_the_mapper_is_alive(start_mapper, listener, endpoint, eventually):
    with (
        RobotPublisher("early", session=listener, map_name="hall"),
        start_mapper(
            network={"listen": [], "connect": [endpoint]},
        ) as mapper,
    ):
        eventually(lambda: robot_of(mapper, "early")["alive"])


def test_a_run_that_was_replaced_owns_again_when_its_heir_is_gone(mapper, eventually):
    """Two localisations of one robot: the newest has the say as long as it lives."""

    def pose(robot, k):
        robot.publish_pose(0.01 * k, 0.0, 0.0, stamp=T0 + 100_000_000 * k)

    def poses(name):
        return mapper.status()["poses"][name]

    with publisher(mapper, "r1", run="old") as old:
        pose(old, 0)
        with publisher(mapper, "r1", run="new") as new:
            eventually(lambda: poses("received") == 1)
            pose(new, 1)
            eventually(lambda: poses("received") == 2)
            pose(old, 2)
            eventually(lambda: poses("superseded") == 1)
            pose(new, 3)
        eventually(lambda: [*mapper.session.liveliness().get("ogm/v1/hall/alive/robot/r1/*")][1:] == [])
        pose(old, 4)
        eventually(lambda: mapper.status()["robots"]["r1"]["stamp"] == T0 + 400_000_000)
        assert poses("superseded") == 1


def test_a_robot_goes_on_after_a_replay_of_its_name_and_of_recorded_runs(mapper, eventually):
    def drive(put_pose, put_scan, first, count):
        for k in range(first, first + count):
            stamp = T0 + 100_000_000 * k
            put_pose(k, stamp)
            put_scan(k, stamp)

    def live(robot):
        return (
            lambda k, stamp: robot.publish_pose(0.01 * k, 0.0, 0.0, stamp=stamp),
            lambda k, stamp: robot.publish_scan([1.0], **SWEEP, stamp=stamp),
        )

    def recorded(robot):
        scan = scan_of([1.0], **SWEEP)
        return (
            lambda k, stamp: robot.put_pose(PoseStamped(stamp, Pose(0.0, 0.01 * k, 0.0), k, "x.recorded")),
            lambda k, stamp: robot.put_scan("laser", replace(scan, stamp=stamp, seq=k, run="x.recorded")),
        )

    with publisher(mapper, "r1", run="live") as robot:
        drive(*live(robot), 0, 5)
        mapper.settle(received=5)
        with publisher(mapper, "r1", run="x") as replay:
            drive(*recorded(replay), 0, 5)
            eventually(lambda: mapper.status()["scans"]["received"] == 10)
        eventually(lambda: [*mapper.session.liveliness().get("ogm/v1/hall/alive/robot/r1/*")][1:] == [])
        drive(*live(robot), 5, 20)
        robot.publish_pose(0.3, 0.0, 0.0, stamp=T0 + 100_000_000 * 25)
        scans = mapper.settle(received=30)["scans"]
    assert (scans["integrated"], scans["dropped"]["superseded"]) == (30, 0)


def test_the_worker_hears_of_the_end_after_the_messages_that_came_before(listener, endpoint, eventually):
    keys, queue, receipts, calls = MapKeys("hall"), ScanQueue(10), Receipts(), []

    class Placer(ScanPlacer):
        def robot_here(self, name, run, now):
            calls.append(("here", name, run, threading.current_thread()))

        def robot_gone(self, name, run, now):
            calls.append(("gone", name, run, threading.current_thread()))

    placer = Placer(None, receipts, LimitedLog(logging.getLogger(__name__)).of_kind)
    subscriber = ZenohSubscriber(listener, keys, queue, receipts, placer, max_beams=10)
    subscriber.declare()
    with RobotPublisher("r1", address=endpoint, map_name="hall", run="a", reliable=True) as robot:
        robot.wait_for_mapper(30.0)
        robot.publish_scan([1.0], **SWEEP)
        # In Zenoh a token's end may overtake messages; here they stay as they came.
        eventually(lambda: receipts.status().scans.received == 1)
    taken = [queue.take(30.0) for _ in range(3)]
    subscriber.close()
    assert [item.source for item in taken] == [None, ("r1", "laser"), None]
    assert calls == []  # not yet: it is for the worker
    for item in taken:
        if item.command is not None:
            item.command()
    me = threading.current_thread()
    assert calls == [("here", "r1", "a", me), ("gone", "r1", "a", me)]


def test_feedback_is_what_became_of_a_robots_scans(mapper, eventually):
    with publisher(mapper, "r1") as robot, publisher(mapper, "r2") as other:
        assert robot.feedback().sources == {}
        robot.wait_for_mapper(30.0)
        for stamp in range(3):
            robot.publish_scan([1.0], **SWEEP, pose=(0.0, 0.0, 0.0), stamp=stamp, sensor="front")
        robot.publish_scan([1.0], **SWEEP, stamp=7, sensor="rear")
        robot.publish_pose(0.0, 0.0, 0.0, stamp=8)
        other.publish_scan([1.0], **SWEEP, pose=(0.0, 0.0, 0.0))
        eventually(lambda: mapper.settle(received=5))
        told = robot.feedback()
        assert (told.alive, told.stamp) == (True, 8)
        assert told.age_s >= 0.0
        assert told.sources.keys() == {"front", "rear"}
        front, rear = told.sources["front"], told.sources["rear"]
        assert (front.run, front.last_seq, front.received, front.integrated) == (robot.run, 2, 3, 3)
        assert (rear.received, rear.integrated, rear.dropped) == (1, 0, {"stale": 1})
        assert (told.gone, front.dropped, front.hints) == (False, {}, [])
