"""A status is made once for all who ask, and one that is dear to make is kept for a while."""

import threading
from dataclasses import replace

import pytest

from ogm_services.mapper.serving.kept_status import KeptStatus
from status_json import STATUS


class Desk:
    """A status whose revision counts how often it was made, each taking `dear` seconds of work."""

    def __init__(self, dear):
        self.dear, self.now, self.worked, self.made, self.epoch = dear, 100.0, 0.0, 0, "first"
        self.kept = KeptStatus(self.make, lambda: self.epoch, lambda: self.now, lambda: self.worked)

    def make(self):
        self.made += 1
        self.now += 2 * self.dear  # others have the machine as long
        self.worked += self.dear
        return replace(STATUS, revision=self.made, epoch=self.epoch)

    def ask_after(self, seconds):
        self.now += seconds
        told = self.kept.get()
        assert b'"revision": %d,' % told.status.revision in told.body
        return told.status.revision


def test_a_cheap_status_is_never_old():
    desk = Desk(0.009)
    assert [desk.ask_after(1e-6) for _ in range(3)] == [1, 2, 3]


@pytest.mark.parametrize(("dear", "lasts"), [(0.02, 0.2), (0.09, 0.9), (5.0, 1.0)])
def test_a_dear_status_is_kept_for_ten_times_what_it_took(dear, lasts):
    desk = Desk(dear)
    assert desk.ask_after(0.0) == 1
    assert desk.ask_after(0.9 * lasts) == 1
    assert desk.ask_after(0.2 * lasts) == 2, "no longer, and not from when it was asked for last"


def test_a_status_of_an_epoch_that_has_ended_is_not_kept():
    desk = Desk(0.5)
    desk.ask_after(0.0)
    desk.epoch = "second"
    assert desk.kept.get().status.epoch == "second"


def test_who_asks_while_one_is_made_shares_the_next():
    """The one that is being made may have been begun before something that he knows of."""
    making, go_on = threading.Semaphore(0), threading.Semaphore(0)
    asked, told = threading.Semaphore(0), []
    made = []

    def make():
        made.append(1)
        making.release()
        assert go_on.acquire(timeout=20)
        return replace(STATUS, revision=len(made))

    class Clock:
        """Tells when someone has asked: each asks for the time first, then waits."""

        now = 0.0

        def __call__(self):
            self.now += 1.0
            asked.release()
            return self.now

    kept = KeptStatus(make, lambda: STATUS.epoch, Clock(), lambda: 0.0)
    threads = [threading.Thread(target=lambda: told.append(kept.get().status.revision)) for _ in range(5)]
    threads[0].start()
    assert making.acquire(timeout=20)
    for _ in range(2):
        assert asked.acquire(timeout=20)  # of the first: when it asked, and when it began
    for thread in threads[1:]:
        thread.start()
        assert asked.acquire(timeout=20)
    go_on.release(5)
    for thread in threads:
        thread.join(20)
    assert sorted(told) == [1, 2, 2, 2, 2]
