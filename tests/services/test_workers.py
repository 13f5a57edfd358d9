"""Workers run tasks; those that die are replaced, and what they left is done again."""

import multiprocessing
import os
import signal
import time

import pytest

from dying_tasks import task
from ogm_core.errors import BadRecording
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
