"""Signal handling: how signals end what runs, and when they have to wait."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import typer

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def running_service(interrupted: int = 0) -> Iterator[None]:
    """Ctrl-C, SIGTERM and SIGHUP alike end what runs inside, with exit code `interrupted`.

    SIGHUP comes when the terminal is closed; where it is ignored from the start, as under nohup, it stays so.

    A second signal is ignored, to the process's end: what runs inside then stops already, in bounded time,
    and may be writing.
    """
    ending = False

    def interrupt(*_: object) -> None:
        nonlocal ending
        if not ending:
            ending = True
            raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in _ending_signals()}
    try:
        yield
    except KeyboardInterrupt:
        raise typer.Exit(interrupted) from None
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if ending else handler)


class MakeWay(BaseException):
    """What runs gives up, for the process is to end; no Exception, which libraries might catch."""


@contextmanager
def held_signals() -> Iterator[list[int]]:
    """Put off Ctrl-C, SIGTERM and SIGHUP until what runs inside is done, or gives up by MakeWay.

    Inside, the list holds the numbers of the signals that have come.

    For what must not be left half done, and for imports and compilers: where they call back into Python, an
    exception out of a signal handler is swallowed, and the signal with it. Python handles signals in the
    main thread only, so elsewhere this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield []
        return
    held: list[int] = []

    def hold(number: int, _: object) -> None:
        held.append(number)

    before = {number: signal.signal(number, hold) for number in _ending_signals()}
    try:
        with suppress(MakeWay):
            yield held
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if held:
        signal.raise_signal(held[0])


def _ending_signals() -> list[signal.Signals]:
    """The signals that end a command: not SIGHUP, where who started it wants it to outlive its terminal."""
    return [
        number
        for number in _ENDING
        if number is not signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN
    ]
