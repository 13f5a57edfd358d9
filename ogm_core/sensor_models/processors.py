"""Processors: which one runs a thread, and how a thread leaves one that another thread needs.

A thread that is woken up may find itself on its waker's processor though another has nothing to do, and it
takes milliseconds till the system moves one of them. Until then two threads take turns, and a large scan is
done in less. Where a processor cannot be told, as on macOS, threads stay where they are.
"""

import ctypes
import os
from collections.abc import Callable
from contextlib import suppress

NONE = -1
_sched_getcpu: Callable[[], int] | None = getattr(ctypes.PyDLL(None), "sched_getcpu", None)


def processor() -> int:
    """Number of the processor that runs this thread just now; NONE where that cannot be told."""
    return NONE if _sched_getcpu is None else _sched_getcpu()


def leave(taken: int) -> None:
    """Go to another processor, if this thread runs on the one of that number and may use others.

    It stays where the system refuses, and leaves alone which ones it may use if that is changed meanwhile.
    """
    if taken == NONE or processor() != taken:
        return
    allowed = os.sched_getaffinity(0)
    others = allowed - {taken}
    if others:
        with suppress(OSError):  # not permitted, or these are the process's no more
            os.sched_setaffinity(0, others)
            if os.sched_getaffinity(0) == others:
                os.sched_setaffinity(0, allowed)
