"""Close of a service in bounded time, or what it waits for."""

import os
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import NoReturn, Self

import typer

from ogm_core.errors import OgmError

STOP_TIME = 9.0
"""How long a service may take to stop, s: 10 s after a signal all that can be is on the disk."""
_BETWEEN = ("threading", "contextlib", __name__)
"""Modules between the closing thread's start and what it calls."""


class NotStopped(OgmError):
    """A service did not stop in time: some of its threads go on."""

    slug = "not-stopped"

    @classmethod
    def within(cls, seconds: float, service: str, held_by: str) -> Self:
        """Of a service, "mapper" or "gateway"; `held_by` is what it waits for."""
        return cls(f"the {service} has not stopped within {seconds:g} s, so it ends as it is: {held_by}")


class Closing:
    """A close that goes on, on a thread of its own, while its caller does something else."""

    def __init__(self, close: Callable[[], None]) -> None:
        """Call `close`."""
        self._close = close
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="ogm-close", daemon=True)
        self._thread.start()

    def held_after(self, seconds: float) -> str | None:
        """None once it is done, else what it waits for after `seconds`; then its thread goes on.

        What `close` raises is raised here.
        """
        self._thread.join(seconds)
        if self._thread.is_alive():
            return what_holds(self._thread)
        if self._error is not None:
            raise self._error
        return None

    def _run(self) -> None:
        try:
            self._close()
        except BaseException as error:  # noqa: BLE001 (raised where it is waited for)
            self._error = error


def end_as_it_is(stuck: NotStopped, finish: Callable[[], None] = lambda: None) -> NoReturn:
    """End the process, in which something does not stop, with 1: say what, and `finish` what can be.

    Whatever else waits at the end of a process waits for all threads.
    """
    try:
        for error in (stuck.__context__, stuck):
            if isinstance(error, OgmError):
                typer.echo(f"ogm: {error}", err=True)
        try:
            finish()
        finally:
            sys.stdout.flush()
    finally:
        os._exit(1)


def what_holds(thread: threading.Thread) -> str:
    """What the thread has called of ours, and which threads would keep the process from ending."""
    frames = list(_from_outermost(sys._current_frames().get(thread.ident or 0)))  # noqa: SLF001
    called = [frame.f_code.co_qualname for frame in frames if frame.f_globals.get("__name__") not in _BETWEEN]
    if thread is threading.main_thread():  # it is the innermost that counts, below the whole program
        called = [
            frame.f_code.co_qualname
            for frame in reversed(frames)
            if str(frame.f_globals.get("__name__")).startswith("ogm_")
        ]
    what = f"{called[0]} does not return" if called else "the network does not close"
    others = [
        other.name
        for other in threading.enumerate()
        if other is not threading.main_thread() and not other.daemon
    ]
    return f"{what}; threads that go on: {', '.join(others) or 'none'}"


def _from_outermost(frame: FrameType | None) -> Iterator[FrameType]:
    if frame is not None:
        yield from _from_outermost(frame.f_back)
        yield frame
