"""The queue between Zenoh's callback and the worker: in order, bounded, and no pose lost."""

import threading
import time
from collections import Counter

import pytest

from ogm_core.wire.keys import Source
from ogm_services.mapper.intake import queue as queue_module
from ogm_services.mapper.intake.message import Message
from ogm_services.mapper.intake.queue import ScanQueue

A, B, C = Source("a", "s"), Source("b", "s"), Source("a", "t")
POSE = Source("a", None)
DEADLINE = 10.0


def item(source, name="", size=0):
    return Message(source, name.encode().ljust(size, b"."), time.monotonic())


def put_all(queue, *entries):
    """Put (source, name) pairs; return the sources of what had to go, one list a put."""
    return [queue.put(item(source, name)) for source, name in entries]


def drain(queue):
    """Payloads of everything that can be taken at once."""
    taken = []
    while (got := queue.take(0)) is not None:
        taken.append(got.payload.decode())
    return taken


def waits(thread):
    """Whether a started thread is blocked: it does not end within a moment."""
    thread.join(0.1)
    return thread.is_alive()


@pytest.fixture
def in_thread():
    """Run a function in a thread; the threads must have ended when the test has."""
    threads = []

    def start(function, *args):
        thread = threading.Thread(target=function, args=args, daemon=True)
        threads.append(thread)
        thread.start()
        return thread

    yield start
    for thread in threads:
        thread.join(DEADLINE)
        assert not thread.is_alive()


def test_messages_are_taken_in_order_of_arrival():
    queue = ScanQueue(10)
    gone = put_all(queue, (A, "1"), (POSE, "2"), (B, "3"), (None, "4"), (A, "5"), (POSE, "6"))
    assert gone == [[]] * 6
    assert drain(queue) == ["1", "2", "3", "4", "5", "6"]


def test_an_empty_queue_gives_nothing_after_the_timeout():
    queue = ScanQueue(10)
    assert queue.take(0) is None
    start = time.monotonic()
    assert queue.take(0.05) is None
    assert time.monotonic() - start >= 0.05


def test_an_item_comes_as_it_was_put():
    queue = ScanQueue(10)
    called = []
    command = Message(None, b"", 3.5, command=lambda: called.append(1))
    scan = item(A, "scan")
    queue.put(command)
    queue.put(scan)
    assert queue.take(0) is command
    assert queue.take(0) is scan
    command.command()
    assert called == [1]


def test_overload_drops_the_oldest_scan_of_the_fullest_robot():
    queue = ScanQueue(4)
    assert put_all(queue, (A, "a1"), (B, "b1"), (B, "b2"), (B, "b3")) == [[]] * 4
    assert put_all(queue, (A, "a2"), (B, "b4")) == [[B], [B]]
    assert drain(queue) == ["a1", "b3", "a2", "b4"]


def test_a_robot_loses_its_oldest_scan_whichever_sensor_took_it():
    queue = ScanQueue(5)
    put_all(queue, (A, "a1"), (C, "c1"), (B, "b1"), (B, "b2"), (C, "c2"))
    assert put_all(queue, (B, "b3"), (B, "b4")) == [[A], [B]]
    assert drain(queue) == ["c1", "b2", "c2", "b3", "b4"]


def test_a_lone_source_keeps_its_newest_scans():
    queue = ScanQueue(3)
    gone = put_all(queue, *((A, str(k)) for k in range(10)))
    assert gone == [[]] * 3 + [[A]] * 7
    assert drain(queue) == ["7", "8", "9"]


def test_room_comes_back_with_what_is_taken():
    queue = ScanQueue(2)
    put_all(queue, (A, "1"), (A, "2"))
    assert queue.take(0).payload == b"1"
    assert put_all(queue, (A, "3")) == [[]]
    assert put_all(queue, (A, "4")) == [[A]]
    assert drain(queue) == ["3", "4"]
    assert put_all(queue, (B, "5"), (B, "6")) == [[], []]
    assert drain(queue) == ["5", "6"]


def test_poses_and_commands_take_no_room_and_are_never_dropped():
    queue = ScanQueue(1)
    entries = [(POSE, f"p{k}") for k in range(50)] + [(None, "command")]
    assert put_all(queue, *entries) == [[]] * 51
    assert put_all(queue, (A, "1"), (A, "2"), (POSE, "last")) == [[], [A], []]
    assert drain(queue) == [name for _, name in entries] + ["2", "last"]


def test_a_dropped_scan_gives_its_payload_back():
    queue = ScanQueue(1)
    first = item(A, "1", size=1000)
    queue.put(first)
    queue.put(item(A, "2"))
    assert first.dropped
    assert first.payload == b""


def test_bytes_are_limited_too():
    queue = ScanQueue(100, max_bytes=1250)  # 1000 of scans
    assert queue.put(item(A, "a1", 400)) == []
    assert queue.put(item(B, "b1", 300)) == []
    assert queue.put(item(A, "a2", 300)) == []
    assert queue.put(item(POSE, "p", 5000)) == []
    assert queue.put(item(A, "a3", 2)) == [A]
    assert queue.put(item(A, "a4", 398)) == []
    assert [name.rstrip(".") for name in drain(queue)] == ["b1", "a2", "p", "a3", "a4"]


