"""A thread leaves the processor that another one needs, and may use all of its own again afterwards."""

import os
import sys
import threading

import pytest

from ogm_core.sensor_models import processors, update_threads
from ogm_core.sensor_models.processors import NONE, leave, processor
from ogm_core.sensor_models.update_threads import UpdateThreads

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells a thread its processor")


@pytest.fixture
def on_one_of_several():
    """This thread's processor, and all that it may use; it does not leave the first by itself."""
    allowed = os.sched_getaffinity(0)
    if len(allowed) < 2:
        pytest.skip("this machine has one processor: there is none to go to")
    mine = min(allowed)
    os.sched_setaffinity(0, {mine})
    yield mine, allowed
    os.sched_setaffinity(0, allowed)


def test_a_thread_leaves_a_processor_and_stays_on_any_other(on_one_of_several, monkeypatch):
    mine, allowed = on_one_of_several
    assert processor() == mine
    set_to = []
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: [allowed, *set_to][-1])
    monkeypatch.setattr(os, "sched_setaffinity", lambda _, these: set_to.append(these))
    leave(mine + 1)
    leave(NONE)
    assert set_to == []
    leave(mine)
    assert set_to == [allowed - {mine}, allowed]


def test_what_somebody_else_lets_it_use_meanwhile_stays(on_one_of_several, monkeypatch):
    mine, allowed = on_one_of_several
    set_to = []

    def set_and_set(_, these):
        set_to.append(these)
        set_to.append({mine})

    monkeypatch.setattr(os, "sched_getaffinity", lambda _: [allowed, *set_to][-1])
    monkeypatch.setattr(os, "sched_setaffinity", set_and_set)
    leave(mine)
    assert set_to == [allowed - {mine}, {mine}]


def test_where_the_system_refuses_it_stays(on_one_of_several, monkeypatch):
    """As in a sandbox, or where the processors have just been taken from the process."""
    mine, allowed = on_one_of_several
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: allowed)

    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setaffinity", refuse)
    leave(mine)
    monkeypatch.undo()
    assert processor() == mine


def test_it_has_left_at_once(on_one_of_several):
    mine, allowed = on_one_of_several
    gone = 0
    for _ in range(20):
        os.sched_setaffinity(0, {mine})
        os.sched_setaffinity(0, allowed)
        leave(mine)
        gone += processor() != mine
        assert os.sched_getaffinity(0) == allowed
    assert gone > 10  # a busy machine may send it back


def test_where_there_is_no_other_processor_it_stays(on_one_of_several):
    mine, _ = on_one_of_several
    leave(mine)
    assert os.sched_getaffinity(0) == {mine}


def test_where_no_system_call_tells_the_processor_threads_stay(monkeypatch):
    monkeypatch.setattr(processors, "_sched_getcpu", None)
    assert processor() == NONE
    monkeypatch.delattr(os, "sched_setaffinity")
    leave(processor())


def test_a_thread_that_is_woken_up_leaves_its_callers_processor(monkeypatch):
    left = []
    done = threading.Event()
    monkeypatch.setattr(update_threads, "processor", lambda: 5)
    monkeypatch.setattr(update_threads, "leave", left.append)
    with UpdateThreads(2) as threads:
        threads._start(1)
        threads._wake(0, done.set)
        assert done.wait(30.0)
    assert left == [5]
