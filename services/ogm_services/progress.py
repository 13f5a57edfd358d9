"""The progress bar of commands that work through a log; on stderr, and only where a person looks."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


class Bar:
    """A bar that is told how far the work is."""

    def __init__(self, progress: Progress, text: str, total: float) -> None:
        self._progress = progress
        self._task = progress.add_task(text, total=total)

    def at(self, completed: float) -> None:
        """Show how much is done, in the unit of the total."""
        self._progress.update(self._task, completed=completed)


@contextmanager
def progress_bar(text: str, total: float, *, counted: bool = False) -> Iterator[Bar]:
    """Show a bar while something is done; `counted` shows the numbers as well."""
    console = Console(stderr=True)
    columns = [TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()]
    if counted:
        columns.insert(2, MofNCompleteColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        yield Bar(progress, text, total)
