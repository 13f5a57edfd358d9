"""A thread that sleeps is kept off its waker's processor, and may use all of its own once it is awake."""

import os
import sys
import threading

import pytest

from ogm_core.sensor_models import helper as helper_module
from ogm_core.sensor_models import processors
from ogm_core.sensor_models.helper import Helper
from ogm_core.sensor_models.processors import KeptOff, keep_off, let_back

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells a thread its processor")


@pytest.fixture
def several():
    """The processors that this thread may use; two at least. It may use them again at the end."""
    allowed = os.sched_getaffinity(0)
    if len(allowed) < 2:
        pytest.skip("this machine has one processor: a thread can be kept off no other's")
    yield allowed
    os.sched_setaffinity(0, allowed)


@pytest.fixture
def sleeper():
    """The native id of a thread that sleeps."""
    awake = threading.Event()
    thread = threading.Thread(target=awake.wait)
    thread.start()
    yield thread.native_id
    awake.set()
    thread.join()


def test_a_thread_is_kept_off_this_ones_processor_and_let_back(several, sleeper):
    mine = max(several)
    os.sched_setaffinity(0, {mine})
    kept_off = keep_off(sleeper)
    assert kept_off == KeptOff(several, several - {mine})
    assert os.sched_getaffinity(sleeper) == several - {mine}
    os.sched_setaffinity(0, kept_off.others)
    let_back(kept_off)
    assert os.sched_getaffinity(0) == several


def test_one_that_runs_elsewhere_or_nowhere_else_stays_as_it_is(several, sleeper):
    mine, *others = sorted(several)
    os.sched_setaffinity(0, {mine})
    for its in ({mine}, set(others)):
        os.sched_setaffinity(sleeper, its)
        assert keep_off(sleeper) is None
        assert os.sched_getaffinity(sleeper) == its


def test_what_somebody_else_lets_it_use_meanwhile_stays(several):
    one = {min(several)}
    os.sched_setaffinity(0, one)
    let_back(KeptOff(several, several - one))
    assert os.sched_getaffinity(0) == one


def test_where_the_system_refuses_it_stays_as_it_is(several, sleeper, monkeypatch):
    """As in a sandbox, or where the processors have just been taken from the process."""

    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    with monkeypatch.context() as patch:
        patch.setattr(os, "sched_setaffinity", refuse)
        assert keep_off(sleeper) is None
        let_back(KeptOff(several, several))
    assert os.sched_getaffinity(sleeper) == several


def test_where_no_system_call_tells_the_processor_threads_stay_as_they_are(sleeper, monkeypatch):
    monkeypatch.setattr(processors, "_sched_getcpu", None)
    monkeypatch.delattr(os, "sched_setaffinity")
    assert keep_off(sleeper) is None


def test_a_helper_wakes_up_elsewhere_and_may_use_all_processors_when_it_begins(several):
    helper = Helper("helping")
    try:
        for mine in several:
            os.sched_setaffinity(0, {mine})
            os.sched_setaffinity(helper._thread.native_id, several)
            found, done = [], threading.Event()

            def look(found=found, done=done):
                found.append(os.sched_getaffinity(0))
                done.set()

            helper.tell(look)
            assert done.wait(30.0)
            assert found == [several]
    finally:
        helper.end()
        helper.join()
    assert not helper.alive


def test_a_helper_that_is_told_more_before_it_is_awake_is_kept_off_once(monkeypatch, eventually):
    kept_off = KeptOff({0, 1, 2}, {0, 1})
    calls, back = [], []
    begin, done = threading.Event(), threading.Event()
    monkeypatch.setattr(helper_module, "keep_off", lambda _: calls.append("kept off") or kept_off)
    monkeypatch.setattr(helper_module, "let_back", back.append)
    helper = Helper("helping")
    try:
        helper.tell(lambda: begin.wait(30.0))
        eventually(lambda: back and helper._kept_off is None)
        helper._kept_off = kept_off  # as if it had not yet begun
        for _ in range(3):
            helper.tell(lambda: None)
        helper.tell(done.set)
        begin.set()
        assert done.wait(30.0)
    finally:
        helper.end()
        helper.join()
    assert calls == ["kept off"]
    assert back == [kept_off, kept_off]
