"""Tasks that workers die of, fail at or never end."""

import os
import signal
import threading
import time
from pathlib import Path

from ogm_core.errors import BadRecording
from ogm_services.commands.batch.tasks import Task


def dying(folder, number, times):
    """Kill this process, the first so many times; then return the number, and how often it was begun."""
    marks = Path(folder)
    marks.joinpath(f"{number}-{os.getpid()}-{time.monotonic_ns()}").touch()
    begun = len(list(marks.glob(f"{number}-*")))
    if begun <= times:
        os.kill(os.getpid(), signal.SIGKILL)
    return number, begun


def lasting(folder, number, times):
    """As `dying`; return when it began and when it ended, s since this machine has started."""
    began = time.monotonic()
    time.sleep(0.1)
    dying(folder, number, times)
    return began, time.monotonic()


def failing(text, mark=None):
    """Refuse; leave a mark before, if one is named."""
    if mark:
        Path(mark).touch()
    raise BadRecording(text)


class OfTwo(Exception):
    """An error that pickle writes, and cannot read."""

    def __init__(self, one, two):
        super().__init__(f"{one} {two}")


class WithLock(Exception):
    """An error that pickle cannot write."""

    def __init__(self, *texts):
        super().__init__(" ".join(texts))
        self.lock = threading.Lock()


def raising(kind):
    """Raise such an error."""
    raise {"OfTwo": OfTwo, "WithLock": WithLock}[kind]("went", "wrong")


def failing_after(mark, text):
    """Refuse, once another task has left its mark."""
    while not Path(mark).exists():
        time.sleep(0.01)
    time.sleep(0.2)
    raise BadRecording(text)


def endless():
    """Outlast any test."""
    time.sleep(3600)


def task(name, *arguments, about="a task"):
    """One of these."""
    return Task(name, arguments, about, "dying_tasks")
