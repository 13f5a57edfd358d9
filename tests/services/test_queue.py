"""The queue between Zenoh's callback and the worker: in order, bounded, and no pose lost."""

import threading
import time
from collections import Counter

import pytest

from ogm_core.wire.keys import Source
from ogm_services.mapper.intake import queue as inbox_module
from ogm_services.mapper.intake.queue import Inbox, Item

A, B, C = Source("a", "s"), Source("b", "s"), Source("a", "t")
POSE = Source("a", None)
DEADLINE = 10.0


def item(source, name="", size=0):
    return Item(source, name.encode().ljust(size, b"."), time.monotonic())


def put_all(inbox, *entries):
    """Put (source, name) pairs; return the sources of what had to go, one list a put."""
    return [inbox.put(item(source, name)) for source, name in entries]


def drain(inbox):
    """Payloads of everything that can be taken at once."""
    taken = []
    while (got := inbox.take(0)) is not None:
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
    inbox = Inbox(10)
    gone = put_all(inbox, (A, "1"), (POSE, "2"), (B, "3"), (None, "4"), (A, "5"), (POSE, "6"))
    assert gone == [[]] * 6
    assert drain(inbox) == ["1", "2", "3", "4", "5", "6"]


def test_an_empty_inbox_gives_nothing_after_the_timeout():
    inbox = Inbox(10)
    assert inbox.take(0) is None
    start = time.monotonic()
    assert inbox.take(0.05) is None
    assert time.monotonic() - start >= 0.05


def test_an_item_comes_as_it_was_put():
    inbox = Inbox(10)
    called = []
    command = Item(None, b"", 3.5, command=lambda: called.append(1))
    scan = item(A, "scan")
    inbox.put(command)
    inbox.put(scan)
    assert inbox.take(0) is command
    assert inbox.take(0) is scan
    command.command()
    assert called == [1]


def test_overload_drops_the_oldest_scan_of_the_fullest_source():
    inbox = Inbox(4)
    assert put_all(inbox, (A, "a1"), (B, "b1"), (B, "b2"), (B, "b3")) == [[]] * 4
    assert put_all(inbox, (A, "a2"), (B, "b4")) == [[B], [B]]
    assert drain(inbox) == ["a1", "b3", "a2", "b4"]


def test_sensors_of_one_robot_are_sources_of_their_own():
    inbox = Inbox(5)
    put_all(inbox, (A, "a1"), (C, "c1"), (C, "c2"), (C, "c3"), (B, "b1"))
    assert put_all(inbox, (A, "a2")) == [[C]]
    assert drain(inbox) == ["a1", "c2", "c3", "b1", "a2"]


def test_a_lone_source_keeps_its_newest_scans():
    inbox = Inbox(3)
    gone = put_all(inbox, *((A, str(k)) for k in range(10)))
    assert gone == [[]] * 3 + [[A]] * 7
    assert drain(inbox) == ["7", "8", "9"]


def test_room_comes_back_with_what_is_taken():
    inbox = Inbox(2)
    put_all(inbox, (A, "1"), (A, "2"))
    assert inbox.take(0).payload == b"1"
    assert put_all(inbox, (A, "3")) == [[]]
    assert put_all(inbox, (A, "4")) == [[A]]
    assert drain(inbox) == ["3", "4"]
    assert put_all(inbox, (B, "5"), (B, "6")) == [[], []]
    assert drain(inbox) == ["5", "6"]


def test_poses_and_commands_take_no_room_and_are_never_dropped():
    inbox = Inbox(1)
    entries = [(POSE, f"p{k}") for k in range(50)] + [(None, "command")]
    assert put_all(inbox, *entries) == [[]] * 51
    assert put_all(inbox, (A, "1"), (A, "2"), (POSE, "last")) == [[], [A], []]
    assert drain(inbox) == [name for _, name in entries] + ["2", "last"]


def test_a_dropped_scan_gives_its_payload_back():
    inbox = Inbox(1)
    first = item(A, "1", size=1000)
    inbox.put(first)
    inbox.put(item(A, "2"))
    assert first.dropped
    assert first.payload == b""


