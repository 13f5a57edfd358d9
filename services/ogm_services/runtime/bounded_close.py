"""Close of a service in bounded time, or what it waits for."""

import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType

_BETWEEN = ("threading", "contextlib", __name__)
"""Modules between the closing thread's start and what it calls."""


def close_within(seconds: float, close: Callable[[], None]) -> str | None:
    """Call `close` on a thread of its own: None once it is done, else what it waits for after `seconds`.

    What `close` raises is raised here. If it is not done, its thread goes on.
    """
    errors: list[BaseException] = []

    def run() -> None:
        try:
            close()
        except BaseException as error:  # noqa: BLE001 (raised below)
            errors.append(error)

    thread = threading.Thread(target=run, name="ogm-close", daemon=True)
    thread.start()
    thread.join(seconds)
    if thread.is_alive():
        return what_holds(thread)
    if errors:
        raise errors[0]
    return None


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
