"""Resuming through the subscriber and the queue: what was decided stays so, and a backlog leaves room."""

import threading
import time
from collections import Counter
from contextlib import ExitStack

import numpy as np
import pytest

from ogm_client import RobotPublisher
from ogm_client.session import NetworkConfig, open_session
from ogm_core.placing.receipts import Receipts
from ogm_core.types import Scan
from ogm_core.wire.heads import read_head
from ogm_core.wire.keys import MapKeys, Source
from ogm_core.wire.messages import encode_scan
from ogm_services.mapper.intake.caches import Account, Caches
from ogm_services.mapper.intake.handing_on import skipping
from ogm_services.mapper.intake.message import Message
from ogm_services.mapper.intake.queue import MAX_POSES, MAX_POSES_OF_ROBOT, ScanQueue
from ogm_services.mapper.intake.reception import Reception
from ogm_services.mapper.intake.worker import Worker
from ogm_services.mapper.intake.zenoh_subscriber import ZenohSubscriber

KEYS = MapKeys("hall")
SWEEP = {"angle_min": 0.0, "angle_increment": 0.0001, "range_min": 0.1, "range_max": 30.0}


class Decided:
    """What was decided: seqs by (sensor or None, run)."""

    def __init__(self, **up_to):
        self.seqs = {(sensor, "a"): set(range(last + 1)) for sensor, last in up_to.items()}
        self.dropped = []

    def is_decided(self, robot, sensor, run, seq):
        return seq in self.seqs.get((sensor, run), ())

    def last(self, robot, sensor, run):
        seqs = self.seqs.get((sensor, run))
        return None if not seqs else next(k for k in range(len(seqs) + 1) if k not in seqs) - 1

    def wait_on(self, robot, until):
        pass

    def drop_unnumbered(self, robot, sensor, outcome):
        self.dropped.append(outcome)

    def skip(self, robot, sensor, run, first, last, outcome="lost", count=None):
        self.seqs.setdefault((sensor, run), set()).update(range(first, last + 1))
        if sensor is not None:
            self.dropped += [outcome] * (last + 1 - first if count is None else count)


class Placer:
    """Has decided something, takes robots' tokens, and nothing else."""

    def __init__(self, decided):
        self.decided = decided

    def robot_here(self, *_):
        pass

    robot_gone = robot_here


@pytest.fixture
def robot(listener, endpoint):
    with RobotPublisher("r", address=endpoint, map_name="hall", run="a") as robot:
        yield robot


@pytest.fixture
def subscribed(listener):
    """`subscribed(queue, decided)`: a subscriber that asks, and its receipts."""
    open_ones = []

    def make(queue, decided):
        receipts = Receipts()
        subscriber = ZenohSubscriber(listener, KEYS, queue, receipts, Placer(decided), max_beams=1000)
        open_ones.append(subscriber)
        subscriber.declare()
        return receipts

    yield make
    for subscriber in open_ones:
        subscriber.close()


@pytest.fixture
def published(listener, robot, eventually):
    """`published(count)`: so many messages that are in the caches; none of them comes by itself any more."""
    caches = Caches(listener, KEYS, lambda _: 1_000_000)

    def make(count):
        publish(robot, count)
        # What a robot answers comes after all that it has published before.
        eventually(lambda: caches.ask("r", caches.keys_of("r"), "_max=1", Account()).messages)

    return make


def publish(robot, count, first=0):
    for stamp in range(first, first + count):
        robot.publish_pose(0.0, 0.0, 0.0, stamp=stamp)
        robot.publish_scan([1.0] * 20, sensor="s", stamp=stamp, **SWEEP)


