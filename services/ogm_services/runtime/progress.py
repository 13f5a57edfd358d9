"""Progress of commands that work through a log, or record one; on stderr, and only where a person looks."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Show = Callable[[float], None]
"""Shows how much is done, in the unit of the total."""
_unseen: ContextVar[bool] = ContextVar("unseen", default=False)


@contextmanager
def nothing_shown() -> Iterator[None]:
    """Inside, no bar is shown by this thread: somebody else shows how much is done."""
    token = _unseen.set(True)
    try:
        yield
    finally:
        _unseen.reset(token)


@contextmanager
def progress_line() -> Iterator[Callable[[str], None]]:
    """Show a line that changes, with something that moves, and give what changes it."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = SpinnerColumn(), TimeElapsedColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("", total=None)
        yield lambda text: progress.update(task, description=text)


@contextmanager
def progress_bar(text: str, total: float, *, counted: bool = False) -> Iterator[Show]:
    """Show a bar while something is done, and give what moves it; `counted` shows the numbers as well."""
    if _unseen.get() or not sys.stderr.isatty():
        yield lambda _: None
        return
    # Here, because it takes a while, and where nobody looks a log is soon read.
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = [TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()]
    if counted:
        columns.insert(2, MofNCompleteColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(text, total=total)
        yield lambda completed: progress.update(task, completed=completed)