def test_bytes_are_limited_too(monkeypatch):
    monkeypatch.setattr(inbox_module, "MAX_BYTES", 1000)
    inbox = Inbox(100)
    assert inbox.put(item(A, "a1", 400)) == []
    assert inbox.put(item(B, "b1", 300)) == []
    assert inbox.put(item(A, "a2", 300)) == []
    assert inbox.put(item(POSE, "p", 5000)) == []
    assert inbox.put(item(A, "a3", 2)) == [A]
    assert inbox.put(item(A, "a4", 398)) == []
    assert [name.rstrip(".") for name in drain(inbox)] == ["b1", "a2", "p", "a3", "a4"]


def test_one_message_may_drop_several_scans(monkeypatch):
    monkeypatch.setattr(inbox_module, "MAX_BYTES", 1000)
    inbox = Inbox(100)
    for k in range(5):
        inbox.put(item(A, str(k), 200))
    assert inbox.put(item(A, "big", 900)) == [A] * 5
    assert [name.rstrip(".") for name in drain(inbox)] == ["big"]


def test_a_single_scan_beyond_the_limit_is_kept(monkeypatch):
    monkeypatch.setattr(inbox_module, "MAX_BYTES", 1000)
    inbox = Inbox(100)
    assert inbox.put(item(A, "huge", 5000)) == []
    assert inbox.put(item(A, "next", 10)) == [A]
    assert [name.rstrip(".") for name in drain(inbox)] == ["next"]
    assert inbox.put(item(A, "x", 600)) == []
    assert inbox.put(item(A, "y", 400)) == []


def test_take_waits_for_a_message(in_thread):
    inbox = Inbox(10)
    taken = []
    taker = in_thread(lambda: taken.append(inbox.take(None)))
    assert waits(taker)
    scan = item(A, "1")
    inbox.put(scan)
    taker.join(DEADLINE)
    assert taken == [scan]


def test_too_many_poses_make_their_sender_wait(in_thread, monkeypatch):
    monkeypatch.setattr(inbox_module, "MAX_POSES", 3)
    inbox = Inbox(10)
    put_all(inbox, (POSE, "1"), (POSE, "2"), (POSE, "3"))
    sender = in_thread(put_all, inbox, (POSE, "4"))
    assert waits(sender)
    assert put_all(inbox, (A, "scan")) == [[]]  # scans do not wait
    assert inbox.take(0).payload == b"1"
    sender.join(DEADLINE)
    assert not sender.is_alive()
    assert drain(inbox) == ["2", "3", "scan", "4"]


def test_close_wakes_everyone_and_ends_the_taking(in_thread, monkeypatch):
    monkeypatch.setattr(inbox_module, "MAX_POSES", 1)
    inbox, empty = Inbox(10), Inbox(10)
    taken = []
    inbox.put(item(POSE, "1"))
    senders = [in_thread(put_all, inbox, (POSE, str(k))) for k in range(3)]
    takers = [in_thread(lambda: taken.append(empty.take(None))) for _ in range(3)]
    assert all(map(waits, senders + takers))
    assert not inbox.closed
    inbox.close()
    empty.close()
    for thread in senders + takers:
        thread.join(DEADLINE)
    assert taken == [None] * 3
    assert inbox.closed
    assert inbox.take(None) is None
    inbox.put(item(POSE, "late"))
    assert inbox.take(0) is None


def test_many_senders_and_one_taker_lose_nothing_that_was_not_said_to_go(in_thread, eventually):
    inbox, senders, each = Inbox(20), 4, 1500
    gone = [[] for _ in range(senders)]
    taken = []

    def send(number):
        source = Source(f"r{number}", "s")
        for k in range(each):
            gone[number] += inbox.put(item(source, f"{number} {k}"))
            if k % 3 == 0:
                inbox.put(item(Source(f"r{number}", None), f"{number} pose{k}"))

    def take():
        while (got := inbox.take(None)) is not None:
            taken.append(got)

    taker = in_thread(take)
    threads = [in_thread(send, number) for number in range(senders)]
    for thread in threads:
        thread.join(DEADLINE)
    poses = senders * each // 3
    lost = sum(map(len, gone))
    eventually(lambda: len(taken) + lost == senders * each + poses, DEADLINE)
    inbox.close()
    taker.join(DEADLINE)
    assert sum(got.source.sensor is None for got in taken) == poses
    assert len(taken) == senders * each + poses - lost
    dropped = Counter(source for sources in gone for source in sources)
    for source in (Source(f"r{number}", "s") for number in range(senders)):
        seqs = [int(got.payload.split()[1]) for got in taken if got.source == source]
        assert seqs == sorted(set(seqs))
        assert len(seqs) == each - dropped[source]
