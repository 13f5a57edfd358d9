"""Turns at threads: in order, bounded in number and in time, and finished when they are closed."""

import threading

import pytest

from ogm_services.replies import turns as turns_module
from ogm_services.replies.answer import Busy, Unavailable
from ogm_services.replies.turns import MAX_QUESTIONS, TURN_PATIENCE, Turns

DEADLINE = 20.0


@pytest.fixture
def turns():
    turns = Turns("test", threads=1, waiting=3)
    yield turns
    turns.close()


@pytest.fixture
def held(turns):
    """The one thread is busy until this is set."""
    begun, go_on = threading.Event(), threading.Event()

    def hold():
        begun.set()
        assert go_on.wait(DEADLINE)
        return "held"

    go_on.outcome = turns.take(hold)
    assert begun.wait(DEADLINE)
    yield go_on
    go_on.set()


def test_the_defaults():
    assert (MAX_QUESTIONS, TURN_PATIENCE) == (64, 5.0)


def test_what_is_returned_or_raised_is_handed_on(turns):
    assert turns.take(lambda: 7).result(DEADLINE) == 7
    with pytest.raises(ZeroDivisionError):
        turns.take(lambda: 1 / 0).result(DEADLINE)
    assert turns.take(lambda: 8).result(DEADLINE) == 8


def test_they_come_in_order_and_past_so_many_none_is_taken(turns, held):
    order = []
    waiting = [turns.take(lambda k=k: order.append(k)) for k in range(3)]
    with pytest.raises(Busy, match=r"^3 others wait for test already: try again later$"):
        turns.take(lambda: order.append("refused")).result(0)
    held.set()
    for outcome in waiting:
        outcome.result(DEADLINE)
    assert order == [0, 1, 2]
    assert held.outcome.result(DEADLINE) == "held"
    assert turns.take(lambda: 9).result(DEADLINE) == 9


def test_who_waits_too_long_is_refused_and_nothing_is_done_for_him(turns, held, monkeypatch):
    monkeypatch.setattr(turns_module, "TURN_PATIENCE", 0.2)
    done = []
    late = turns.take(lambda: done.append("late"))
    with pytest.raises(Busy, match=r"^test: no turn came within 0.2 s: try again later$"):
        late.result(DEADLINE)
    held.set()
    turns.take(lambda: done.append("next")).result(DEADLINE)
    assert done == ["next"]


def test_who_has_gone_costs_nothing(turns, held):
    done = []
    assert turns.take(lambda: done.append("gone")).cancel()
    stays = turns.take(lambda: done.append("stays"))
    held.set()
    stays.result(DEADLINE)
    assert done == ["stays"]


def test_closing_refuses_who_waits_and_finishes_what_is_in_hand(held, turns):
    waiting = turns.take(lambda: 1)
    closing = threading.Thread(target=turns.close)
    closing.start()
    with pytest.raises(Unavailable, match="stopping"):
        waiting.result(DEADLINE)
    assert not held.outcome.done()
    held.set()
    closing.join(DEADLINE)
    assert held.outcome.result(0) == "held"
    with pytest.raises(Unavailable, match="stopping"):
        turns.take(lambda: 1).result(0)
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("ogm-test")]
