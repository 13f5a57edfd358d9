"""Processors: how a thread that sleeps is kept off the one that its waker runs on.

A thread that is woken up may find itself on its waker's processor though another has nothing to do. There it
waits for the end of the waker's time slice, and is moved milliseconds later: a large scan is done in less.
Where a processor cannot be told, as on macOS, threads wake up wherever the system likes.
"""

import ctypes
import os
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

_sched_getcpu: Callable[[], int] | None = getattr(ctypes.PyDLL(None), "sched_getcpu", None)


class KeptOff(NamedTuple):
    """The processors that a thread could use, and those that it may use until it is `let_back`."""

    allowed: set[int]
    others: set[int]


def keep_off(thread: int) -> KeptOff | None:
    """Keep a thread, by its native id, off the processor that runs this one; None if it stays as it is.

    So it does where it could use no other, or the system refuses.
    """
    if _sched_getcpu is None:
        return None
    with suppress(OSError):
        allowed, mine = os.sched_getaffinity(thread), _sched_getcpu()
        others = allowed - {mine}
        if others and mine in allowed:
            os.sched_setaffinity(thread, others)
            return KeptOff(allowed, others)
    return None


def let_back(kept_off: KeptOff) -> None:
    """Let this thread use all processors again, unless somebody has told it others meanwhile."""
    with suppress(OSError):  # not permitted, or they are the process's no more
        if os.sched_getaffinity(0) == kept_off.others:
            os.sched_setaffinity(0, kept_off.allowed)
