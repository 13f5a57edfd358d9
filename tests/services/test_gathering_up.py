"""The worker lets messages gather where many come, each by itself, and waits for each where few do."""

import time

import pytest

from ogm_core.placing.receipts import Receipts
from ogm_services.mapper.intake.gathering_up import OFTEN, OFTEN_SECONDS, GatheringUp
from ogm_services.mapper.intake.message import Message
from ogm_services.mapper.intake.queue import ScanQueue
from ogm_services.mapper.intake.worker import Worker

NOW = 1000.0


def told(arrivals):
    gathering = GatheringUp()
    for arrival in arrivals:
        gathering.handled(arrival)
    return gathering


@pytest.mark.parametrize(("spacing", "worth"), [(0.8, True), (1.2, False)])
def test_messages_gather_where_they_come_at_500_a_second_or_more(spacing, worth):
    step = spacing * OFTEN_SECONDS / OFTEN
    arrivals = [NOW - k * step for k in reversed(range(OFTEN))]
    assert told(arrivals).is_worth_while(NOW + step) is worth


def test_one_after_a_silence_is_not_waited_for_and_a_few_at_once_are_not_many():
    burst = [NOW] * OFTEN
    assert told(burst).is_worth_while(NOW)
    assert not told(burst[1:]).is_worth_while(NOW)
    assert not told(burst).is_worth_while(NOW + 2 * OFTEN_SECONDS)


class Journal(ScanQueue):
    """Notes in `done` what the worker does; once it waits, it is told to stop."""

    def __init__(self, count):
        super().__init__(10)
        self.done = []
        for k in range(count):
            self.put_command(k)

    def put_command(self, name):
        self.put(Message(None, b"", time.monotonic(), lambda: self.done.append(name)))

    def take(self, timeout):
        if timeout > 0.0 and not self._items:
            self.done.append("waits")
            self.close()
        return super().take(timeout)


class Nobody:
    """A placer that nobody sends anything."""

    def expire(self, _now):
        pass


@pytest.mark.parametrize(
    ("count", "rest"), [(OFTEN, ["sleeps", "late", "sleeps", "waits"]), (OFTEN - 1, ["waits"])]
)
def test_the_worker_sleeps_and_then_takes_what_has_gathered(monkeypatch, eventually, count, rest):
    def pause(_):
        if "sleeps" not in queue.done:
            queue.put_command("late")
        queue.done.append("sleeps")

    monkeypatch.setattr("ogm_services.mapper.intake.gathering_up.OFTEN_SECONDS", 1e6)
    monkeypatch.setattr(GatheringUp, "pause", pause)
    queue = Journal(count)
    worker = Worker(queue, Nobody(), Receipts(), max_beams=10)
    worker.start()
    try:
        eventually(lambda: not worker.alive)
    finally:
        worker.stop()
    assert queue.done == [*range(count), *rest]
