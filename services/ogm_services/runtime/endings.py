"""How commands end: 0 done, 1 a failure at run time, 2 bad usage or bad input; why, in one line on stderr."""

import logging
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup

from ogm_core.errors import BadInput, OgmError

FAILED = 1
BAD_INPUT = 2
INTERRUPTED = 130
"""Ctrl-C kept a command from finishing; the code that shells use for it."""

_ENDING = (signal.SIGINT, signal.SIGTERM)

# Typer brings its own copy of click since 0.26: this is the UsageError of whichever it uses.
UsageError: Any = typer.BadParameter.__bases__[0]


class OneLineErrors(TyperGroup):
    """A program that says in one line what is wrong; only bugs show a traceback."""

    def main(self, *args: Any, **extra: Any) -> NoReturn:  # noqa: ANN401 (typer's own signature)
        """Run a command and exit."""
        try:
            code = super().main(*args, **{**extra, "standalone_mode": False})
        except UsageError as error:
            command = error.ctx.command_path if error.ctx else "ogm"
            message = error.format_message().rstrip(".") or "a command is needed"
            code = _complain(f"{message} (see {command} --help)", BAD_INPUT)
        except OgmError as error:
            code = _complain(str(error), BAD_INPUT if isinstance(error, BadInput) else FAILED)
        except typer.Abort:
            code = INTERRUPTED
        sys.exit(code)


def _complain(text: str, code: int) -> int:
    typer.echo(f"ogm: {' '.join(text.split())}", err=True)
    return code


@contextmanager
def running_service(interrupted: int = 0, *, logging_too: bool = True) -> Iterator[None]:
    """Log to stderr; Ctrl-C and SIGTERM alike end what runs inside, with exit code `interrupted`.

    Without `logging_too` nothing is logged: what runs inside says at its end what there was to say. A second
    signal is ignored, to the process's end: what runs inside then stops already, in bounded time, and may be
    writing.
    """
    if logging_too:
        logging.basicConfig(format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    else:
        logging.getLogger("ogm_services").addHandler(logging.NullHandler())
    ending = False

    def interrupt(*_: object) -> None:
        nonlocal ending
        if not ending:
            ending = True
            raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in _ENDING}
    try:
        yield
    except KeyboardInterrupt:
        raise typer.Exit(interrupted) from None
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if ending else handler)


@contextmanager
def held_signals() -> Iterator[None]:
    """Put off Ctrl-C and SIGTERM until what runs inside is done.

    For what must not be left half done, and for imports and compilers: where they call back into Python, an
    exception out of a signal handler is swallowed, and the signal with it. Python handles signals in the
    main thread only, so elsewhere this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []

    def hold(number: int, _: object) -> None:
        held.append(number)

    before = {number: signal.signal(number, hold) for number in _ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if held:
        signal.raise_signal(held[0])
