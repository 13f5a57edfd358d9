"""Workers run tasks; those that die are replaced, and what they left is done again."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time

import pytest

from dying_tasks import task
from ogm_core.errors import BadInput, BadRecording
from ogm_services.commands.batch import workers as workers_module
from ogm_services.commands.batch.workers import WorkerDied, WorkerProcesses


@pytest.fixture(autouse=True)
def _none_is_left():
    before = set(multiprocessing.active_children())
    yield
    assert set(multiprocessing.active_children()) == before


def test_results_come_in_the_order_of_the_tasks_and_only_a_dead_workers_task_is_done_again(tmp_path):
    times = [0, 0, 2, 0, 1, 0, 0]
    with WorkerProcesses(2) as workers:
        results = workers.run(
            "working", [task("dying", tmp_path, number, died) for number, died in enumerate(times)]
        )
        assert workers.run("again", [task("dying", tmp_path, 9, 0)]) == [(9, 1)]
    assert results == [(number, died + 1) for number, died in enumerate(times)]


def test_what_a_worker_died_of_is_done_again_alone(tmp_path):
    """It may have died for want of memory."""
    with WorkerProcesses(3) as workers:
        spans = workers.run(
            "working", [task("lasting", tmp_path, number, number == 1) for number in range(6)]
        )
    began, ended = spans.pop(1)
    assert all(other_end <= began or ended <= other_begin for other_begin, other_end in spans)


def test_a_worker_that_died_without_a_task_costs_none(tmp_path):
    with WorkerProcesses(1) as workers:
        for number in range(5):
            assert workers.run("working", [task("dying", tmp_path, number, 0)]) == [(number, 1)]
            (worker,) = multiprocessing.active_children()
            os.kill(worker.pid, signal.SIGKILL)
            worker.join()


def test_workers_die_all_the_time_and_every_task_is_done(tmp_path):
    """Also where one dies while tasks are handed to others."""
    with WorkerProcesses(3) as workers:
        results = workers.run(
            "working", [task("dying", tmp_path, number, number % 3) for number in range(40)]
        )
    assert results == [(number, number % 3 + 1) for number in range(40)]


def test_an_unforeseen_error_says_where_in_the_worker_it_was_raised(tmp_path):
    with pytest.raises(FileNotFoundError) as caught, WorkerProcesses(1) as workers:
        workers.run("working", [task("dying", tmp_path / "nowhere", 0, 0)])
    assert "in dying\n" in caught.value.__notes__[0]


@pytest.mark.parametrize("kind", ["OfTwo", "WithLock"])
def test_an_error_that_cannot_be_sent_is_told_by_its_text(kind):
    why = f"^{kind}: went wrong\n(.*\n)*.* in raising\n"
    with pytest.raises(RuntimeError, match=why), WorkerProcesses(1) as workers:
        workers.run("working", [task("raising", kind)])


def test_where_no_more_processes_can_be_started_it_is_said_what_to_do(tmp_path, monkeypatch):
    begin = workers_module._Worker

    def begin_one():
        if multiprocessing.active_children():
            raise OSError(24, "Too many open files")
        return begin()

    monkeypatch.setattr(workers_module, "_Worker", begin_one)
    why = r"^--workers 3: beside 1 processes no other can be started: Too many open files: ask for fewer"
    with pytest.raises(BadInput, match=why), WorkerProcesses(3) as workers:
        workers.run("working", [task("endless")] * 2)


def test_frozen_workers_without_work_hold_up_no_error(tmp_path, monkeypatch):
    monkeypatch.setattr(workers_module, "ENDS_WITHIN", 3600.0)
    workers = WorkerProcesses(2)
    workers.run("working", [task("lasting", tmp_path, number, 0) for number in range(2)])
    for worker in multiprocessing.active_children():
        os.kill(worker.pid, signal.SIGSTOP)
    workers.__exit__(ValueError, ValueError("whatever"), None)


INTERRUPTED = """
import os, signal, time
import typer
from dying_tasks import task
from ogm_services.commands.batch import workers
from ogm_services.runtime.endings import INTERRUPTED
from ogm_services.runtime.signals import running_service

begin = workers._Worker.__init__
def begin_and_interrupt(self):
    begin(self)
    time.sleep(0.15)
    os.killpg(0, signal.SIGINT)
workers._Worker.__init__ = begin_and_interrupt
try:
    with running_service(INTERRUPTED), workers.WorkerProcesses(2) as processes:
        processes.run("working", [task("endless")] * 2)
except typer.Exit as end:
    raise SystemExit(end.exit_code)
"""


def test_ctrl_c_while_workers_begin_is_the_parents_alone():
    """Who hears of it while it loads Python complains at length."""
    found = subprocess.run(
        [sys.executable, "-c", INTERRUPTED],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        start_new_session=True,
        stderr=subprocess.PIPE,
        timeout=120.0,
        check=False,
        text=True,
    )
    assert (found.returncode, found.stderr) == (130, "")


def test_a_task_that_its_workers_always_die_of_is_named_and_no_other(tmp_path):
    tasks = [task("dying", tmp_path, number, 0, about=f"log {number}") for number in range(4)]
    tasks[2] = task("dying", tmp_path, 2, 99, about="log 2")
    why = r"^log 2: 3 workers have died of it: is there no memory left\?"
    with pytest.raises(WorkerDied, match=why), WorkerProcesses(2) as workers:
        workers.run("working", tasks)
    assert len(list(tmp_path.glob("2-*"))) == 3


def test_an_error_of_a_task_is_raised_at_once_and_ends_the_others():
    began = time.monotonic()
    with pytest.raises(BadRecording, match=r"^a\.log: holds no scan$"), WorkerProcesses(2) as workers:
        workers.run("working", [task("failing", "a.log: holds no scan"), task("endless")])
    assert time.monotonic() - began < 300.0  # it would take an hour


def test_of_several_that_fail_the_first_in_order_is_named_though_it_fails_last(tmp_path):
    late = task("failing_after", tmp_path / "failed", "b.log: holds no scan")
    soon = task("failing", "c.log: holds no scan", tmp_path / "failed")
    tasks = [late, soon, task("endless")]
    with pytest.raises(BadRecording, match=r"^b\.log: holds no scan$"), WorkerProcesses(2) as workers:
        workers.run("working", tasks)


def test_nobody_is_started_for_nothing():
    with WorkerProcesses(2) as workers:
        assert workers.run("nothing", []) == []
        assert workers.count == 2
        assert not multiprocessing.active_children()
