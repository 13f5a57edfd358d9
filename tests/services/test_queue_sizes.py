"""The queue looks how large scans are only once they wait: at all of them then, whatever came meanwhile."""

import random

import pytest

from ogm_core.wire.keys import Source
from ogm_services.mapper.intake import queue as queue_module
from ogm_services.mapper.intake.load import MAX_WORK
from ogm_services.mapper.intake.message import Message
from ogm_services.mapper.intake.queue import BEHIND, ScanQueue
from ogm_services.mapper.intake.work import FIRST_RATE

LONG_AGO = -1e9
"""Of the monotonic clock, s: what came then has waited for long."""


class Sizes:
    """As many cells as a payload says in seconds of work; counts who asked."""

    def __init__(self):
        self.asked = 0

    def __call__(self, source, payload):
        self.asked += 1
        return max(1.0, float(payload) / FIRST_RATE)


def scan(robot, seconds, arrival):
    return Message(Source(robot, "s"), str(seconds).encode(), arrival)


def test_nobody_looks_while_no_scan_waits_for_long():
    sizes = Sizes()
    queue = ScanQueue(10**6, sizes)
    for k in range(1000):
        assert queue.put(scan("a", 1.0, k * BEHIND / 1001)) == []
    assert (sizes.asked, queue.work) == (0, 0.0)


def test_once_they_wait_each_is_looked_at_once():
    sizes = Sizes()
    queue = ScanQueue(10**6, sizes)
    for k in range(1000):
        queue.put(scan("a", 0.001, k * BEHIND / 1001))
    for k in range(20):
        queue.put(scan("b", 0.001, 2 * BEHIND + k))
    assert sizes.asked == 1020
    assert queue.work == pytest.approx(1.02)


def test_a_worker_that_takes_what_waited_has_the_others_looked_at():
    queue = ScanQueue(10**6, Sizes())
    for _ in range(60):
        queue.put(scan("heavy", 1.0, LONG_AGO))
    queue.put(scan("honest", 0.001, LONG_AGO))
    assert not queue.behind
    first = queue.take(0)
    assert queue.behind
    gone = queue.worked(first, 1.0)
    assert gone == [Source("heavy", "s")] * 55
    assert queue.work == pytest.approx(MAX_WORK, abs=1.0)
    assert queue.work <= MAX_WORK


def test_many_bytes_are_looked_at_a_few_scans_at_a_time(monkeypatch):
    monkeypatch.setattr(queue_module, "LOOKS_BYTES", 100)
    sizes = Sizes()
    queue = ScanQueue(10**6, sizes)
    for _ in range(50):
        queue.put(Message(Source("a", "s"), b"0.001".ljust(40), 0.0))
    queue.put(scan("b", 0.001, 2 * BEHIND))
    assert sizes.asked == 3


def test_work_is_right_whatever_is_looked_at_dropped_or_taken_in_between(monkeypatch):
    monkeypatch.setattr(queue_module, "LOOKS", 3)
    rng, queue, waiting = random.Random(3), ScanQueue(40, Sizes()), []
    for k in range(4000):
        message = scan(f"r{rng.randrange(5)}", rng.choice([0.001, 0.02]), 0.01 * k)
        waiting.append(message)
        for source in queue.put(message):
            waiting.remove(next(each for each in waiting if each.source.robot == source.robot))
        if rng.random() < 0.7:
            waiting.remove(queue.take(0))
        seen = sum(each.cells for each in waiting if each.cells is not None) * FIRST_RATE
        assert queue.work == pytest.approx(seen)
        assert queue.scans == len(waiting)
