"""`ogm build --workers` as a process: Ctrl-C and kills leave no worker and no file behind."""

import os
import signal
import time

import pytest

from rough_log import write_three_logs

ENDED = 60.0
"""How long workers may take to end after their parent, s."""


@pytest.fixture
def building(ogm):
    """A build of a log that never comes: a pipe that nobody writes; with the pids of its two workers."""
    write_three_logs(ogm.folder)
    os.mkfifo(ogm.folder / "endless.jsonl")
    logs = "monday.jsonl", "endless.jsonl", "tuesday.jsonl"
    command = ogm.start("build", *logs, "--out", "built", "--workers", "2")
    deadline = time.monotonic() + 300.0
    while len(workers_of(command)) < 2 or not list(ogm.folder.glob(".ogm-build-*/held-2")):
        assert command.process.poll() is None, command.wait()
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return command


def workers_of(command):
    return [pid for pid, words in command.processes().items() if "spawn_main" in " ".join(words)]


@pytest.mark.parametrize("group", [True, False], ids=["Ctrl-C", "SIGTERM"])
def test_a_signal_ends_all_workers_and_nothing_is_left(ogm, building, group):
    ended = building.stop(signal.SIGINT if group else signal.SIGTERM, group=group)
    assert (ended.code, ended.out, ended.err) == (130, "", "")
    assert sorted(path.name for path in ogm.folder.iterdir()) == [
        "endless.jsonl",
        "monday.jsonl",
        "tuesday.jsonl",
        "wednesday.jsonl",
    ]


def test_workers_end_with_a_parent_that_is_killed(building):
    building.process.kill()
    building.process.wait()
    deadline = time.monotonic() + ENDED
    while building.group_lives():
        assert time.monotonic() < deadline, building.processes()
        time.sleep(0.05)
