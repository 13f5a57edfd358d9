"""Mailboxes: how a kernel on one thread hands work to another's without Python, its lock or the system.

What is handed over are the numbers of a mailbox, int64, shape (WORDS,); the first one, its state, says whose
they are, and the work with them:

    EMPTY    the giver's; the taker looks again and again whether something is posted
    POSTED   nobody's: it is done by who takes it, be that the giver
    TAKEN    the taker's
    DONE     the giver's, who has been waiting for it
    ASLEEP   the giver's: the taker has gone back to Python, or was never sent here
    FAILED   as ASLEEP; what was taken has not been done

Several threads read and write the state at a time; who changes it hands over all that it has written before.
"""

import time
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array
from numpy.typing import NDArray

EMPTY, POSTED, TAKEN, DONE, ASLEEP, FAILED = range(6)
STATE = 0
WORDS = 16
"""Two lines of a processor's cache: mailboxes side by side do not slow each other down."""
Mailbox = NDArray[np.int64]
NS = 1_000_000_000

MONOTONIC, OF_THREAD = int(time.CLOCK_MONOTONIC), int(time.CLOCK_THREAD_CPUTIME_ID)
_LOOKS = 100
"""So often a state is looked at, which takes a tenth of a microsecond, before another thread may run."""
_clock_gettime: Any = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.voidptr))
_make_array: Any = make_array
_sched_yield: Any = types.ExternalFunction("sched_yield", types.int32())


def _place(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ANN401 - the compiler's
    """Where a mailbox has its state."""
    return _make_array(signature.args[0])(context, builder, arguments[0]).data


def _state(_: Any, mailbox: Any) -> Any:  # noqa: ANN401
    def code(*of: Any) -> Any:  # noqa: ANN401
        return of[1].load_atomic(_place(*of), "acquire", 8)

    return types.int64(mailbox), code


def _hand_over(_: Any, mailbox: Any, to: Any) -> Any:  # noqa: ANN401
    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ANN401
        place = _place(context, builder, signature, arguments)
        builder.store_atomic(arguments[1], place, "release", 8)
        return context.get_dummy_value()

    return types.void(mailbox, types.int64), code


def _change(_: Any, mailbox: Any, before: Any, to: Any) -> Any:  # noqa: ANN401
    def code(*of: Any) -> Any:  # noqa: ANN401
        _, old, new = of[3]
        return of[1].extract_value(of[1].cmpxchg(_place(*of), old, new, "acq_rel", "acquire"), 1)

    return types.boolean(mailbox, types.int64, types.int64), code


state: Any = intrinsic(_state)
"""state(mailbox) -> int; what its last writer has written before can be read from now on."""
hand_over: Any = intrinsic(_hand_over)
"""hand_over(mailbox, to): set the state of a mailbox that is this thread's."""
change: Any = intrinsic(_change)
"""change(mailbox, before, to) -> bool: set the state if it is still what it was `before`; whether it was."""


@njit(cache=True, nogil=True)
def now(clock: int) -> int:
    """What a clock of the system shows, ns."""
    time_of = np.empty(2, np.int64)
    _clock_gettime(clock, time_of.ctypes)
    return int(time_of[0]) * NS + int(time_of[1])


@njit(cache=True, nogil=True)
def taken(mailbox: Mailbox, patience: int) -> bool:
    """Taker: wait for what is posted, and take it; False and ASLEEP after so many ns without."""
    looks, until = 0, now(MONOTONIC) + patience
    while True:
        if state(mailbox) == POSTED and change(mailbox, POSTED, TAKEN):
            return True
        looks += 1
        if looks % _LOOKS == 0:
            if now(MONOTONIC) > until and change(mailbox, EMPTY, ASLEEP):
                return False
            _sched_yield()


@njit(cache=True, nogil=True)
def done(mailbox: Mailbox) -> bool:
    """Giver: whether what it has tried to post was done; False where it has to be done by the giver itself.

    If somebody is at it, wait. The mailbox is the giver's then.
    """
    looks = 0
    while True:
        found = state(mailbox)
        if found == DONE:
            hand_over(mailbox, EMPTY)
            return True
        if found == POSTED:
            change(mailbox, POSTED, EMPTY)  # unless it is taken just now
        elif found != TAKEN:
            return False
        looks += 1
        if looks % _LOOKS == 0:
            _sched_yield()