def test_a_backlog_fills_no_more_than_its_part_of_the_queue(published, subscribed, eventually):
    """600 scans and as many poses for a queue of 100 scans, that are worked off slowly."""
    published(600)
    queue, most, taken = ScanQueue(100), [0], []

    def work():
        while not queue.closed:
            item = queue.take(0.1)
            if item is not None and item.source is not None:
                most[0] = max(most[0], queue.scans + 1)
                taken.append((item.source.sensor, read_head(item.payload)[1]))
                time.sleep(0.0005)

    worker = threading.Thread(target=work)
    worker.start()
    receipts = subscribed(queue, Decided())
    eventually(lambda: len(taken) == 1200)
    queue.close()
    worker.join()
    assert taken == [(sensor, seq) for seq in range(600) for sensor in (None, "s")]
    status = receipts.status()
    assert (status.scans.received, status.scans.dropped["overload"]) == (600, 0)
    assert 10 < most[0] <= 26


def test_what_was_decided_is_neither_received_nor_queued(published, subscribed, eventually):
    published(50)
    decided = Decided(s=29)
    decided.seqs[None, "a"] = set(range(45))
    decided.seqs["s", "a"] |= {35, 36}
    queue = ScanQueue(100)
    receipts = subscribed(queue, decided)
    eventually(lambda: receipts.status().scans.received == 18 and receipts.status().poses.received == 5)
    taken = [queue.take(0) for _ in range(23)]
    seqs = [read_head(item.payload)[1] for item in taken if item.source is not None and item.source.sensor]
    status = receipts.status()
    assert (status.scans.received, status.poses.received) == (18, 5)
    status = receipts.status()
    assert status.scans.replayed >= 2
    assert status.scans.lost == status.poses.lost == 0
    assert seqs == [30, 31, 32, 33, 34, *range(37, 50)]


def test_what_a_mapper_dropped_or_could_not_read_is_decided():
    decided, receipts = Decided(), Receipts()
    queue = ScanQueue(2, dropping=skipping(decided, "overload"))
    for seq in range(5):
        queue.put(Message(Source("r", "s"), scan(seq), 0.0))
    assert decided.seqs["s", "a"] == {0, 1, 2}
    worker = Worker(queue, Placer(decided), receipts, max_beams=2, malformed=skipping(decided, "malformed"))
    worker.start()
    queue.put(Message(Source("r", None), b"bad", 0.0))
    deadline = time.monotonic() + 30.0
    while 4 not in decided.seqs["s", "a"] and time.monotonic() < deadline:
        time.sleep(0.01)
    worker.stop()
    assert decided.seqs == {("s", "a"): {0, 1, 2, 3, 4}}
    assert decided.dropped == ["overload"] * 3 + ["malformed"] * 2


def scan(seq):
    return encode_scan(Scan(seq, 0.0, 0.1, 0.1, 30.0, np.ones(3, np.float32), seq=seq, run="a"))


def put(queue, robot, count, sensor="s", *, resumed=True):
    for seq in range(count):
        queue.put(Message(Source(robot, sensor), scan(seq), time.monotonic(), resumed=resumed))


def test_a_queue_has_room_while_what_is_resumed_takes_less_than_a_part_of_it():
    queue = ScanQueue(100)
    put(queue, "live", 1, resumed=False)
    put(queue, "a", 24)
    assert queue.has_room("a", 0.25)
    put(queue, "b", 1)
    assert not queue.has_room("a", 0.25)
    assert not queue.has_room("b", 0.25)
    assert not queue.has_room("live", 0.25)
    assert queue.has_room("c", 0.25)  # nothing of it waits
    queue.take(0)  # the live one
    assert not queue.has_room("a", 0.25)
    queue.take(0)
    assert queue.has_room("a", 0.25)


def test_what_is_not_resumed_takes_no_room_but_that_of_its_own_robot():
    queue = ScanQueue(100)
    put(queue, "flood", 60, resumed=False)
    put(queue, "a", 10)
    assert queue.has_room("a", 0.25)
    assert not queue.has_room("flood", 0.25)


def test_what_is_dropped_takes_no_room():
    queue = ScanQueue(100)
    put(queue, "a", 25)
    put(queue, "b", 1)
    assert not queue.has_room("b", 0.25)
    put(queue, "a", 100, resumed=False)  # which drops all that is resumed of it
    assert queue.has_room("b", 0.25)


