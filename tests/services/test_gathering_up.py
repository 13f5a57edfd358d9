"""Messages are taken in as they come where few do, and a few at a time where many come: in their order."""

import logging
import threading
import time

import pytest

from ogm_services.mapper.intake import gathering_up
from ogm_services.mapper.intake.gathering_up import MOST, OFTEN, OFTEN_SECONDS, GatheringUp


class Clock:
    """The time of the module under test; each pause waits until it may go on."""

    def __init__(self):
        self.now = 1000.0
        self.pauses = threading.Semaphore(0)
        self.paused = threading.Event()

    def monotonic(self):
        return self.now

    def sleep(self, _):
        self.paused.set()
        self.pauses.acquire()

    def go_on(self, times=1):
        self.pauses.release(times)


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(gathering_up, "time", clock)
    return clock


@pytest.fixture
def gathering(clock):
    gathering = GatheringUp()
    gathering.start()
    yield gathering
    clock.now += 2 * OFTEN_SECONDS
    clock.go_on(1000)
    gathering.stop()
    assert not gathering._thread.is_alive()


class Taken(list):
    """Names of messages, and who took them in: one of these threads."""

    def take_in(self, name, came):
        self.append((name, came, threading.current_thread().name))

    @property
    def names(self):
        return [name for name, *_ in self]


def bring_often(gathering, taken, clock, spacing=0.0):
    """So many that whatever comes next gathers, if they come often enough."""
    for _ in range(OFTEN):
        clock.now += spacing
        gathering.bring(taken.take_in, "often")
    assert taken.names == ["often"] * OFTEN
    taken.clear()


def test_where_few_come_who_brings_one_has_it_taken_in(gathering, clock):
    taken, me = Taken(), threading.current_thread().name
    bring_often(gathering, taken, clock, spacing=1.2 * OFTEN_SECONDS / OFTEN)
    gathering.bring(taken.take_in, "next")
    assert taken == [("next", clock.now, me)]


def test_where_500_a_second_come_they_gather_until_fewer_do(gathering, clock, eventually):
    taken, me = Taken(), threading.current_thread().name
    bring_often(gathering, taken, clock, spacing=0.8 * OFTEN_SECONDS / OFTEN)
    assert clock.paused.wait(20.0)
    for name in "abc":
        clock.now += 0.001
        gathering.bring(taken.take_in, name)
    assert taken == []
    clock.go_on()
    eventually(lambda: len(taken) == 3)
    assert [who for *_, who in taken] == ["ogm-intake"] * 3
    assert taken.names == ["a", "b", "c"]
    assert [came for _, came, _ in taken] == pytest.approx([clock.now - 0.002, clock.now - 0.001, clock.now])
    clock.now += OFTEN_SECONDS
    clock.go_on()
    eventually(lambda: not gathering._gathers)
    gathering.bring(taken.take_in, "late")
    assert taken[3] == ("late", clock.now, me)


def test_one_that_weighs_much_is_taken_in_at_once_after_those_before(gathering, clock):
    taken = Taken()
    bring_often(gathering, taken, clock)
    gathering.bring(taken.take_in, "a")
    gathering.bring(taken.take_in, "b", weighs=True)
    assert taken.names == ["a", "b"]


def test_only_so_many_gather_then_who_brings_one_takes_them_in(gathering, clock):
    taken = Taken()
    bring_often(gathering, taken, clock)
    for k in range(MOST):
        gathering.bring(taken.take_in, k)
    assert taken == []
    gathering.bring(taken.take_in, MOST)
    assert taken.names == list(range(MOST + 1))


def test_who_brings_too_many_waits_for_who_is_at_it(gathering, eventually):
    taken, at_it, may_go_on = Taken(), threading.Event(), threading.Event()

    def slowly(name, came):
        at_it.set()
        assert may_go_on.wait(20.0)
        taken.take_in(name, came)

    brings = [
        threading.Thread(target=lambda: gathering.bring(slowly, "slow")),
        threading.Thread(target=lambda: gathering.bring(taken.take_in, "last")),
    ]
    brings[0].start()
    assert at_it.wait(20.0)
    for k in range(MOST):
        gathering.bring(taken.take_in, k)  # left to the one that is at it
    brings[1].start()
    eventually(lambda: len(gathering._waiting) == MOST + 1)
    assert brings[1].is_alive()
    may_go_on.set()
    for thread in brings:
        thread.join(20.0)
    assert taken.names == ["slow", *range(MOST), "last"]


def test_what_waits_at_the_end_is_taken_in(clock):
    taken, gathering = Taken(), GatheringUp()
    bring_often(gathering, taken, clock)
    gathering.bring(taken.take_in, "waits")
    assert taken == []
    gathering.stop()
    assert taken.names == ["waits"]


def test_one_that_fails_is_told_of_and_the_others_are_taken_in(gathering, clock, caplog):
    taken = Taken()
    bring_often(gathering, taken, clock)
    gathering.bring(lambda *_: 1 / 0, "bad")
    with caplog.at_level(logging.ERROR):
        gathering.bring(taken.take_in, "good", weighs=True)
    assert taken.names == ["good"]
    assert "taking in a message failed" in caplog.text
    assert "ZeroDivisionError" in caplog.text


def test_none_of_many_threads_is_lost_or_overtaken():
    gathering, taken = GatheringUp(), []

    def bring_all(who):
        for k in range(2000):
            gathering.bring(lambda message, _: taken.append(message), (who, k), weighs=k % 50 == 49)
            if k % 500 == 499:
                time.sleep(0.1)  # until fewer come

    threads = [threading.Thread(target=bring_all, args=(who,)) for who in range(4)]
    gathering.start()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    gathering.stop()
    for who in range(4):
        assert [k for by, k in taken if by == who] == list(range(2000))
    assert len(taken) == 8000
