"""The queue is fair to robots: who fills it loses by it, and nobody else; with a clock that is told."""

import random
import threading
from collections import Counter

import pytest

from ogm_core.wire.keys import Source
from ogm_services.mapper.intake import queue as queue_module
from ogm_services.mapper.intake.load import MAX_WORK
from ogm_services.mapper.intake.message import Message
from ogm_services.mapper.intake.queue import ScanQueue
from ogm_services.mapper.intake.work import FIRST_RATE

HONEST = Source("honest", "laser")
DEADLINE = 10.0


def scan(robot, sensor="s", *, seconds=0.0, size=100):
    """A scan that looks like so many seconds of work, at the rate that is supposed at first."""
    return Message(Source(robot, sensor), b"." * size, 0.0, cells=max(1.0, seconds / FIRST_RATE))


def at_rate(rate, seconds, make):
    """Arrivals of a robot: (time, message, whatever `make` gives of the number)."""
    return [(k / rate, make(k)) for k in range(round(rate * seconds))]


def run(queue, arrivals, takes):
    """Let a worker that takes `takes(message)` seconds handle arrivals.

    Returns how many were put and how many got in, by robot, and the honest robot's longest wait, s.
    """
    put, got_in, clock = Counter(), Counter(), 0.0
    longest = 0.0
    waiting = sorted(arrivals, key=lambda entry: entry[0])[::-1]
    while True:
        while waiting and waiting[-1][0] <= clock:
            at, message = waiting.pop()
            message.arrival = at
            put[message.source.robot] += 1
            queue.put(message)
        message = queue.take(0)
        if message is None:
            if not waiting:
                return put, got_in, longest
            clock = waiting[-1][0]
            continue
        seconds = takes(message)
        clock += seconds
        got_in[message.source.robot] += 1
        if message.source == HONEST:
            longest = max(longest, clock - message.arrival)
        queue.worked(message, seconds)


@pytest.mark.parametrize("names", [1, 300])
def test_a_flood_under_any_number_of_sensor_names_takes_nothing_from_an_honest_robot(names):
    honest = at_rate(20, 5.0, lambda k: scan(*HONEST, seconds=0.001))
    flood = at_rate(10_000, 5.0, lambda k: scan("flood", f"s{k % names}", seconds=0.001))
    put, got_in, _ = run(ScanQueue(4096), honest + flood, lambda _: 0.001)
    assert (got_in["honest"], put["honest"]) == (100, 100)
    assert 0.09 < got_in["flood"] / put["flood"] < 0.2  # and all that the worker has time for of the other's


@pytest.mark.parametrize("each_second", [1, 2, 10])
def test_a_robot_whose_scans_are_a_second_of_work_each_takes_nothing_from_one_of_20_hz(each_second):
    honest = at_rate(20, 60.0, lambda k: scan(*HONEST, seconds=0.001))
    heavy = at_rate(each_second, 60.0, lambda k: scan("heavy", seconds=1.0))
    put, got_in, longest = run(
        ScanQueue(4096), honest + heavy, lambda message: 1.0 if message.source.robot == "heavy" else 0.001
    )
    assert got_in["honest"] == put["honest"] == 1200
    assert longest < MAX_WORK + 2.0
    assert got_in["heavy"] >= 0.9 * 60


def test_scans_that_look_small_and_take_long_are_found_out():
    honest = at_rate(20, 60.0, lambda k: scan(*HONEST, seconds=0.001))
    heavy = at_rate(10, 60.0, lambda k: scan("sly", seconds=0.001))
    put, got_in, longest = run(
        ScanQueue(4096), honest + heavy, lambda message: 1.0 if message.source.robot == "sly" else 0.001
    )
    assert got_in["honest"] == put["honest"] == 1200
    assert longest < 30.0  # the first four are one surprise after the other


def test_small_scans_and_then_large_ones_are_found_out():
    honest = at_rate(20, 60.0, lambda k: scan(*HONEST, seconds=0.001))
    small = at_rate(100, 30.0, lambda k: scan("sly", seconds=0.0001))
    large = [(30.0, scan("sly", seconds=1.0)) for _ in range(1000)]
    put, got_in, longest = run(
        ScanQueue(4096), honest + small + large, lambda message: message.cells * FIRST_RATE
    )
    assert got_in["honest"] == put["honest"] == 1200
    assert longest < MAX_WORK + 2.0


def test_scans_that_look_large_and_take_no_time_are_found_out():
    """As those that are refused at a glance; the robot loses none of them once that is known."""
    queue = ScanQueue(4096)
    for _ in range(4):
        queue.put(scan("far", seconds=4.0))
        queue.worked(queue.take(0), 0.001)
    assert [queue.put(scan("far", seconds=4.0)) for _ in range(100)] == [[]] * 100
    assert queue.work == pytest.approx(0.1)


def test_what_looked_cheap_and_turns_out_dear_goes_at_once_though_nothing_more_comes():
    queue = ScanQueue(4096)
    for _ in range(4):
        queue.put(scan("sly", seconds=1.0))
        queue.worked(queue.take(0), 0.0001)
    for k in range(200):
        assert queue.put(scan("sly", str(k), seconds=1.0)) == []
    assert queue.put(scan(*HONEST, seconds=0.001)) == []
    gone = queue.worked(queue.take(0), 1.0)
    assert gone == [Source("sly", str(k)) for k in range(1, 181)]  # the oldest, a quarter of a second each
    assert queue.work == pytest.approx(MAX_WORK, abs=0.26)