def test_a_queue_has_room_by_the_work_that_scans_will_be():
    queue = ScanQueue(1000, cells_of=lambda *_: 0.2e9)  # 0.4 s each, of 5 s
    put(queue, "a", 3)
    assert queue.has_room("a", 0.25)
    put(queue, "b", 1)
    assert not queue.has_room("a", 0.25)
    queue.worked(queue.take(0), 0.01)  # they take less time
    assert queue.has_room("a", 0.25)


def test_a_queue_has_room_for_poses_likewise():
    queue = ScanQueue(100)
    put(queue, "a", MAX_POSES_OF_ROBOT // 4 - 1, sensor=None)
    assert queue.has_room("a", 0.25)
    put(queue, "a", 1, sensor=None)
    assert not queue.has_room("a", 0.25)
    for k in range(MAX_POSES // MAX_POSES_OF_ROBOT - 1):
        put(queue, f"b{k}", MAX_POSES_OF_ROBOT // 4, sensor=None)
    put(queue, "c", 1, sensor=None)
    assert not queue.has_room("c", 0.25)
    queue.take(0), queue.take(0)
    assert queue.has_room("c", 0.25)


def test_many_robots_that_are_resumed_fill_no_more_than_their_part_and_one_each(
    listener, endpoint, subscribed, eventually
):
    """30 robots of 40 scans for a queue of 100: what is held of them meanwhile takes no more room, either."""
    queue, most, taken = ScanQueue(100), [0], Counter()
    with open_session(NetworkConfig(connect=(endpoint,))) as session, ExitStack() as open_ones:
        names = [f"r{k}" for k in range(30)]
        robots = [
            open_ones.enter_context(RobotPublisher(name, session=session, map_name="hall", run="a"))
            for name in names
        ]
        for robot in robots:
            publish(robot, 40)
        receipts = subscribed(queue, Decided())
        for robot in robots:
            robot.wait_for_mapper(30.0)
        eventually(lambda: queue.scans >= 25)  # nobody works yet: all robots are held
        for robot in robots:
            publish(robot, 10, first=40)

        def work():
            while not queue.closed:
                item = queue.take(0.1)
                if item is not None and item.source is not None and item.source.sensor:
                    most[0] = max(most[0], queue.scans + 1)
                    taken[item.source.robot] += 1
                    time.sleep(0.0005)

        worker = threading.Thread(target=work)
        worker.start()
        eventually(lambda: taken.total() == 30 * 50 or receipts.status().scans.dropped["overload"])
        queue.close()
        worker.join()
    assert receipts.status().scans.dropped["overload"] == 0
    assert taken == dict.fromkeys(names, 50)
    assert 25 < most[0] <= 25 + 30


def test_a_message_that_is_too_long_is_counted_and_not_asked_for(robot, subscribed, eventually):
    queue = ScanQueue(100)
    receipts = subscribed(queue, Decided())
    robot.wait_for_mapper(30.0)
    robot.publish_scan([1.0], sensor="s", stamp=0, **SWEEP)
    robot.publish_scan([1.0] * 9000, sensor="s", stamp=1, **SWEEP)
    robot.publish_scan([1.0], sensor="s", stamp=2, **SWEEP)
    eventually(lambda: receipts.status().scans.received == 3)
    assert receipts.status().scans.dropped["malformed"] == 1
    assert receipts.status().scans.lost == 0
    assert queue.scans == 2


def test_what_is_lost_is_said_in_the_log(caplog):
    reception = Reception(ScanQueue(10), Receipts(), max_beams=10)
    reception.lost(Source("r", "s"), 3, "a", range(4, 9), "not kept")
    reception.lost(Source("q", None), 2, "b", range(7, 9), "no answer")
    reception.lost(Source("p", "s"), 1, "", range(0), "not held")
    assert caplog.messages == [
        "r/s: 3 scans are lost, of seq 4 to 8 of run 'a': they did not arrive, and no publisher of the robot "
        "keeps them",
        "q/pose: 2 poses are lost, of seq 7 to 8 of run 'b': they did not arrive, and publishers of the "
        "robot that may keep them did not answer",
        "p/s: 1 scans are lost: more came than is held while the robot's publishers are asked, and without a "
        "number",
    ]