def test_scans_and_poses_together_take_no_more_than_the_limit(in_thread):
    queue = ScanQueue(10_000, max_bytes=1250)

    def flood():
        for _ in range(50):
            queue.put(item(POSE, size=20))

    sender = in_thread(flood)
    assert waits(sender)
    for _ in range(100):
        queue.put(item(A, size=30))
    assert queue.bytes == 12 * 20 + 33 * 30 <= 1250
    most = 0
    while queue.take(0) is not None or sender.is_alive():
        most = max(most, queue.bytes)
    while queue.take(0) is not None:  # what came between the last look and the sender's end
        pass
    assert most <= 1250
    assert queue.bytes == 0


def test_a_pose_longer_than_the_room_for_poses_is_taken_alone(in_thread):
    queue = ScanQueue(10, max_bytes=100)
    queue.put(item(POSE, "long", 50))
    sender = in_thread(queue.put, item(POSE, "next"))
    assert waits(sender)
    assert queue.take(0).payload.startswith(b"long")
    sender.join(DEADLINE)
    assert drain(queue) == ["next"]


def test_one_message_may_drop_several_scans():
    queue = ScanQueue(100, max_bytes=1250)  # 1000 of scans
    for k in range(5):
        queue.put(item(A, str(k), 200))
    assert queue.put(item(A, "big", 900)) == [A] * 5
    assert [name.rstrip(".") for name in drain(queue)] == ["big"]


def test_a_single_scan_beyond_the_limit_is_kept():
    queue = ScanQueue(100, max_bytes=1250)  # 1000 of scans
    assert queue.put(item(A, "huge", 5000)) == []
    assert queue.put(item(A, "next", 10)) == [A]
    assert [name.rstrip(".") for name in drain(queue)] == ["next"]
    assert queue.put(item(A, "x", 600)) == []
    assert queue.put(item(A, "y", 400)) == []


def test_take_waits_for_a_message(in_thread):
    queue = ScanQueue(10)
    taken = []
    taker = in_thread(lambda: taken.append(queue.take(None)))
    assert waits(taker)
    scan = item(A, "1")
    queue.put(scan)
    taker.join(DEADLINE)
    assert taken == [scan]


def test_too_many_poses_make_their_sender_wait(in_thread, monkeypatch):
    monkeypatch.setattr(queue_module, "MAX_POSES", 3)
    queue = ScanQueue(10)
    put_all(queue, (POSE, "1"), (POSE, "2"), (POSE, "3"))
    sender = in_thread(put_all, queue, (POSE, "4"))
    assert waits(sender)
    assert put_all(queue, (A, "scan")) == [[]]  # scans do not wait
    assert queue.take(0).payload == b"1"
    sender.join(DEADLINE)
    assert not sender.is_alive()
    assert drain(queue) == ["2", "3", "scan", "4"]


def test_close_wakes_everyone_and_ends_the_taking(in_thread, monkeypatch):
    monkeypatch.setattr(queue_module, "MAX_POSES", 1)
    queue, empty = ScanQueue(10), ScanQueue(10)
    taken = []
    queue.put(item(POSE, "1"))
    senders = [in_thread(put_all, queue, (POSE, str(k))) for k in range(3)]
    takers = [in_thread(lambda: taken.append(empty.take(None))) for _ in range(3)]
    assert all(map(waits, senders + takers))
    assert not queue.closed
    queue.close()
    empty.close()
    for thread in senders + takers:
        thread.join(DEADLINE)
    assert taken == [None] * 3
    assert queue.closed
    assert queue.take(None) is None
    queue.put(item(POSE, "late"))
    assert queue.take(0) is None


def test_many_senders_and_one_taker_lose_nothing_that_was_not_said_to_go(in_thread, eventually):
    queue, senders, each = ScanQueue(20), 4, 1500
    gone = [[] for _ in range(senders)]
    taken = []

    def send(number):
        source = Source(f"r{number}", "s")
        for k in range(each):
            gone[number] += queue.put(item(source, f"{number} {k}"))
            if k % 3 == 0:
                queue.put(item(Source(f"r{number}", None), f"{number} pose{k}"))

    def take():
        while (got := queue.take(None)) is not None:
            taken.append(got)

    taker = in_thread(take)
    threads = [in_thread(send, number) for number in range(senders)]
    for thread in threads:
        thread.join(DEADLINE)
    poses = senders * each // 3
    lost = sum(map(len, gone))
    eventually(lambda: len(taken) + lost == senders * each + poses, DEADLINE)
    queue.close()
    taker.join(DEADLINE)
    assert sum(got.source.sensor is None for got in taken) == poses
    assert len(taken) == senders * each + poses - lost
    dropped = Counter(source for sources in gone for source in sources)
    for source in (Source(f"r{number}", "s") for number in range(senders)):
        seqs = [int(got.payload.split()[1]) for got in taken if got.source == source]
        assert seqs == sorted(set(seqs))
        assert len(seqs) == each - dropped[source]
