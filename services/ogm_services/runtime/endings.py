"""Exit codes: 0 done, 1 a failure at run time, 2 bad usage or bad input; why, in one line on stderr."""

import sys
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup

from ogm_core.errors import BadInput, OgmError

FAILED = 1
BAD_INPUT = 2
INTERRUPTED = 130
"""Ctrl-C kept a command from finishing; the code that shells use for it."""

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
            code = _complain(str(error), exit_code_of(error))
        except typer.Abort:
            code = INTERRUPTED
        sys.exit(code)


def exit_code_of(error: Exception) -> int:
    """The exit code of a command that ends with an error."""
    return BAD_INPUT if isinstance(error, BadInput) else FAILED


def _complain(text: str, code: int) -> int:
    typer.echo(f"ogm: {' '.join(text.split())}", err=True)
    return code
