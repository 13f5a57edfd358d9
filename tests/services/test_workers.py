"""Workers run tasks; those that die are replaced, and what they left is done again."""

import multiprocessing
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


def test_results_come_in_the_order_of_the_tasks_and_a_dead_workers_task_is_done_again(tmp_path):
    """Two of seven kill their worker, one of them twice; others are done again at most beside them."""
    times = [0, 0, 2, 0, 1, 0, 0]
    with WorkerProcesses(2) as workers:
        results = workers.run(
            "working", [task("dying", tmp_path, number, died) for number, died in enumerate(times)]
        )
        assert workers.run("again", [task("dying", tmp_path, 9, 0)]) == [(9, 1)]
    assert [number for number, _ in results] == list(range(7))
    for (_, begun), died in zip(results, times, strict=True):
        assert died + 1 <= begun <= died + 3


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