def test_one_moment_in_which_the_machine_stood_still_costs_nothing():
    queue = ScanQueue(4096)
    for _ in range(100):
        queue.put(scan(*HONEST, seconds=0.001))
    assert queue.worked(queue.take(0), 3.0) == []
    assert queue.worked(queue.take(0), 3.0) == []
    assert queue.worked(queue.take(0), 3.0) == []
    assert queue.worked(queue.take(0), 3.0) != []


def test_poses_time_is_their_robots_scans_time():
    """A scan that waits for its pose is integrated when that comes."""
    queue = ScanQueue(4096)
    for _ in range(8):
        queue.put(scan("late", seconds=1.0))
        queue.put(Message(Source("late", None), b"pose", 0.0))
        queue.worked(queue.take(0), 0.0)
        queue.worked(queue.take(0), 2.0)
    queue.put(scan("late", seconds=1.0))
    queue.put(scan("other", seconds=1.0))
    assert queue.work == pytest.approx(3.0)


def test_work_is_what_waits_and_0_without_a_rest_when_nothing_does():
    queue, rng = ScanQueue(10**6), random.Random(1)
    robots = [f"r{k}" for k in range(7)]
    for _ in range(5000):
        queue.put(scan(rng.choice(robots), seconds=rng.uniform(0.0, 1e-4)))
        if rng.random() < 0.6:
            queue.worked(queue.take(0), rng.uniform(0.0, 2e-4))
    assert queue.work > 0.0
    assert queue.bytes == queue.scans * 100
    while queue.take(0) is not None:
        pass
    assert (queue.work, queue.bytes, queue.scans) == (0.0, 0, 0)


def test_a_robot_of_few_large_scans_loses_none_to_many_small_ones():
    queue = ScanQueue(100)
    for _ in range(3):
        queue.put(scan("large", seconds=0.9))
    gone = [source for _ in range(200) for source in queue.put(scan("small", seconds=1e-6))]
    assert gone == [Source("small", "s")] * 103


def test_long_messages_that_say_nothing_go_before_scans():
    queue = ScanQueue(100, max_bytes=12_500)  # 10,000 of scans
    for _ in range(4):
        queue.put(scan(*HONEST, seconds=0.5, size=100))
    gone = [source for _ in range(20) for source in queue.put(scan("noise", size=900))]
    assert gone == [Source("noise", "s")] * 10


def naive_loser(waiting, queue_scans):
    """The robot with the largest share, by a look at all that waits."""
    shares = {}
    for robot in {message.source.robot for message in waiting}:
        its = [message for message in waiting if message.source.robot == robot]
        shares[robot] = max(
            sum(message.cells for message in its) * FIRST_RATE / MAX_WORK, len(its) / queue_scans
        )
    return shares


def test_the_robot_that_loses_is_the_one_with_the_largest_share_among_many():
    rng = random.Random(2)
    queue, waiting = ScanQueue(60), []
    for k in range(3000):
        if rng.random() < 0.3:
            taken = queue.take(0)
            if taken is not None:
                waiting.remove(taken)
        message = scan(f"r{rng.randrange(30)}", str(k), seconds=rng.choice([0.001, 0.05, 0.4]))
        waiting.append(message)
        for source in queue.put(message):
            shares = naive_loser(waiting, 60)
            lost = next(message for message in waiting if message.source == source)
            assert shares[source.robot] == pytest.approx(max(shares.values()))
            assert lost is next(m for m in waiting if m.source.robot == source.robot)
            waiting.remove(lost)
    assert queue.scans == len(waiting)


def test_tokens_take_room_of_their_robot_and_are_never_dropped(monkeypatch):
    monkeypatch.setattr(queue_module, "MAX_POSES_OF_ROBOT", 3)
    queue = ScanQueue(1)
    for _ in range(3):
        queue.put(Message(None, b"", 0.0, lambda: None, robot="a"))
    sender = threading.Thread(target=queue.put, args=(Message(Source("a", None), b"", 0.0),), daemon=True)
    sender.start()
    sender.join(0.1)
    assert sender.is_alive()
    assert queue.put(Message(Source("b", None), b"", 0.0)) == []  # another robot's does not wait
    assert queue.put(Message(None, b"", 0.0, lambda: None)) == []  # nor does a command of the mapper's own
    assert queue.take(0).robot == "a"
    sender.join(DEADLINE)
    assert not sender.is_alive()


def test_robots_that_are_gone_are_forgotten(monkeypatch):
    monkeypatch.setattr("ogm_services.mapper.intake.load.MAX_RATES", 50)
    queue = ScanQueue(4096)
    queue.put(scan("waits", seconds=0.5))
    for k in range(1000):
        queue.put(scan(f"r{k}"))
        assert queue.take(0) is not None
    assert len(queue._load.robots) <= 50
    queue = ScanQueue(4096)
    for k in range(100):  # all of them wait
        queue.put(scan(f"r{k}", seconds=0.01))
    assert queue.work == pytest.approx(1.0)
