"""The worker beside its queue: whatever scans go because of what one has taken, they are in the books."""

import threading
import time

import msgpack
import pytest

from ogm_core.placing.receipts import Receipts
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.wire.keys import Source
from ogm_services.mapper.intake import worker as worker_module
from ogm_services.mapper.intake.load import MAX_WORK
from ogm_services.mapper.intake.message import Message
from ogm_services.mapper.intake.queue import ScanQueue
from ogm_services.mapper.intake.work import SLOW_RATE
from ogm_services.mapper.intake.worker import LOOK_PERIOD, Worker
from ogm_services.replies.answer import Unavailable

LASER = Source("r", "s")
COUNT = 500
CELLS = 1.1e6
"""Of each scan: all of them are a second's work at the rate that is supposed at first."""


class SlowAtFirst:
    """A map for which the first scan takes as long as a rate is believed to be, by the worker's own clock."""

    def __init__(self):
        self.integrated = 0

    def integrate(self, scan, pose, sweep=None):
        end = time.thread_time() + (0.0 if self.integrated else 2 * SLOW_RATE * CELLS)
        while time.thread_time() < end:
            pass
        self.integrated += 1
        return 1


def scan(k):
    fields = {"stamp": 1_700_000_000_000_000_000 + k, "seq": k, "angle_min": 0.0, "angle_increment": 0.1}
    fields |= {"range_min": 0.0, "range_max": 8.0, "ranges": b"\0\0\x80?", "pose": [0.0, 0.0, 0.0]}
    return msgpack.packb(fields)


@pytest.fixture
def receipts():
    return Receipts()


def test_scans_that_go_when_one_has_taken_long_are_counted_as_dropped(receipts, eventually):
    queue, map_ = ScanQueue(10 * COUNT), SlowAtFirst()
    worker = Worker(queue, ScanPlacer(map_, receipts, lambda *_: None), receipts, max_beams=10)
    long_ago = time.monotonic() - 1.0
    for k in range(COUNT):
        receipts.scan_received(*LASER)
        assert queue.put(Message(LASER, scan(k), long_ago, cells=CELLS)) == []
    worker.start()
    try:
        eventually(lambda: queue.scans == 0)
        worker.do(lambda: None)  # after the last scan
    finally:
        worker.stop()
    scans = receipts.status().scans
    kept = int(MAX_WORK / (SLOW_RATE * CELLS))
    assert scans.integrated == map_.integrated == kept + 1
    assert (scans.dropped["overload"], scans.pending) == (COUNT - kept - 1, 0)
    assert receipts.status().robots["r"].sources["s"].dropped == {"overload": COUNT - kept - 1}


class Looks:
    """A placer that notes when it is asked who waits for too long."""

    def __init__(self):
        self.looks = 0

    def expire(self, _now):
        self.looks += 1


def test_a_command_that_was_refused_because_it_had_to_wait_is_not_done_later(receipts):
    """Whoever is told to try again later may do something else instead."""
    done, begun, go_on = [], threading.Event(), threading.Event()
    worker = Worker(ScanQueue(10), ScanPlacer(None, receipts, lambda *_: None), receipts, max_beams=10)
    worker.start()
    try:
        blocked = threading.Thread(target=worker.do, args=(lambda: (begun.set(), go_on.wait(60.0)),))
        blocked.start()
        assert begun.wait(60.0)
        with pytest.raises(Unavailable, match="too busy: try again later"):
            worker.do(lambda: done.append("late"), timeout=0.0)
        go_on.set()
        blocked.join()
        worker.do(lambda: done.append("next"))
    finally:
        go_on.set()
        worker.stop()
    assert done == ["next"]


def test_a_worker_that_has_stood_still_gives_nothing_up_at_once(receipts, eventually, monkeypatch):
    monkeypatch.setattr(worker_module, "PATIENCE", 1e9)
    placer, worker_waits = Looks(), threading.Event()
    worker = Worker(ScanQueue(10), placer, receipts, max_beams=10)
    worker.start()
    try:
        eventually(lambda: placer.looks > 0)
        monkeypatch.setattr(worker_module, "STOOD_STILL", 0.3)
        looks = []
        worker.do(lambda: (worker_waits.wait(0.6), looks.append(placer.looks)))
        for _ in range(5):  # each of them after a look
            worker.do(lambda: worker_waits.wait(2.0 * LOOK_PERIOD))
        assert [placer.looks] == looks
    finally:
        worker.stop()
